"""Landmarks in use: the columns that they have behind the calibration in the window's border.

A landmark is a number since the start of the drive. While something in the window sees it, it has
two columns in the border, like a calibration parameter, and a place among them; else it is put
aside (`fgloc.online.aside`). The functions here move landmarks between the two, and change the
window's prior so that it says the same of everything as before.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from fgloc.core.measurements import Floats
from fgloc.factors.tables import FactorTable
from fgloc.online.aside import Aside
from fgloc.online.growing import GrowingArray
from fgloc.smoothing.arrow import triangle

ASIDE = -1
"""Place of a landmark that is not in use."""


class Landmarks:
    """Which landmarks there are, and which of them are in use."""

    def __init__(self, width: int, parameters: int) -> None:
        """Prepare for states of `width` B and a border that begins with G parameters."""
        self.parameters = parameters
        self.places = GrowingArray((), np.int64)
        """Place of every landmark among those in use, ASIDE for the others."""
        self.since = GrowingArray((), np.int64)
        """Keyframe at which every landmark was taken into use last."""
        self.used: list[int] = []
        """Numbers of the landmarks in use, by place."""
        self.aside = Aside(width, parameters)
        self.dead: list[int] = []
        """Landmarks that are given up as soon as nothing in the window sees them."""

    def columns(self, number: int) -> slice:
        """Return the columns of the border that belong to a landmark in use."""
        place = int(self.places.view[number])
        return slice(self.parameters + 2 * place, self.parameters + 2 * place + 2)

    def in_use(self, number: int) -> bool:
        """Return True if a landmark has columns in the border."""
        return bool(self.places.view[number] != ASIDE)

    def positions(self, border: Floats) -> Floats:
        """Return the landmarks in use (A, 2) of a border, in the order of their places."""
        return border[self.parameters :].reshape(-1, 2)

    def add(self, keyframe: int) -> int:
        """Return the number of a new landmark, in use from a keyframe on, in the last place."""
        self.since.append(keyframe)
        self.places.append(len(self.used))
        self.used.append(len(self.places) - 1)
        return self.used[-1]

    def use(self, numbers: list[int]) -> None:
        """Give landmarks the last places."""
        for number in numbers:
            self.places.view[number] = len(self.used)
            self.used.append(number)

    def drop(self, numbers: list[int]) -> None:
        """Take places away; the others close up."""
        gone = set(numbers)
        self.used = [number for number in self.used if number not in gone]
        self.places.view[:] = ASIDE
        self.places.view[np.array(self.used, dtype=np.int64)] = np.arange(len(self.used))


def wider(prior: FactorTable, width: int, guesses: Floats, root: Floats) -> FactorTable:
    """Return a prior of a window with more columns at the end of the border, and none known of them
    but `root` (m, m) about `guesses` (m,). `width` is that of the state."""
    state, border, offset = split(prior, width)
    n, m = offset.size, guesses.size
    whole = np.zeros((n + m, n + m))
    whole[:n, :n], whole[n:, n:] = prior.sqrt_information[0], root
    return joined(prior, state, np.append(border, guesses), np.append(offset, np.zeros(m)), whole)


def informed(
    prior: FactorTable, width: int, border: Floats, residual: Floats, by_border: Floats
) -> FactorTable:
    """Return a prior that knows something more of the border (n,).

    Namely that a whitened residual (d,), with derivative (d, n) there, should be zero. O(n³).
    """
    state, at, offset = split(prior, width)
    root = prior.sqrt_information[0]
    more = np.concatenate([np.zeros((residual.size, width)), by_border], axis=1)
    right = np.append(root @ offset, by_border @ (border - at) - residual)
    rows = triangle(np.column_stack([np.concatenate([root, more]), right]))
    n = offset.size
    left = np.ascontiguousarray(rows[:n, :n])
    return joined(prior, state, at, np.asarray(np.linalg.solve(left, rows[:n, n])), left)


def put_aside(
    prior: FactorTable, landmarks: Landmarks, numbers: list[int]
) -> tuple[FactorTable, Floats]:
    """Put landmarks that only the prior tells of aside.

    Returns the prior of what is left, and which (n',) columns of the border these are. O(n³).
    """
    aside = landmarks.aside
    state, border, offset = split(prior, aside.width)
    aside.rebase(state, border)
    own = np.concatenate([np.arange(n.start, n.stop) for n in map(landmarks.columns, numbers)])
    columns, q = own + aside.width, own.size
    rest = np.setdiff1d(np.arange(offset.size), columns)
    root = prior.sqrt_information[0]
    right = root @ offset
    rows = triangle(np.column_stack([root[:, columns], root[:, rest], right]))
    aside.put(numbers, columns, rows[:q, :q], rows[:q, q:-1], rows[:q, -1])
    left = np.ascontiguousarray(rows[q : q + rest.size, q:-1])
    step = np.asarray(np.linalg.solve(left, rows[q : q + rest.size, -1]), dtype=np.float64)
    landmarks.drop(numbers)
    keep = np.setdiff1d(np.arange(border.size), own)
    return joined(prior, state, border[keep], step, left), keep


def take_back(
    prior: FactorTable, landmarks: Landmarks, numbers: list[int]
) -> tuple[FactorTable, Floats]:
    """Take landmarks back into use; return the prior with them, and their (m,) means. O(n³).

    The means are those at the point from which the prior is measured.
    """
    aside = landmarks.aside
    state, border, offset = split(prior, aside.width)
    aside.rebase(state, border)
    mean, gain, own = aside.take(numbers)
    n, m = offset.size, mean.size
    whole = np.zeros((n + m, n + m))
    whole[:n, :n] = prior.sqrt_information[0]
    whole[n:, :n], whole[n:, n:] = -own @ gain, own
    landmarks.use(numbers)
    offset = np.append(offset, gain @ offset)
    return (
        joined(prior, state, np.append(border, mean), offset, triangle(whole)),
        mean,
    )


def split(prior: FactorTable, width: int) -> tuple[Floats, Floats, Floats]:
    """Return where a prior was linearised, state (B,) and border (n,), and its offset (B+n,)."""
    row = prior.measurements[0]
    size = row.size // 2
    return row[:width], row[width:size], row[size:]


def joined(
    prior: FactorTable, state: Floats, border: Floats, offset: Floats, root: Floats
) -> FactorTable:
    """Return a prior with other numbers."""
    return replace(
        prior,
        measurements=np.concatenate([state, border, offset])[None],
        sqrt_information=np.ascontiguousarray(root)[None],
        calibration=slice(0, border.size),
    )
