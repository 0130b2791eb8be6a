"""The optimisers of a published calibration on its own problem, beside each other."""
