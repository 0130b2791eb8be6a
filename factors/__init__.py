"""Factors: residuals with exact Jacobians, and tables of them."""
