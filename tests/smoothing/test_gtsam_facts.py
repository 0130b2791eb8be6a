"""What was measured about GTSAM and shapes the engines; each test names the fact it keeps.

Should one of these fail with a newer GTSAM, a reason for the present design has gone.
"""

from __future__ import annotations

import pickle
import subprocess
import sys
import threading

import gtsam
import numpy as np
import pytest

from fgloc.core.geometry import exp_jacobian_scalar
from fgloc.core.measurements import Floats

Key = int


def custom_chain(hold: bool) -> tuple[list[gtsam.Values], gtsam.Values]:
    """Return the Values that callbacks of CustomFactors were given, and iSAM2's own."""
    seen: list[gtsam.Values] = []

    def error(
        factor: gtsam.CustomFactor, values: gtsam.Values, jacobians: list[Floats] | None
    ) -> Floats:
        seen.append(values)
        pose = values.atPose2(factor.keys()[0])
        if jacobians is not None:
            jacobians[0] = np.eye(3)
        return np.array([pose.x(), pose.y(), pose.theta()])

    isam = gtsam.ISAM2(gtsam.ISAM2Params())
    held = isam.getLinearizationPoint() if hold else None
    unit = gtsam.noiseModel.Unit.Create(3)
    for key in range(4):
        graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
        graph.add(gtsam.CustomFactor(unit, [key], error))
        values.insert(key, gtsam.Pose2(0.1, 0.2, 0.3))
        isam.update(graph, values)
    return seen, held if held is not None else isam.getLinearizationPoint()


def test_fact_1_a_held_linearisation_point_is_what_callbacks_get() -> None:
    seen, held = custom_chain(hold=True)
    assert len(seen) >= 4
    assert all(values is held for values in seen)
    assert held.size() == 4


def test_fact_1_without_holding_it_every_callback_gets_a_copy_of_everything() -> None:
    seen, own = custom_chain(hold=False)
    assert not any(values is own for values in seen)
    assert len({id(values) for values in seen}) == len(seen)
    # The copies are whole: the last one holds all poses though its factor needs one.
    assert seen[-1].size() == 4


def chain_with_calibration(keyframes: int) -> gtsam.GaussianFactorGraph:
    """Return a chain of poses whose every factor shares one calibration variable."""
    rng = np.random.default_rng(0)
    graph, unit = gtsam.GaussianFactorGraph(), gtsam.noiseModel.Unit.Create(3)
    one, none = np.eye(3), np.zeros(3)
    graph.add(gtsam.JacobianFactor(0, 1e3 * one, none, unit))
    graph.add(gtsam.JacobianFactor(keyframes, 10.0 * one, none, unit))
    for k in range(keyframes - 1):
        shared = rng.normal(size=(3, 3))
        graph.add(
            gtsam.JacobianFactor(k, -30.0 * one, k + 1, 30.0 * one, keyframes, shared, none, unit)
        )
    return graph


def tree_depth(graph: gtsam.GaussianFactorGraph, ordering: gtsam.Ordering) -> int:
    """Return the depth of the elimination tree: how deep GTSAM's recursion goes."""
    place = {ordering.at(i): i for i in range(ordering.size())}
    net = graph.eliminateSequential(ordering)
    parent: dict[Key, Key | None] = {}
    for i in range(net.size()):
        key, *others = net.at(i).keys()
        parent[key] = min(others, key=lambda k: place[k]) if others else None
    depth: dict[Key, int] = {}
    for key in sorted(parent, key=lambda k: -place[k]):
        above = parent[key]
        depth[key] = 1 if above is None else depth[above] + 1
    return max(depth.values())


def test_facts_2_and_4_colamd_goes_as_deep_as_the_chain_metis_does_not() -> None:
    # The time COLAMD loses on a shared calibration and the stack it overflows both come from
    # a tree without branches; nested dissection halves the chain again and again.
    short, long = chain_with_calibration(256), chain_with_calibration(2048)
    deep = [tree_depth(g, gtsam.Ordering.ColamdGaussianFactorGraph(g)) for g in (short, long)]
    flat = [tree_depth(g, gtsam.Ordering.MetisGaussianFactorGraph(g)) for g in (short, long)]
    assert deep[0] >= 256
    assert deep[1] >= 2048
    assert flat[0] < 20
    assert flat[1] < 30


