"""Landmarks that nothing in the window sees, kept with their joint uncertainty at next to no cost.

A landmark that is not seen any more depends on what is seen later only through the unknowns it has
in common with it: x = mean + gain·d + w, where d is the deviation of the window's first state and
of the border (calibration and landmarks in use) from a fixed point, and w ~ N(0, covariance) is
independent of everything to come. This is exact for a linear model. So while the window moves on,
only the gain is carried from keyframe to keyframe; a landmark far away costs nothing more, yet is
corrected through the gain when a loop is closed, and is still known jointly with all others when
it comes into view again. (Guivant and Nebot's compressed filter, in a smoother's variables.)
"""

from __future__ import annotations

import numpy as np

from fgloc.core.geometry import between
from fgloc.core.measurements import Floats, Stamps


class Aside:
    """The joint distribution of landmarks put aside, given the window's first state and border."""

    def __init__(self, width: int, border: int) -> None:
        """Prepare for states (B,) of `width` and a border (n,) of `border` columns."""
        self.width = width
        self.numbers: list[int] = []
        self.mean = np.zeros(0)
        self.gain = np.zeros((0, width + border))
        self.covariance = np.zeros((0, 0))
        # The point that deviations are measured from; a pose's are in the body's axes there.
        self.state = np.zeros(width)
        self.border = np.zeros(border)

    def deviation(self, state: Floats, border: Floats) -> Floats:
        """Return d (B+n,) of a state (B,) and border (n,)."""
        d = np.concatenate([state - self.state, border - self.border])
        d[:3] = between(self.state[:3], state[:3])
        return np.asarray(d)

    def values(self, state: Floats, border: Floats) -> Floats:
        """Return the landmarks' means (I, 2) where first state and border are as given."""
        return np.asarray((self.mean + self.gain @ self.deviation(state, border)).reshape(-1, 2))

    def marginals(self, joint: Floats) -> Floats:
        """Return the marginal covariances (I, 2, 2), given that (B+n, B+n) of the deviations."""
        own = self.covariance.reshape(len(self.numbers), 2, len(self.numbers), 2)
        k = np.arange(len(self.numbers))
        gain = self.gain.reshape(-1, 2, self.gain.shape[1])
        return np.asarray(own[k, :, k] + (gain @ joint) @ gain.swapaxes(1, 2))

    def whole(self, joint: Floats) -> Floats:
        """Return the joint covariance (2I, 2I), given that (B+n, B+n) of the deviations."""
        return np.asarray(self.covariance + self.gain @ joint @ self.gain.T)

    def rebase(self, state: Floats, border: Floats) -> None:
        """Measure deviations from another point."""
        d = self.deviation(state, border)
        self.mean = self.mean + self.gain @ d
        turn = state[2] - self.state[2]
        c, s = np.cos(turn), np.sin(turn)
        self.gain = self.gain.copy()
        self.gain[:, :2] = self.gain[:, :2] @ np.array([[c, -s], [s, c]])
        self.state, self.border = state.copy(), border.copy()

    def step(self, rows: Floats, state: Floats) -> None:
        """Go on to the next keyframe, linearised at `state` (B,).

        `rows` (B, 2 B + n + 1) are the triangular rows of the present one: by itself, by the next,
        by the border, and their right side. O(I²·B + I·n·B).
        """
        b = self.width
        by_state, by_border = self.gain[:, :b], self.gain[:, b:]
        rest = np.concatenate([np.zeros_like(by_state), by_border], axis=1)
        self.replace(by_state, rest, rows[:, :b], rows[:, b:-1], rows[:, -1])
        self.state = state.copy()

    def walk(self, rows: Floats, offset: Floats) -> None:
        """Let the first F parameters of the border walk.

        `rows` (F, F+B+n) tell what they were by what is known now, about a mean `offset` (B+n,)
        away from where deviations are measured.
        """
        free, b = rows.shape[0], self.width
        rest = self.gain.copy()
        rest[:, b : b + free] = 0.0
        root, others = rows[:, :free], rows[:, free:]
        right = root @ offset[b : b + free] + others @ offset
        self.replace(self.gain[:, b : b + free], rest, root, others, right)

    def replace(
        self, gone: Floats, rest: Floats, root: Floats, others: Floats, right: Floats
    ) -> None:
        """Do without q unknowns z, of which root·z + others·d' = right + noise is known.

        `gone` (2I, q) and `rest` (2I, m) are the gains by z and by what remains, d' (m,).
        """
        by_noise = np.linalg.solve(root.T, gone.T).T
        self.mean = self.mean + by_noise @ right
        self.gain = rest - by_noise @ others
        self.covariance = self.covariance + by_noise @ by_noise.T

    def widen(self, guesses: Floats) -> None:
        """Let the border have more columns at its end, measured from `guesses` (m,)."""
        empty = np.zeros((self.gain.shape[0], guesses.size))
        self.gain = np.concatenate([self.gain, empty], axis=1)
        self.border = np.concatenate([self.border, guesses])

    def put(
        self, numbers: list[int], columns: Stamps, root: Floats, others: Floats, right: Floats
    ) -> None:
        """Take landmarks out of the border, whose columns of d they are.

        root·z + others·d' = right + noise is all that is known of their deviations z (q,) by the
        rest d' of the others.
        """
        keep = np.setdiff1d(np.arange(self.gain.shape[1]), columns)
        inverse = np.linalg.inv(root)
        gone = self.gain[:, columns]
        cross = gone @ inverse @ inverse.T
        at = self.border[columns - self.width]
        self.replace(gone, self.gain[:, keep], root, others, right)
        self.numbers = self.numbers + numbers
        self.mean = np.concatenate([self.mean, at + inverse @ right])
        self.gain = np.concatenate([self.gain, -inverse @ others])
        self.covariance = np.block([[self.covariance, cross], [cross.T, inverse @ inverse.T]])
        self.border = self.border[keep[self.width :] - self.width]

    def take(self, numbers: list[int]) -> tuple[Floats, Floats, Floats]:
        """Give landmarks back to the border, whose last columns they become.

        Returns their means (q,), gains (q, B+n) and square-root information (q, q) before; the
        others from now on are what they are given these as well. O(I²·q).
        """
        where = np.array([self.numbers.index(k) for k in numbers])
        mine = (2 * where[:, None] + np.arange(2)).ravel()
        rest = np.setdiff1d(np.arange(self.mean.size), mine)
        mean, gain = self.mean[mine], self.gain[mine]
        covariance = self.covariance[np.ix_(mine, mine)]
        root = np.linalg.inv(np.linalg.cholesky(covariance))
        cross = self.covariance[np.ix_(rest, mine)]
        by_mine = np.linalg.solve(covariance, cross.T).T
        left = self.covariance[np.ix_(rest, rest)] - by_mine @ cross.T
        self.covariance = 0.5 * (left + left.T)
        self.gain = np.concatenate([self.gain[rest] - by_mine @ gain, by_mine], axis=1)
        # The new columns are measured from the means at no deviation.
        self.mean = self.mean[rest]
        self.numbers = [k for k in self.numbers if k not in set(numbers)]
        self.border = np.concatenate([self.border, mean])
        return mean, gain, root

    def forget(self, numbers: list[int]) -> None:
        """Give landmarks up."""
        keep = [k for k, number in enumerate(self.numbers) if number not in set(numbers)]
        mine = (2 * np.array(keep, dtype=np.int64)[:, None] + np.arange(2)).ravel()
        self.numbers = [self.numbers[k] for k in keep]
        self.mean, self.gain = self.mean[mine], self.gain[mine]
        self.covariance = self.covariance[np.ix_(mine, mine)]
