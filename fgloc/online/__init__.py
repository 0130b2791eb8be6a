"""The online engine: measurements in as they arrive, the newest pose out at every wheel packet."""
