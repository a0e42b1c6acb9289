"""Studies of the model: the fit, the predictions and their comparison with the paper, and the sensitivity.

Each has inputs, a seed and constants, and writes a result file that names what it rests on.
"""
