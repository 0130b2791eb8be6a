"""The methods that can be compared: their ids, what they are, how they are made."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, is_dataclass
from typing import Any

from fgloc.core.geometry import Integrator
from fgloc.errors import FglocError
from fgloc.estimator import Estimator


@dataclass(frozen=True)
class Method:
    """One method id of the contract."""

    id: str
    """Id on the command line and in JSON."""
    summary: str
    """What it does, in a few words for a table or help text."""
    build: Callable[[Integrator], Estimator]
    """Make the estimator."""


def _model1(integrator: Integrator) -> Estimator:
    from fgloc.filters.model1 import Model1

    return Model1(integrator)


def _model2(integrator: Integrator) -> Estimator:
    from fgloc.filters.model2 import Model2

    return Model2()


def _model3(integrator: Integrator) -> Estimator:
    from fgloc.filters.model3 import Model3

    return Model3()


def _pose_ekf(integrator: Integrator) -> Estimator:
    from fgloc.filters.pose_ekf import PoseEkf

    return PoseEkf()


def _rl_ekf(integrator: Integrator) -> Estimator:
    from fgloc.filters.rl_ekf import RlEkf

    return RlEkf()


def _ekf_slam(integrator: Integrator) -> Estimator:
    from fgloc.filters.ekf_slam import EkfSlam

    return EkfSlam()


def _batch(integrator: Integrator) -> Estimator:
    # Imported here because it brings GTSAM, which Models 1 and 2 do without.
    from fgloc.smoothing.batch import BatchSmoother

    return BatchSmoother()


def _online(integrator: Integrator) -> Estimator:
    from fgloc.online.online import OnlineSmoother

    return OnlineSmoother()


METHODS: tuple[Method, ...] = (
    Method("model1", "wheels only, nominal parameters", _model1),
    Method("model2", "distance from wheels, heading from the yaw sensor", _model2),
    Method("model3", "unscented filter of pose and effective track", _model3),
    Method("pose-ekf", "extended Kalman filter of the pose", _pose_ekf),
    Method("rl-ekf", "filter like robot_localization's, with its ekf.yaml", _rl_ekf),
    Method("ekf-slam", "extended Kalman filter of pose and landmarks", _ekf_slam),
    Method("batch", "factor graph over the whole drive, with calibration", _batch),
    Method("online", "factor graph over a sliding window, as it would run live", _online),
)


def available() -> tuple[str, ...]:
    """Return the ids of the methods that this version can run."""
    return tuple(m.id for m in METHODS)


def create(method: str, *, integrator: Integrator = "exact") -> Estimator:
    """Return a new estimator; `integrator` concerns Model 1 only.

    Raises FglocError for an id that is unknown.
    """
    for known in METHODS:
        if known.id == method:
            return known.build(integrator)
    raise FglocError(f"unknown method {method!r}; choose from {', '.join(available())}")


def parse(text: str | Sequence[str]) -> tuple[str, ...]:
    """Return the method ids of "a,b" (or a sequence), checked, each once, in the given order.

    Raises FglocError for an empty list and as `create` does.
    """
    words = text.split(",") if isinstance(text, str) else text
    ids = tuple(dict.fromkeys(w.strip() for w in words if w.strip()))
    if not ids:
        raise FglocError(f"no method is named; choose from {', '.join(available())}")
    for one in ids:
        if one not in available():
            create(one)  # raises with the reason
    return ids


def resolved(estimator: Estimator) -> dict[str, Any]:
    """Return every setting of an estimator, defaults included; {} for one without settings."""
    settings = getattr(estimator, "settings", estimator)
    if not is_dataclass(settings) or isinstance(settings, type):
        return {}
    return asdict(settings)
