"""Simulated rooms of seeds B and C: EKF-SLAM against the graph, maps against the true walls."""
