"""Compiled scalar kernels, one subject a file: a residual and its Jacobians."""