STEP = gtsam.Pose2(0.1, 0.0, 0.0)


def dead_reckoning(isam: gtsam.ISAM2, first: int, end: int) -> None:
    """Add poses first ≤ k < end of a healthy straight chain, one update each."""
    tight = gtsam.noiseModel.Isotropic.Sigma(3, 1e-4)
    wheels = gtsam.noiseModel.Diagonal.Sigmas(np.array([1e-3, 1e-3, 1e-2]))
    for k in range(first, end):
        graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
        if k == 0:
            graph.add(gtsam.PriorFactorPose2(0, gtsam.Pose2(), tight))
        else:
            graph.add(gtsam.BetweenFactorPose2(k - 1, k, STEP, wheels))
        values.insert(k, gtsam.Pose2(0.1 * k, 0.0, 0.0))
        isam.update(graph, values)


def solver(factorization: str) -> gtsam.ISAM2:
    settings = gtsam.ISAM2Params()
    settings.setFactorization(factorization)
    return gtsam.ISAM2(settings)


def test_fact_3_cholesky_calls_healthy_dead_reckoning_indeterminate() -> None:
    with pytest.raises(RuntimeError, match="Indeterminate linear system"):
        dead_reckoning(solver("CHOLESKY"), 0, 800)


def test_fact_3_qr_does_not() -> None:
    isam = solver("QR")
    dead_reckoning(isam, 0, 800)
    assert isam.calculateEstimatePose2(799).x() == pytest.approx(79.9, abs=1e-6)


def test_fact_5_after_an_exception_isam2_is_corrupt_and_does_not_say_so() -> None:
    isam = solver("CHOLESKY")
    dead_reckoning(isam, 0, 10)
    # One update with a good measurement (pose 3 is 1 m to the left) and a pair of new poses
    # that nothing ties to the rest.
    bad, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    tight = gtsam.noiseModel.Isotropic.Sigma(3, 1e-3)
    bad.add(gtsam.PriorFactorPose2(3, gtsam.Pose2(0.3, 1.0, 0.0), tight))
    bad.add(gtsam.BetweenFactorPose2(998, 999, STEP, tight))
    for key in (998, 999):
        values.insert(key, gtsam.Pose2(5.0, 5.0, 1.0))
    with pytest.raises(RuntimeError, match="Indeterminate linear system"):
        isam.update(bad, values)
    # The factors of the update that failed are in, their variables exist ...
    assert isam.getFactorsUnsafe().size() == 12
    assert isam.valueExists(999)
    # ... reading works, but knows nothing of the measurement that is in the graph ...
    assert isam.calculateEstimatePose2(3).y() == pytest.approx(0.0, abs=1e-9)
    # ... and a healthy update, which a fresh iSAM2 takes, fails.
    with pytest.raises(RuntimeError, match="Indeterminate linear system"):
        dead_reckoning(isam, 10, 11)


def body_jacobian(twist: Floats) -> Floats:
    """Return our derivative of the exponential map by the twist, in the axes of its end."""
    derivative = np.empty((3, 3))
    exp_jacobian_scalar(twist, derivative)
    c, s = np.cos(twist[2]), np.sin(twist[2])
    derivative[:2] = np.array([[c, s], [-s, c]]) @ derivative[:2]
    return derivative


@pytest.mark.parametrize("turn", [1e-3, 1e-4, 2e-5, 1.1e-5, 9e-6, 1e-6, -2e-5, 0.3])
def test_fact_9_our_derivative_is_exact_where_gtsams_logarithm_is_not(turn: float) -> None:
    twist = np.array([10.0, 5.0, turn])
    # Power series of (sin t / t, (1 - cos t) / t) and derivatives, enough terms for t = 0.3:
    # Expmap's right Jacobian is the sum over n of (-ad)^n / (n+1)!.
    ad = np.array([[0.0, -turn, twist[1]], [turn, 0.0, -twist[0]], [0.0, 0.0, 0.0]])
    exact, term = np.eye(3), np.eye(3)
    for n in range(1, 20):
        term = term @ -ad / (n + 1)
        exact = exact + term
    np.testing.assert_allclose(body_jacobian(twist), exact, atol=1e-12)


