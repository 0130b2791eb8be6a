"""EKF-SLAM's loop over a drive, compiled: predict with the wheels, correct with what is seen."""

from __future__ import annotations

import numpy as np

from fgloc.core.compiled import compiled
from fgloc.core.geometry import wrap_scalar
from fgloc.core.measurements import Floats
from fgloc.filters.ekf_slam_association import find, forget, see, tire, widen
from fgloc.filters.ekf_slam_steps import (
    NEAR,
    birth,
    correct,
    point_seen,
    project,
    sight,
    sight_jacobian,
    wall_foot,
)
from fgloc.filters.ekf_slam_tables import (
    BEARING_VARIANCE,
    BIRTHS,
    BORN,
    CANDIDATES,
    FIELD_LEFT,
    FIELD_RANGE,
    FIELD_RIGHT,
    IDENTITY,
    LANDMARKS,
    LAST,
    LIVES,
    NUMBER,
    NUMBERS,
    PLACE_X,
    PLACE_Y,
    POINT,
    RANGE_SHARE,
    RANGE_VARIANCE,
    REFUSED,
    REJECTED,
    SIGHTINGS,
    STREAM,
    TOLD,
    USED,
    Codes,
)
from fgloc.filters.pose_ekf_kernel import predict


@compiled
def place(x: Floats, kind: int, mount: Floats, value: Floats, point: Floats) -> float:
    """Write where in the map (2,) a sighting puts its landmark; return a wall's normal there."""
    if kind == POINT:
        point_seen(x, mount, value[0], value[1], point)
        return 0.0
    return float(wall_foot(x, mount, value[0], value[1], value[2], point))


