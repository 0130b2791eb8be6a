"""Seed D: a robot with four steered wheels, its recordings, and fusion with a camera and a gyro."""
