"""Recordings and devices of others: ROS bags."""
