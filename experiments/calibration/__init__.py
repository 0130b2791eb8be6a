"""Calibration of recorded robots, judged on drives that were not used for it."""
