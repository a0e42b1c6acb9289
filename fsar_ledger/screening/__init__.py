"""Measure how much each cell depends on each constant.

Morris screening covers all constants; Sobol indices follow for the dozen that move the cells most.
"""
