"""What the graph knows of a lidar's surroundings: which segment is which wall."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from fgloc.core.geometry import compose, wrap
from fgloc.core.measurements import Floats, Scans, Stamps
from fgloc.factors.robust import Loss
from fgloc.factors.tables import FactorTable, Kind
from fgloc.lidar.association import lidar_poses
from fgloc.lidar.segments import Segments
from fgloc.lidar.walls import Walls


@dataclass(frozen=True)
class Scene:
    """The segments of a drive as part of its graph."""

    scans: Scans
    """The scans that are used."""
    numbers: Stamps
    """(N,) which of the drive's scans they are."""
    segments: Segments
    """Straight walls in them."""
    at: Stamps
    """(N,) keyframe of each scan."""
    block: slice
    """Columns of the lidar's mounting in the calibration; empty where it is known exactly."""
    first: int
    """Place of the first wall among the landmarks."""
    wall: Stamps
    """(M,) wall of each segment, -1 for none."""
    anchors: Floats
    """(L, 2) anchors of the walls [m], map axes."""

    def mount(self, u: Floats) -> tuple[float, float, float]:
        """Return the lidar's pose on the robot at the calibration u (G,)."""
        x, y, yaw = self.scans.mount
        if self.block.start == self.block.stop:
            return x, y, yaw
        off = u[self.block].tolist()
        return x + off[0], y + off[1], yaw + off[2]

    def table(self, loss: Loss) -> FactorTable:
        """Return one factor for each segment that belongs to a wall."""
        used = np.flatnonzero(self.wall >= 0)
        seen = self.segments.select(used)
        wall = self.wall[used]
        mount = np.broadcast_to(np.array(self.scans.mount), (used.size, 3))
        rows = np.concatenate(
            [seen.normal[:, None], seen.middle, self.anchors[wall], mount], axis=1
        )
        return FactorTable(
            Kind.WALL,
            self.scans.sensor,
            self.at[seen.scan],
            rows,
            np.linalg.inv(np.linalg.cholesky(seen.covariance)),
            self.block,
            loss,
            second=self.first + wall,
        )

    def walls(
        self,
        landmarks: Floats,
        covariance: Floats | None,
        poses: Floats,
        u: Floats,
    ) -> Walls:
        """Return the walls at a solution.

        Landmarks (…, 2) and their covariances, the robot's poses (K, 3) and the calibration (G,).
        """
        count = self.anchors.shape[0]
        mine = landmarks[self.first : self.first + count]
        normal = wrap(mine[:, 0])
        used = np.flatnonzero(self.wall >= 0)
        seen, of = self.segments.select(used), self.wall[used]
        lidar = lidar_poses(poses[self.at[seen.scan]], self.mount(u))
        there = compose(lidar, np.column_stack([seen.middle, seen.normal]))[:, :2]
        tangent = np.stack([-np.sin(normal), np.cos(normal)], axis=1)
        along = np.einsum("mk,mk->m", there - self.anchors[of], tangent[of])
        reach = np.stack([np.full(count, np.inf), np.full(count, -np.inf)], axis=1)
        np.minimum.at(reach[:, 0], of, along + seen.reach[:, 0])
        np.maximum.at(reach[:, 1], of, along + seen.reach[:, 1])
        reach[~np.isfinite(reach)] = 0.0
        unknown = np.full((count, 2, 2), np.nan)
        return Walls(
            normal,
            mine[:, 1].copy(),
            self.anchors,
            reach,
            unknown if covariance is None else covariance[self.first : self.first + count],
            np.bincount(of, minlength=count).astype(np.int64),
        )

    def with_walls(self, walls: Walls, wall: Stamps) -> tuple[Scene, Floats]:
        """Return the scene with these walls, and their landmarks (L, 2)."""
        landmarks = np.stack([walls.normal, walls.offset], axis=1)
        return replace(self, wall=wall, anchors=walls.anchor), landmarks
