"""What became of every sensor's measurements."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from fgloc.core.measurements import Floats
from fgloc.estimator import DOWN_WEIGHTED, SensorCount


@dataclass
class Tally:
    """What became of one sensor's measurements."""

    accepted: int = 0
    """Factors with (nearly) full weight."""
    down_weighted: int = 0
    """Factors with a weight below 0.25."""
    rejected: dict[str, int] = field(default_factory=dict)
    """Measurements that did not become factors, by reason."""
    nis: float = 0.0
    """Sum of the normalised innovations squared of its factors."""
    components: int = 0
    """How many residual components they have."""

    def reject(self, reason: str, count: int = 1) -> None:
        """Count measurements that could not be used."""
        if count:
            self.rejected[reason] = self.rejected.get(reason, 0) + count

    def gone(self, weights: Floats) -> None:
        """Count factors that leave the window, by their last weights."""
        low = int(np.count_nonzero(weights < DOWN_WEIGHTED))
        self.down_weighted += low
        self.accepted += weights.size - low

    @property
    def used(self) -> bool:
        """Return True if any measurement became a factor."""
        return self.accepted + self.down_weighted > 0

    def count(self) -> SensorCount:
        """Return the numbers for a result."""
        return SensorCount(self.accepted, self.down_weighted, sum(self.rejected.values()))
