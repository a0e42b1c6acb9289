"""How much of each cell hangs on each constant.

Morris screening over all of them, then Sobol indices for the dozen that move the cells most.
"""
