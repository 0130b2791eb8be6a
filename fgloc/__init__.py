"""Factor-graph localisation of wheeled ground robots."""

__version__ = "0.1.0"
