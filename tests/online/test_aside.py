"""Landmarks put aside against dense Gaussians: nothing is lost, nothing is made up."""

from __future__ import annotations

import numpy as np

from fgloc.core.measurements import Floats
from fgloc.factors.tables import FactorTable
from fgloc.online.aside import Aside
from fgloc.online.landmarks import Landmarks, informed, put_aside, split, take_back
from fgloc.online.priors import after_walk, prior_table
from fgloc.smoothing.arrow import triangle

B, G = 3, 2


def covariance(size: int, rng: np.random.Generator) -> Floats:
    """Return a random covariance."""
    a = rng.normal(size=(size, size))
    return np.asarray(a @ a.T + 0.1 * np.eye(size))


def root(p: Floats) -> Floats:
    """Return its square-root information, triangular."""
    return triangle(np.linalg.inv(np.linalg.cholesky(p)))


def known(seed: int, landmarks: int = 4) -> tuple[FactorTable, Landmarks, Floats, Floats]:
    """Return a prior of state, parameters and landmarks in use, with its covariance and mean."""
    rng = np.random.default_rng(seed)
    n = G + 2 * landmarks
    p, offset = covariance(B + n, rng), 0.1 * rng.normal(size=B + n)
    marks = Landmarks(B, G)
    for _ in range(landmarks):
        marks.add(0)
    marks.aside.widen(np.zeros(2 * landmarks))
    # At a pose without a turn, so that the map's axes and the body's are the same.
    return prior_table(np.zeros(B), np.zeros(n), root(p), offset), marks, p, offset


def test_a_landmark_put_aside_and_fetched_again_leaves_the_prior_as_it_was() -> None:
    """The joint information of everything is the same, up to the order of the columns."""
    prior, marks, p, offset = known(0)
    less, keep = put_aside(prior, marks, [1, 3])
    assert marks.used == [0, 2]
    assert marks.aside.numbers == [1, 3]
    assert keep.tolist() == [0, 1, 2, 3, 6, 7]
    own = np.append(np.arange(B), B + keep)
    left = np.linalg.inv(less.sqrt_information[0])
    np.testing.assert_allclose(left @ left.T, p[np.ix_(own, own)], rtol=1e-9)
    again, mean = take_back(less, marks, [3, 1])
    order = np.append(own, [B + 8, B + 9, B + 4, B + 5])
    inverse = np.linalg.inv(again.sqrt_information[0])
    np.testing.assert_allclose(inverse @ inverse.T, p[np.ix_(order, order)], rtol=1e-8)
    # The mean too: where it is measured from plus the offset.
    _, border, moved = split(again, B)
    np.testing.assert_allclose(border + moved[B:], offset[order[B:]], rtol=1e-8)
    np.testing.assert_allclose(border[-4:], mean)


def test_marginals_of_landmarks_aside_are_those_of_the_joint_distribution() -> None:
    """Given the covariance of the rest: gain, noise and what they share."""
    prior, marks, p, offset = known(1)
    less, _ = put_aside(prior, marks, [0])
    less, _ = put_aside(less, marks, [2, 3])
    left = np.linalg.inv(less.sqrt_information[0])
    columns = B + G + np.array([0, 1, 4, 5, 6, 7])
    whole = marks.aside.whole(left @ left.T)
    np.testing.assert_allclose(whole, p[np.ix_(columns, columns)], rtol=1e-8)
    np.testing.assert_allclose(
        marks.aside.marginals(left @ left.T)[1], p[B + G + 4 : B + G + 6, B + G + 4 : B + G + 6]
    )
    state, border, step = split(less, B)
    values = marks.aside.values(state + step[:B], border + step[B:])
    np.testing.assert_allclose(values.ravel(), offset[columns], rtol=1e-7)


