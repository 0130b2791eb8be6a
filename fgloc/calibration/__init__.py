"""Calibration of a robot over many drives: the fit, the choice of a model, what it is worth."""
