"""Filters: the dead-reckoning models and, later, the Kalman baselines."""