def test_fact_9_gtsams_logarithm_has_a_wrong_derivative_near_1e_5() -> None:
    def defect(turn: float) -> float:
        twist = np.array([10.0, 5.0, turn])
        logarithm = gtsam.Pose2.LogmapDerivative(gtsam.Pose2.Expmap(twist))
        return float(np.abs(logarithm @ body_jacobian(twist) - np.eye(3)).max())

    assert defect(0.3) < 1e-9
    assert defect(2e-5) > 1e-3


def shared_vector(
    smoother: gtsam.IncrementalFixedLagSmoother, first: int, end: int, restamp: bool
) -> None:
    """Add poses first ≤ k < end, one a second, and a shared variable 999 that every one sees."""
    tight = gtsam.noiseModel.Isotropic.Sigma(3, 1e-2)
    for k in range(first, end):
        graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
        stamps = {k: float(k)}
        if k == 0:
            graph.add(gtsam.PriorFactorPose2(0, gtsam.Pose2(), tight))
            graph.add(gtsam.PriorFactorPose2(999, gtsam.Pose2(), tight))
            values.insert(999, gtsam.Pose2())
            stamps[999] = 0.0
        else:
            graph.add(gtsam.BetweenFactorPose2(k - 1, k, STEP, tight))
            if restamp or k < 5:
                graph.add(gtsam.BetweenFactorPose2(999, k, gtsam.Pose2(0.1 * k, 0.0, 0.0), tight))
        if restamp:
            stamps[999] = float(k)
        values.insert(k, gtsam.Pose2(0.1 * k, 0.0, 0.0))
        smoother.update(graph, values, stamps)


def test_fact_6_what_is_not_stamped_again_is_lost() -> None:
    smoother = gtsam.IncrementalFixedLagSmoother(6.0, gtsam.ISAM2Params())
    shared_vector(smoother, 0, 12, restamp=True)
    assert smoother.calculateEstimatePose2(999).x() == pytest.approx(0.0, abs=1e-9)
    # Without, an update or a read fails, whichever comes first.
    smoother = gtsam.IncrementalFixedLagSmoother(6.0, gtsam.ISAM2Params())
    with pytest.raises((IndexError, ValueError)):  # noqa: PT012
        shared_vector(smoother, 0, 12, restamp=False)
        smoother.calculateEstimatePose2(999)


@pytest.mark.parametrize("reuse", [True, False])
def test_fact_6_factor_slots_are_only_used_again_on_demand(reuse: bool) -> None:
    settings = gtsam.ISAM2Params()
    settings.findUnusedFactorSlots = reuse
    smoother = gtsam.IncrementalFixedLagSmoother(6.0, settings)
    shared_vector(smoother, 0, 60, restamp=True)
    # Two factors a pose and one marginal; the window has seven poses.
    assert (smoother.getFactors().size() < 30) == reuse
    assert reuse or smoother.getFactors().size() > 150


