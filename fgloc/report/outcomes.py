"""What a comparison found: results and their scores, by drive and method; input of all reports."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from fgloc.core.drive import Drive
from fgloc.core.evaluation import Evaluation
from fgloc.core.totals import Totals
from fgloc.estimator import Mount, Result


@dataclass(frozen=True)
class MethodOutcome:
    """One method on one drive."""

    result: Result
    """What the method returned."""
    evaluation: Evaluation | None
    """Its errors; None where the drive has no truth."""
    mount: Mount = (0.0, 0.0, 0.0)
    """Mounting of the reference used for the errors, calibrated where the method did that."""


@dataclass(frozen=True)
class DriveOutcome:
    """All methods on one drive."""

    drive: Drive
    """What was offered to every method, fixes included."""
    methods: Mapping[str, MethodOutcome]
    """Outcome by method id, in the order asked for."""
    skipped: Mapping[str, str] = field(default_factory=dict)
    """Why a method could not run here, by method id."""


@dataclass(frozen=True)
class Settings:
    """What a comparison was asked for, beside drives and methods."""

    integrator: str = "exact"
    """Step of Model 1."""
    fixes: tuple[float, float] | None = None
    """Time between position fixes [s] and their sigma [m]; None if none were made."""
    seed: int = 0
    """Seed of the fixes' noise."""
    robot_file: str | None = None
    """Path of the robot file; None if the drives' own descriptions were used."""
    topics_file: str | None = None
    """Path of the topic map of ROS bags; None if it was guessed or the dataset's own."""
    ekf_file: str | None = None
    """Path given to --ekf; None if rl-ekf made its configuration from the drives' sensors."""
    encoder_selection: bool = False
    """Whether one encoder a side was selected for every method."""


@dataclass(frozen=True)
class Comparison:
    """Several methods on several drives."""

    methods: tuple[str, ...]
    """Method ids in the order asked for."""
    drives: tuple[DriveOutcome, ...]
    """One outcome a drive, in the order asked for."""
    total: Mapping[str, Totals]
    """Totals by method id; methods without any evaluated drive are missing."""
    settings: Settings = Settings()
    """What was asked for."""

    @property
    def total_is(self) -> str:
        """Return what the numbers in `total` are, in words."""
        if all(d.drive.motion is not None for d in self.drives):
            return "sum over motions of the mean e_max over repetitions"
        return "mean of e_max over drives"

    def evaluated(self, method: str) -> int:
        """Return the number of drives on which a method was scored."""
        outcomes = (d.methods.get(method) for d in self.drives)
        return sum(o is not None and o.evaluation is not None for o in outcomes)
