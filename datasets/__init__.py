"""Recorded and simulated drives: where they come from and how they are read."""
