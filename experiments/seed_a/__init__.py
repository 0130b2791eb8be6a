"""Seed A's tables: what is printed, the drives they come from, and what all methods make of them."""
