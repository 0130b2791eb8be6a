"""Heading: absolute yaw with an unknown zero, integrated yaw rate with a bias, and their walks."""

from __future__ import annotations

from fgloc.core.compiled import compiled
from fgloc.core.geometry import Floats, wrap_scalar


@compiled
def yaw(
    xi: Floats,
    xj: Floats,
    g: Floats,
    m: Floats,
    slot: int,
    r: Floats,
    ji: Floats,
    jj: Floats,
    jg: Floats,
) -> None:
    """Residual theta + zero + rate·t - reading, wrapped; m = [reading, t].

    The zero is state column `slot` where it wanders, or the first calibration variable; the rate
    of a constant drift is the next calibration variable, where the block has one.
    """
    ji[0, 2] = 1.0
    rate = 0
    if slot >= 0:
        zero = xi[slot]
        ji[0, slot] = 1.0
    else:
        zero = g[0]
        jg[0, 0] = 1.0
        rate = 1
    if g.size > rate:
        zero += g[rate] * m[1]
        jg[0, rate] = m[1]
    r[0] = wrap_scalar(xi[2] + zero - m[0])


@compiled
def yaw_rate(
    xi: Floats,
    xj: Floats,
    g: Floats,
    m: Floats,
    slot: int,
    r: Floats,
    ji: Floats,
    jj: Floats,
    jg: Floats,
) -> None:
    """Residual (theta_j - theta_i) + bias·T - turned angle; m = [turned angle, T].

    The gyro reads rate + bias; the bias is state column `slot` of keyframe i, or g[0]. The angle
    is not wrapped: a gyro may turn more than half a turn between keyframes.
    """
    ji[0, 2], jj[0, 2] = -1.0, 1.0
    if slot >= 0:
        bias = xi[slot]
        ji[0, slot] = m[1]
    else:
        bias = g[0]
        jg[0, 0] = m[1]
    r[0] = xj[2] - xi[2] + bias * m[1] - m[0]


@compiled
def zero_walk(
    xi: Floats,
    xj: Floats,
    g: Floats,
    m: Floats,
    slot: int,
    r: Floats,
    ji: Floats,
    jj: Floats,
    jg: Floats,
) -> None:
    """Residual of a random walk: the change of the sensor zero in column `slot`; m is unused."""
    ji[0, slot], jj[0, slot] = -1.0, 1.0
    r[0] = xj[slot] - xi[slot]


@compiled
def zero_prior(
    xi: Floats,
    xj: Floats,
    g: Floats,
    m: Floats,
    slot: int,
    r: Floats,
    ji: Floats,
    jj: Floats,
    jg: Floats,
) -> None:
    """Residual of a prior on the sensor zero in column `slot`; m = [mean]."""
    ji[0, slot] = 1.0
    r[0] = xi[slot] - m[0]
