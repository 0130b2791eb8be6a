"""The simulator: robots, motions, sensors and what goes wrong with them."""
