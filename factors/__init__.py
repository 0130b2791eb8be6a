"""Factors: residual kernels with analytic Jacobians, and tables that hold them by the thousand."""
