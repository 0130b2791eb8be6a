"""Residual kernels: one compiled scalar function a factor type, all with the same signature.

`kernel(xi, xj, g, m, slot, r, ji, jj, jg)` reads the two keyframe states xi, xj (x, y, theta and
possibly slowly varying sensor zeros from column 3 on), the factor's calibration block g (solver
units), its measurement row m and the state column `slot` of its sensor zero (-1: none). It writes
the residual r (d,) and the Jacobians ji, jj (d, B), jg (d, G), which arrive zeroed. State
Jacobians are by the retraction x ⊕ d = x ∘ (d_x, d_y, d_theta), zeros additive. Kernels of one
keyframe leave xj and jj alone. Where xj is a landmark it is two numbers, moved by adding, and jj
is (d, 2); where xi and xj are calibration vectors both are moved by adding.

The compiled loops in `tables.py` are cached by the date of that file: after editing a kernel, save
`tables.py` again or delete `factors/__pycache__`.
"""
