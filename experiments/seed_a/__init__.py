"""Seed A's tables: what is printed, the drives they come from, what all methods make of them."""
