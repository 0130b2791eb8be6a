"""What rounded encoder counts do to an estimate, and how to undo it.

The rounding error of an increment sits on both sides of the wheels' residual: in the measured
displacement and in its derivative by the calibration (and, through the path, in its weight). Least
squares then settles where a mean of derivative times residual is not zero at the truth, and finds
the track too wide: errors in variables, the "attenuation" of regression. With 300 counts a
revolution and 10 poses a second it is more than half a percent, which no length of drive averages
out.

To second order the harm that the errors e do is ½ f''[e, e], f being the estimate as a function of
the increments. Errors like them, drawn and added to the measured increments, do the same harm once
more; drawn with both signs, what they do to first order cancels. So the mean of two more estimates,
one with e added and one with e subtracted, is off by one more bias, which is taken away
(simulation extrapolation: Cook and Stefanski, J. Amer. Statist. Assoc. 89, 1994). One draw is
enough, as the harm is a sum over hundreds of keyframes.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from fgloc.core.geometry import between, compose
from fgloc.core.measurements import Floats
from fgloc.core.preintegration import SplitIncrements, rounding_sigma
from fgloc.smoothing.minimise import Point, minimise
from fgloc.smoothing.problem import Problem
from fgloc.smoothing.settings import Settings

NEGLIGIBLE = 1e-4
"""Relative bias that is not worth two more minimisations."""


def without_rounding_bias(problem: Problem, settings: Settings, point: Point) -> tuple[Point, int]:
    """Return the minimum `point` less the bias of rounded counts, and the steps tried.

    The point itself where encoders are continuous or fine, where wheels are all there is, where
    the noisier problem has no minimum near by, or where slips are modelled: they take up what
    rounding does to an increment. Otherwise two minimisations from the point: a few
    iterations, O(K) each.
    """
    alone = all(t.sensor == "start" for t in problem.tables)
    if alone or problem.slip_slot >= 0 or attenuation(problem) < NEGLIGIBLE:
        return point, 0
    errors = draw_errors(problem.split, np.random.default_rng(0))
    off_poses, off_rest = np.zeros_like(point.states[:, :3]), np.zeros_like(point.states[:, 3:])
    off_u, off_marks = np.zeros_like(point.u), np.zeros_like(point.landmarks)
    tried = 0
    for sign in (1.0, -1.0):
        split = replace(problem.split, angles=problem.split.angles + sign * errors)
        noisier = replace(problem, split=split)
        found, steps, converged = minimise(
            noisier, settings, point.states, point.u, settings.robust, landmarks=point.landmarks
        )
        tried += steps
        if not converged:
            return point, tried
        off_poses += 0.5 * between(point.states[:, :3], found.states[:, :3])
        off_rest += 0.5 * (found.states[:, 3:] - point.states[:, 3:])
        off_u += 0.5 * (found.u - point.u)
        off_marks += 0.5 * (found.landmarks - point.landmarks)
    states = np.hstack([compose(point.states[:, :3], -off_poses), point.states[:, 3:] - off_rest])
    # No step: what is wanted is the linearisation there.
    still = replace(settings, max_iterations=0)
    marks = point.landmarks - off_marks
    corrected, _, _ = minimise(
        problem, still, states, point.u - off_u, settings.robust, landmarks=marks
    )
    return corrected, tried


def attenuation(problem: Problem) -> float:
    """Return the largest relative bias to expect of a calibration parameter.

    That is the rounding's share in the mean square of the displacements between keyframes,
    forward, sideways or in heading. Steering is neglected.
    """
    count = problem.split.resolution
    if count == 0.0 or not problem.free:
        return 0.0
    # Each increment has two rounding errors, at its beginning and at its end.
    rounding = 2.0 * rounding_sigma(problem.robot, count) ** 2
    moved = np.mean(problem.displacement(np.zeros(len(problem.parameters))) ** 2, axis=0)
    return float(np.max(rounding / np.maximum(moved, rounding + 1e-300)))


def draw_errors(split: SplitIncrements, rng: np.random.Generator) -> Floats:
    """Return (M, D) errors [rad] of the increments, as their rounding made them.

    The angle of a moving encoder is off by up to half a count at every packet, at one as at any
    other, and increments are differences of angles. While a wheel stands, its error stays the
    same. Where a keyframe cuts an interval, the error is interpolated like the angle.
    """
    pieces, wheels = split.angles.shape
    share = np.ones(pieces) if split.share is None else split.share
    end = np.cumsum(share)
    interval = np.floor(end - 0.5 * share).astype(np.int64)
    moving = np.zeros((int(interval[-1]) + 1, wheels), dtype=np.int64)
    np.maximum.at(moving, interval, (split.angles != 0.0).astype(np.int64))
    signs = rng.choice(np.array([-1.0, 1.0]), size=(moving.shape[0] + 1, wheels))
    same = np.concatenate([np.zeros((1, wheels), np.int64), np.cumsum(moving, axis=0)])
    at_packet = np.take_along_axis(signs, same, axis=0) * split.resolution / np.sqrt(12.0)
    packets, at = np.arange(at_packet.shape[0]), np.append(0.0, end)
    errors = [np.diff(np.interp(at, packets, column)) for column in at_packet.T]
    return np.ascontiguousarray(np.stack(errors, axis=1))
