"""Dead reckoning from the newest solved keyframe: pose and covariance at every wheel packet."""

from __future__ import annotations

import numpy as np

from fgloc.core.geometry import compose, compose_scalar, rotate_covariance
from fgloc.core.measurements import Floats
from fgloc.core.preintegration import Integrator
from fgloc.online.layout import Layout
from fgloc.online.priors import Posterior
from fgloc.online.window import Window


class Propagation:
    """Accumulates wheel increments since an anchor keyframe, with calibrated parameters."""

    def __init__(self, layout: Layout) -> None:
        self._layout = layout
        self._integrator = Integrator(layout.robot)
        self._scale = np.ones(len(layout.free))
        self._state = np.zeros(layout.width)
        self._joint = np.zeros((layout.size, layout.size))

    def restart(self, posterior: Posterior, state: Floats) -> None:
        """Begin again at a keyframe whose state and joint covariance are known."""
        layout = self._layout
        for k in range(len(layout.free)):
            self._scale[k] = layout.parameters[k].derivative(float(posterior.border[k]))
        self._integrator.restart(layout.values(posterior.border))
        self._state = state.copy()
        self._joint = posterior.covariance

    def place(self, start: Floats, sigma: Floats) -> None:
        """Move the anchor by a pose (3,) of the map that is known to sigma (3,) [m, m, rad]."""
        self._state = self._state.copy()
        self._state[:3] = compose(start, self._state[:3])
        self._joint = self._joint.copy()
        turned = rotate_covariance(np.diag(sigma**2), -self._state[2])
        self._joint[:3, :3] += turned

    def add(self, angles: Floats, steering: Floats, seconds: float) -> None:
        """Move on by wheel increments (D,) that took `seconds`."""
        self._integrator.add(angles, steering, seconds)

    @property
    def state(self) -> Floats:
        """Return the (B,) state now: the pose moved on, the sensor zeros as they were."""
        moved = self._state.copy()
        compose_scalar(self._state, self._integrator.displacement, moved)
        return moved

    @property
    def displacement_covariance(self) -> Floats:
        """Return the (3, 3) covariance of the displacement since the anchor, in the axes of now."""
        return self._turned(self._integrator.covariance)

    def joint(self) -> Floats:
        """Return the (B+n, B+n) joint covariance of the state now (body axes) and the border."""
        return self._moved(self._joint.shape[0])

    def _moved(self, n: int) -> Floats:
        """Return the first n rows and columns of the joint covariance now; no fewer than B+F."""
        d = self._integrator.displacement
        b = self._state.size
        c, s = np.cos(d[2]), np.sin(d[2])
        move = np.eye(n)
        # A turn of the anchor swings the displacement; then everything in the axes of now.
        move[:2, :3] = np.array([[c, s, -c * d[1] + s * d[0]], [-s, c, s * d[1] + c * d[0]]])
        j = self._integrator.jacobian[:, list(self._layout.free)] * self._scale
        move[:2, b : b + j.shape[1]] = np.array([[c, s], [-s, c]]) @ j[:2]
        move[2, b : b + j.shape[1]] = j[2]
        joint = move @ self._joint[:n, :n] @ move.T
        joint[:3, :3] += self._turned(self._integrator.covariance)
        return joint

    def covariance(self) -> Floats:
        """Return the (3, 3) covariance of the pose now, in map axes."""
        heading = self._state[2] + self._integrator.displacement[2]
        joint = self._moved(self._layout.size)
        turned = rotate_covariance(joint[:3, :3], heading)
        return 0.5 * (turned + turned.T)

    def _turned(self, covariance: Floats) -> Floats:
        """Return a covariance in the anchor's axes turned to the axes of now."""
        turned: Floats = rotate_covariance(covariance, -self._integrator.displacement[2])
        return turned


def moved_from(window: Window, number: int, stamp_ns: int) -> Floats:
    """Return where (3,) the wheels had brought the robot at a stamp, seen from a keyframe before.

    At the newest calibration that the window knows. O(packets after the keyframe).
    """
    integrator = Integrator(window.layout.robot)
    integrator.restart(window.layout.values(window.latest))
    left = (stamp_ns - window.stamp(number)) * 1e-9
    pieces = window.split(number, number + 2)
    for angles, steering, seconds in zip(
        pieces.angles, pieces.steering, pieces.seconds, strict=True
    ):
        part = min(1.0, left / seconds)
        integrator.add(angles * part, steering, seconds * part)
        left -= seconds
        if left <= 0.0:
            break
    return integrator.displacement
