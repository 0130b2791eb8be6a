"""Which landmarks are in use, and the bookkeeping where one comes or goes."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from fgloc.core.measurements import Floats
from fgloc.online.aside import Aside
from fgloc.online.landmarks import put_aside, split, take_back
from fgloc.online.priors import Posterior
from fgloc.online.window import Window

LOST = 2.0
"""Factor on covariances when what pose and landmarks have in common is given up: twice the blocks
of a covariance is never less than all of it."""


class Keeper:
    """Moves landmarks in and out of a window's border."""

    def __init__(self, window: Window) -> None:
        self.window = window

    def idle(self) -> list[int]:
        """Return the landmarks in use that nothing in the window sees. O(window)."""
        window, marks = self.window, self.window.landmarks
        if not marks.used:
            return []
        seen = np.zeros(len(marks.places), dtype=bool)
        for table in window.tables.values():
            if table.sees_landmarks:
                seen[table.second.view] = True
        # One that was fetched may be seen any moment, and fetching costs a whole pass.
        return [k for k in marks.used if not seen[k] and marks.since.view[k] < window.base]

    def enter(
        self, guesses: Floats, root: Floats, border: Floats, posterior: Posterior
    ) -> tuple[list[int], Floats, Posterior]:
        """Take new landmarks into use at guesses (2 k,), of which `root` (2 k, 2 k) is known.

        Returns their numbers, and border and posterior with them.
        """
        window = self.window
        numbers = [window.landmarks.add(window.newest) for _ in range(guesses.size // 2)]
        window.widen(guesses, root)
        n, m = posterior.root.shape[0], guesses.size
        whole, covariance = np.zeros((n + m, n + m)), np.zeros((n + m, n + m))
        whole[:n, :n], whole[n:, n:] = posterior.root, root
        inverse = np.linalg.inv(root)
        covariance[:n, :n], covariance[n:, n:] = posterior.covariance, inverse @ inverse.T
        wide = np.append(posterior.border, guesses)
        known = replace(posterior, border=wide, root=whole, covariance=covariance)
        return numbers, np.append(border, guesses), known

    def put_aside(self, numbers: list[int], border: Floats, joint: Floats) -> tuple[Floats, Floats]:
        """Put landmarks aside that nothing in the window sees.

        Returns the border and the joint covariance (B+n, B+n) of the newest state and the border
        without them. Nothing is carried to any keyframe after this: a whole pass must follow.
        """
        window, width = self.window, self.window.layout.width
        assert window.prior is not None
        marks = window.landmarks
        window.prior, keep = put_aside(window.prior, marks, numbers)
        gone = [number for number in marks.dead if number in marks.aside.numbers]
        if gone:
            marks.aside.forget(gone)
            marks.dead = [number for number in marks.dead if number not in gone]
        window.rearrange(keep.size)
        own = np.append(np.arange(width), keep + width)
        return border[keep], joint[np.ix_(own, own)]

    def take_back(self, numbers: list[int], border: Floats) -> Floats:
        """Take landmarks back into use; return the border with them. A whole pass must follow."""
        window, marks = self.window, self.window.landmarks
        assert window.prior is not None
        now = marks.aside.values(window.states.view[0], border)
        guesses = np.concatenate([now[marks.aside.numbers.index(k)] for k in numbers])
        window.prior, _ = take_back(window.prior, marks, numbers)
        marks.since.view[numbers] = window.newest
        border = np.append(border, guesses)
        window.rearrange(border.size)
        return border

    def abandon(self, state: Floats, border: Floats, joint: Floats) -> Floats:
        """Put all landmarks aside as if they had nothing in common with the pose.

        The window is left without any, its one keyframe at `state` (B,). Returns the covariance
        (B+G, B+G) of state and calibration, given the `joint` one with the border. Never raises.
        """
        window, marks = self.window, self.window.landmarks
        b, g = window.layout.width, marks.parameters
        n = b + g
        window.rearrange(g)
        left = joint[:n, :n].copy()
        old = marks.aside
        marks.aside = Aside(b, g)
        marks.aside.state, marks.aside.border = state.copy(), border[:g].copy()
        used = marks.used
        marks.drop(used)
        if not used and not old.numbers:
            return left
        assert window.prior is not None
        at_state, at_border, _ = split(window.prior, b)
        root = window.prior.sqrt_information[0]
        mean = np.concatenate([old.values(at_state, at_border).ravel(), border[g:]])
        by_prior = np.zeros((mean.size, root.shape[0]))
        if old.gain.shape[1] != root.shape[0] or border.size != at_border.size:
            return left  # broken half-way: the landmarks are lost
        by_prior[: old.mean.size] = old.gain
        by_prior[old.mean.size :, n:] = np.eye(border.size - g)
        try:
            inverse = np.linalg.inv(root)
        except np.linalg.LinAlgError:
            return left
        spread = by_prior @ inverse
        covariance = spread @ spread.T
        covariance[: old.mean.size, : old.mean.size] += old.covariance
        if np.isfinite(mean).all() and np.isfinite(covariance).all():
            aside = marks.aside
            aside.numbers, aside.mean = old.numbers + used, mean
            aside.gain, aside.covariance = np.zeros((mean.size, n)), LOST * covariance
        return LOST * left
