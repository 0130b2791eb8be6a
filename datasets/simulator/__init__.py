"""The simulator: robots, motions, sensors and what goes wrong with them."""

from fgloc.datasets.simulator.drives import load_sim

__all__ = ["load_sim"]