def scaled_chain(segment: int) -> tuple[gtsam.ISAM2, gtsam.ISAM2Result]:
    """Return a chain of 200 poses whose scale jumps at its end, a key for `segment` of them.

    Pose k is the one before plus 0.1 m times the scale; a late fix says that it was 5 % off.
    """
    settings = gtsam.ISAM2Params()
    settings.relinearizeSkip = 1
    settings.setRelinearizeThreshold(0.01)
    isam = gtsam.ISAM2(settings)
    held = isam.getLinearizationPoint()
    unit, count = gtsam.noiseModel.Unit.Create(1), 200
    tight, walk = (gtsam.noiseModel.Isotropic.Sigma(1, s) for s in (1e-3, 1e-2))

    def step(k: int) -> gtsam.CustomFactor:
        keys = [k - 1, k, 1000 + k // segment]

        def error(_: gtsam.CustomFactor, values: gtsam.Values, jacobians: list[Floats]) -> Floats:
            x, y, scale = (values.atVector(key) for key in keys)
            if jacobians is not None:
                jacobians[0], jacobians[1] = np.full((1, 1), -1e3), np.full((1, 1), 1e3)
                jacobians[2] = -100.0 * np.exp(scale)[None]
            return np.asarray(1e3 * (y - x - 0.1 * np.exp(scale)))

        return gtsam.CustomFactor(unit, keys, error)

    for k in range(count):
        graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
        values.insert(k, np.array([0.1 * k]))
        if k % segment == 0:
            key = 1000 + k // segment
            values.insert(key, np.zeros(1))
            graph.add(gtsam.PriorFactorVector(key, np.zeros(1), gtsam.noiseModel.Unit.Create(1)))
            if k:
                graph.add(gtsam.BetweenFactorVector(key - 1, key, np.zeros(1), walk))
        if k % 20 == 0:
            graph.add(gtsam.PriorFactorVector(k, np.array([0.1 * k]), tight))
        if k:
            graph.add(step(k))
        isam.update(graph, values)
    graph = gtsam.NonlinearFactorGraph()
    # Tight fixes hold all that is old; the newest segment alone is told of another scale.
    last = 1000 + (count - 1) // segment
    graph.add(
        gtsam.PriorFactorVector(last, np.full(1, 0.05), gtsam.noiseModel.Isotropic.Sigma(1, 1e-5))
    )
    isam.update(graph, gtsam.Values())
    assert held.size() == isam.getLinearizationPoint().size()
    return isam, isam.update()


def test_fact_7_one_calibration_key_makes_a_late_jump_move_everything() -> None:
    _, shared = scaled_chain(segment=1000)
    _, segments = scaled_chain(segment=50)
    assert shared.getVariablesReeliminated() > 195
    assert segments.getVariablesReeliminated() < 120


def test_fact_8_callbacks_let_other_threads_see_half_an_update() -> None:
    isam = gtsam.ISAM2(gtsam.ISAM2Params())
    held = isam.getLinearizationPoint()
    inside, looked = threading.Event(), threading.Event()
    seen: list[tuple[bool, bool]] = []

    def error(_: gtsam.CustomFactor, values: gtsam.Values, jacobians: list[Floats]) -> Floats:
        inside.set()
        looked.wait(10.0)
        if jacobians is not None:
            jacobians[0] = np.eye(3)
        return values.atVector(0) - 1.0

    def look() -> None:
        inside.wait(10.0)
        # The variable is there, its solution is not.
        try:
            isam.calculateEstimateVector(0)
            solved = True
        except (IndexError, RuntimeError):
            solved = False
        seen.append((held.exists(0), solved and isam.calculateEstimateVector(0)[0] == 1.0))
        looked.set()

    other = threading.Thread(target=look)
    other.start()
    graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    graph.add(gtsam.CustomFactor(gtsam.noiseModel.Unit.Create(3), [0], error))
    values.insert(0, np.zeros(3))
    isam.update(graph, values)
    other.join()
    assert seen == [(True, False)]
    np.testing.assert_allclose(isam.calculateEstimateVector(0), 1.0)


def test_fact_8_a_custom_factor_cannot_be_sent_to_another_process() -> None:
    factor = gtsam.CustomFactor(gtsam.noiseModel.Unit.Create(3), [0], lambda *_: np.zeros(3))
    with pytest.raises((TypeError, RuntimeError)):
        pickle.dumps(factor)


def test_fact_10_what_users_start_first_loads_none_of_the_heavy_libraries() -> None:
    # That open3d loads without libusb-1.0 is tested in tests/test_lazy.py.
    script = (
        "import sys, fgloc.cli\n"
        "print([m for m in ('open3d', 'matplotlib', 'scipy', 'gtsam') if m in sys.modules])"
    )
    done = subprocess.run(
        [sys.executable, "-c", script], capture_output=True, text=True, timeout=60
    )
    assert done.stdout.strip() == "[]", done.stderr
