"""Prior on a whole keyframe state and the calibration together: what older measurements left."""

from __future__ import annotations

import numpy as np

from fgloc.core.compiled import compiled
from fgloc.core.geometry import Floats, wrap_scalar


@compiled
def state_prior(
    xi: Floats,
    xj: Floats,
    g: Floats,
    m: Floats,
    slot: int,
    r: Floats,
    ji: Floats,
    jj: Floats,
    jg: Floats,
) -> None:
    """Residual (at⁻¹ ∘ x, zeros, g - at) - offset; m = [at: state (B) and g (G), offset (B + G)].

    It has B + G components, correlated through the square-root information: the marginal prior
    that is left of keyframes which a sliding window has dropped. `at` is where they were
    linearised, `offset` the step from there that they ask for by themselves: measured from their
    own mean, which may be far off in a direction they say little about, the pose's axes would be
    turned.
    """
    b = ji.shape[1]
    n = b + g.size
    c, s = np.cos(m[2]), np.sin(m[2])
    dx, dy = xi[0] - m[0], xi[1] - m[1]
    turn = wrap_scalar(xi[2] - m[2])
    r[0] = c * dx + s * dy - m[n]
    r[1] = -s * dx + c * dy - m[n + 1]
    r[2] = turn - m[n + 2]
    ct, st = np.cos(turn), np.sin(turn)
    ji[0, 0], ji[0, 1] = ct, -st
    ji[1, 0], ji[1, 1] = st, ct
    ji[2, 2] = 1.0
    for k in range(3, b):
        r[k] = xi[k] - m[k] - m[n + k]
        ji[k, k] = 1.0
    for k in range(g.size):
        r[b + k] = g[k] - m[b + k] - m[n + b + k]
        jg[b + k, k] = 1.0