def test_stepping_on_and_new_information_agree_with_a_dense_graph() -> None:
    """x hangs on s0; s0 is eliminated for s1; then s1 is measured: against one dense solve."""
    rng = np.random.default_rng(2)
    prior, marks, _p, _ = known(2, landmarks=2)
    prior = prior_table(np.zeros(B), np.zeros(G + 4), prior.sqrt_information[0])
    less, _ = put_aside(prior, marks, [1])
    n = less.calibration.stop
    move = np.column_stack([-rng.normal(size=(B, B)), rng.normal(size=(B, B))])
    right = rng.normal(size=B)
    rows = np.zeros((B + n + B, 2 * B + n + 1))
    own = less.sqrt_information[0]
    rows[: B + n, :B], rows[: B + n, 2 * B : -1] = own[:, :B], own[:, B:]
    rows[B + n :, : 2 * B], rows[B + n :, -1] = move, right
    whole = triangle(rows)
    aside = marks.aside
    aside.step(whole[:B], np.zeros(B))
    left = whole[B : B + B + n, B:-1]
    # Now the next state and the border are measured directly.
    seen, noise = rng.normal(size=B + n), 0.3
    after = np.concatenate([left, np.eye(B + n) / noise])
    told = np.append(whole[B : B + B + n, -1], seen / noise)
    mean = np.linalg.lstsq(after, told, rcond=None)[0]
    joint = np.linalg.inv(after.T @ after)
    # Dense: s0, parameters and both landmarks by the prior, then s1.
    size = B + G + 4
    dense = np.zeros((size + B + B + n, size + B))
    dense[:size, :size] = prior.sqrt_information[0]
    dense[size : size + B, :B], dense[size : size + B, size:] = move[:, :B], move[:, B:]
    dense[size + B : size + 2 * B, size:] = np.eye(B) / noise
    dense[size + 2 * B :, B : B + n] = np.eye(n) / noise
    target = np.concatenate([np.zeros(size), right, seen / noise])
    expected = np.linalg.lstsq(dense, target, rcond=None)[0]
    spread = np.linalg.inv(dense.T @ dense)
    x = slice(B + G + 2, B + G + 4)
    np.testing.assert_allclose(aside.mean + aside.gain @ mean, expected[x], rtol=1e-7)
    np.testing.assert_allclose(aside.whole(joint), spread[x, x], rtol=1e-7)


def test_a_walk_of_the_parameters_loosens_what_hangs_on_them() -> None:
    """As the dense covariance of the parameters before and after the walk says."""
    prior, marks, p, _ = known(3, landmarks=1)
    prior = prior_table(np.zeros(B), np.zeros(G + 2), prior.sqrt_information[0])
    less, _ = put_aside(prior, marks, [0])
    walk = np.array([0.5, 2.0])
    after, rows = after_walk(less, B, walk)
    marks.aside.walk(rows, split(less, B)[2])
    left = np.linalg.inv(after.sqrt_information[0])
    expected = p.copy()
    expected[B : B + G, B : B + G] += np.diag(walk**2)
    np.testing.assert_allclose(left @ left.T, expected[: B + G, : B + G], rtol=1e-8)
    np.testing.assert_allclose(marks.aside.whole(left @ left.T), p[B + G :, B + G :], rtol=1e-8)
    cross = marks.aside.gain @ (left @ left.T)
    np.testing.assert_allclose(cross, expected[B + G :, : B + G], rtol=1e-7)


def test_measuring_deviations_from_elsewhere_changes_nothing() -> None:
    """The values stay where they are, a turn of the body's axes included."""
    rng = np.random.default_rng(4)
    aside = Aside(B, 1)
    aside.numbers, aside.mean = [7], rng.normal(size=2)
    aside.gain, aside.covariance = rng.normal(size=(2, B + 1)), np.eye(2)
    state, border = np.array([0.3, -0.2, 0.0]), np.array([0.1])
    before = aside.values(state, border)
    aside.rebase(np.array([0.1, 0.4, 0.0]), np.array([0.5]))
    np.testing.assert_allclose(aside.values(state, border), before, atol=1e-12)
    # By a body that has turned a quarter, a step forward is one to the left of before.
    aside.rebase(np.array([0.1, 0.4, np.pi / 2]), np.array([0.5]))
    there = aside.gain.copy()
    aside.rebase(np.array([0.1, 0.4, 0.0]), np.array([0.5]))
    np.testing.assert_allclose(there[:, 0], aside.gain[:, 1], atol=1e-12)


def test_information_on_the_border_is_that_of_a_dense_solve() -> None:
    """One more residual on the border, at a point that is not the prior's."""
    rng = np.random.default_rng(5)
    prior, _, _p, offset = known(5, landmarks=1)
    by, r, at = rng.normal(size=(2, G + 2)), rng.normal(size=2), rng.normal(size=G + 2)
    more = informed(prior, B, at, r, by)
    # In deviations d from the prior's point: by (d - at) = -r.
    rows = np.concatenate([prior.sqrt_information[0], np.column_stack([np.zeros((2, B)), by])])
    right = np.append(prior.sqrt_information[0] @ offset, by @ at - r)
    np.testing.assert_allclose(
        split(more, B)[2], np.linalg.lstsq(rows, right, rcond=None)[0], rtol=1e-8
    )
    own = more.sqrt_information[0]
    np.testing.assert_allclose(own.T @ own, rows.T @ rows, rtol=1e-8)