@compiled
def run_slam(
    begin: int,
    steps: Floats,
    step_covariances: Floats,
    emit: Codes,
    first_group: Codes,
    group_stream: Codes,
    group_first: Codes,
    group_row: Codes,
    group_turn: Floats,
    values: Floats,
    identities: Codes,
    kinds: Codes,
    streams: Floats,
    ranges: Floats,
    limits: Codes,
    gates: Floats,
    x: Floats,
    p: Floats,
    codes: Codes,
    shapes: Floats,
    waiting: Codes,
    waiting_shapes: Floats,
    waiting_places: Floats,
    root: Floats,
    field: Floats,
    tally: Codes,
    poses: Floats,
    covariances: Floats,
    status: Codes,
    numbers: Codes,
    innovations: Floats,
    whitened: Floats,
) -> int:
    """Filter from cut `begin` on; return the cut at which the arrays are full, or how many there
    are; -1 - cut where the state is no longer finite.

    See `fgloc.filters.ekf_slam_run.Run`, which owns all these arrays. O(E n²) for E sightings.
    """
    h, z, seen = np.empty((2, 5)), np.empty(2), np.empty(2)
    innovation, white, point = np.empty(2), np.empty(2), np.empty(2)
    needed, lives, unseen, patience = limits[0], limits[1], limits[2], limits[3]
    gate, identity_gate = gates[0], gates[1] * gates[1]
    for cut in range(begin, emit.size):
        new = group_first[first_group[cut + 1]] - group_first[first_group[cut]]
        if tally[LANDMARKS] + new > codes.shape[0] or tally[CANDIDATES] + new > waiting.shape[0]:
            return cut
        n = 3 + 2 * tally[LANDMARKS]
        if cut > 0:
            predict(x, p[:n, :n], steps[cut - 1], step_covariances[cut - 1])
        for group in range(first_group[cut], first_group[cut + 1]):
            stream = group_stream[group]
            kind, mount = kinds[stream], streams[stream, :3]
            r0, share, r1 = (
                streams[stream, RANGE_VARIANCE],
                streams[stream, RANGE_SHARE],
                streams[stream, BEARING_VARIANCE],
            )
            first, last = group_first[group], group_first[group + 1]
            # All of a scan are associated before any corrects, or the order would matter.
            match = np.empty(last - first, np.int64)
            for o in range(first, last):
                place(x, kind, mount, values[o], point)
                match[o - first] = find(
                    x,
                    codes,
                    waiting,
                    waiting_places,
                    tally,
                    stream,
                    identities[o],
                    point,
                    gate,
                )
            for o in range(first, last):
                k = match[o - first]
                normal = place(x, kind, mount, values[o], point)
                if kind == POINT:
                    seen[0], seen[1] = values[o, 0], values[o, 1]
                    field[stream, FIELD_RANGE] = max(field[stream, FIELD_RANGE], seen[0])
                    field[stream, FIELD_RIGHT] = min(field[stream, FIELD_RIGHT], seen[1])
                    field[stream, FIELD_LEFT] = max(field[stream, FIELD_LEFT], seen[1])
                else:
                    sight(x, mount, point[0], point[1], seen)
                variance = r0 + share * seen[0] * seen[0]
                if k == -1:
                    # Two pieces of one new wall, or one mark twice, are one landmark.
                    k = find(
                        x,
                        codes,
                        waiting,
                        waiting_places,
                        tally,
                        stream,
                        identities[o],
                        point,
                        gate,
                    )
                if k >= 0:
                    j = 3 + 2 * k
                    numbers[o] = codes[k, NUMBER]
                    if sight(x, mount, x[j], x[j + 1], z) < NEAR:
                        status[o] = TOLD
                        continue
                    innovation[0] = seen[0] - z[0]
                    innovation[1] = wrap_scalar(seen[1] - z[1])
                    sight_jacobian(x, mount, x[j], x[j + 1], h)
                    squared = project(p, n, j, h, variance, r1, innovation, root, white)
                    innovations[o], whitened[o] = innovation, white
                    limit = identity_gate if identities[o] >= 0 else np.inf
                    if squared > limit and codes[k, REFUSED] < patience:
                        codes[k, REFUSED] += 1
                        status[o] = REJECTED
                        continue
                    if not squared >= 0.0:
                        status[o] = REJECTED
                        continue
                    correct(x, p, n, root, white)
                    status[o] = USED
                    codes[k, REFUSED] = 0
                    see(codes[k], group, lives)
                    shapes[k, PLACE_X], shapes[k, PLACE_Y] = x[j], x[j + 1]
                    normal = place(x, kind, mount, values[o], point)
                    widen(shapes[k], kind, values[o], normal, mount, x)
                    continue
                if k == -1:
                    w = tally[CANDIDATES]
                    tally[CANDIDATES] = w + 1
                    waiting[w, NUMBER] = tally[NUMBERS]
                    tally[NUMBERS] += 1
                    waiting[w, STREAM], waiting[w, IDENTITY] = stream, identities[o]
                    waiting[w, SIGHTINGS], waiting[w, LAST], waiting[w, REFUSED] = 0, -1, 0
                    waiting[w, LIVES] = lives if identities[o] < 0 else -1
                    waiting_shapes[w] = 0.0
                    waiting_places[w, 0], waiting_places[w, 1] = point[0], point[1]
                else:
                    w = -2 - k
                numbers[o] = waiting[w, NUMBER]
                if waiting[w, LIVES] == 0:
                    # It was born by another piece of the same wall in this scan.
                    status[o] = TOLD
                    continue
                if waiting[w, LAST] != group:
                    # The mean of all sightings so far: what is waiting has no covariance.
                    part = 1.0 / (1.0 + waiting[w, SIGHTINGS])
                    for a in range(2):
                        waiting_places[w, a] += part * (point[a] - waiting_places[w, a])
                        waiting_shapes[w, PLACE_X + a] = waiting_places[w, a]
                see(waiting[w], group, lives)
                widen(waiting_shapes[w], kind, values[o], normal, mount, x)
                status[o] = TOLD
                enough = waiting[w, SIGHTINGS] >= needed or identities[o] >= 0
                if enough:
                    k = tally[LANDMARKS]
                    birth(x, p, n, mount, seen[0], seen[1], variance, r1)
                    n += 2
                    codes[k], shapes[k] = waiting[w], waiting_shapes[w]
                    tally[LANDMARKS] = k + 1
                    tally[BIRTHS] += 1
                    # Taken out after the scan, so that the numbers of the others stay.
                    waiting[w, LIVES] = 0
                    status[o] = BORN
            for k in range(tally[LANDMARKS]):
                shapes[k, PLACE_X], shapes[k, PLACE_Y] = x[3 + 2 * k], x[4 + 2 * k]
            sky = (streams[stream], field[stream], ranges, group_row[group], group_turn[group])
            tire(x, kind, stream, group, unseen, codes, shapes, tally[LANDMARKS], *sky)
            tire(x, kind, stream, group, unseen, waiting, waiting_shapes, tally[CANDIDATES], *sky)
            n = forget(x, p, n, codes, shapes, waiting, waiting_shapes, waiting_places, tally)
        if not (np.isfinite(x[0]) and np.isfinite(x[1]) and np.isfinite(x[2])):
            return -1 - cut
        at = emit[cut]
        if at >= 0:
            for a in range(3):
                poses[at, a] = x[a]
                for b in range(3):
                    covariances[at, a, b] = p[a, b]
    return int(emit.size)
