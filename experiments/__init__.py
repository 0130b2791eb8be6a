"""Experiments: methods side by side on recorded and simulated drives."""
