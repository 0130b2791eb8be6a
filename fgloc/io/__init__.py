"""What other programs write: bags, configurations, the bytes of drivers."""
