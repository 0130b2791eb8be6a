"""What can go wrong between a robot's sensors and the engine, as changes of a list of packets."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from fgloc.online.replay import Packet

Mutation = Callable[[list[Packet], np.random.Generator], list[Packet]]
"""From the packets as they would have arrived to those that do."""

S = 1_000_000_000
BAD = (0.0, -1.0, float("nan"), float("inf"), 1e-300, 1e300, -1e300)
"""Numbers that no sensor should send."""


def _times(packets: list[Packet]) -> tuple[int, int]:
    """Return first and last stamp."""
    stamps = [p.stamp_ns for p in packets]
    return min(stamps), max(stamps)


def _some(packets: list[Packet], rng: np.random.Generator, share: float) -> list[bool]:
    """Return which packets a fault hits: of one stream, or of all."""
    names = sorted({p.sensor for p in packets})
    name = names[int(rng.integers(len(names)))]
    every = rng.random() < 0.3
    return [(every or p.sensor == name) and rng.random() < share for p in packets]


def _window(packets: list[Packet], rng: np.random.Generator, seconds: float) -> tuple[int, int]:
    """Return an interval of time somewhere in the drive."""
    first, last = _times(packets)
    begin = first + int(rng.random() * max(last - first, 1))
    return begin, begin + int(seconds * S)


def silence(packets: list[Packet], rng: np.random.Generator) -> list[Packet]:
    """Leave a stream, or all of them, out for 20 s."""
    begin, end = _window(packets, rng, 20.0)
    hit = _some(packets, rng, 1.0)
    return [p for p, h in zip(packets, hit, strict=True) if not (h and begin <= p.stamp_ns < end)]


def bad_values(packets: list[Packet], rng: np.random.Generator) -> list[Packet]:
    """Put numbers that are none into some packets."""
    out = []
    for p, hit in zip(packets, _some(packets, rng, 0.03), strict=True):
        values = p.values.copy()
        if hit:
            values[int(rng.integers(values.size))] = rng.choice(BAD)
        out.append(replace(p, values=values))
    return out


def bad_sigmas(packets: list[Packet], rng: np.random.Generator) -> list[Packet]:
    """Put impossible sigmas (or steering angles) into some packets."""
    out = []
    for p in packets:
        extra = p.extra
        if extra is not None and rng.random() < 0.1:
            extra = extra.copy()
            extra[int(rng.integers(extra.size))] = rng.choice(BAD)
        out.append(replace(p, extra=extra))
    return out


def clock_step(packets: list[Packet], rng: np.random.Generator) -> list[Packet]:
    """Set the clock of a stream, or of all, 5 s back or an hour on, for a while or for good."""
    begin, end = _window(packets, rng, float(rng.choice([0.3, 3.0, 20.0, 1e6])))
    step = int(rng.choice([-5 * S, 3600 * S, -3600 * S, S // 2]))
    return [
        replace(p, stamp_ns=p.stamp_ns + step) if h and begin <= p.stamp_ns < end else p
        for p, h in zip(packets, _some(packets, rng, 1.0), strict=True)
    ]


def duplicate(packets: list[Packet], rng: np.random.Generator) -> list[Packet]:
    """Send some packets twice, some of the second ones later."""
    out = [(i, p) for i, p in enumerate(packets)]
    late = float(rng.choice([0.0, 5.0, 200.0]))
    for i, hit in enumerate(_some(packets, rng, 0.2)):
        if hit:
            out.append((i + round(late * rng.random()), packets[i]))
    return [p for _, p in sorted(out, key=lambda one: one[0])]


def shuffle(packets: list[Packet], rng: np.random.Generator) -> list[Packet]:
    """Deliver some packets up to 5 s late."""
    late = float(rng.choice([0.1, 1.0, 5.0]))
    hit = _some(packets, rng, float(rng.choice([0.1, 1.0])))
    when = [
        p.stamp_ns + (late * S * rng.random() if h else 0)
        for p, h in zip(packets, hit, strict=True)
    ]
    return [packets[i] for i in np.argsort(when, kind="stable")]


def very_late(packets: list[Packet], rng: np.random.Generator) -> list[Packet]:
    """Deliver some packets 40 s late: the window has moved on."""
    hit = _some(packets, rng, 0.1)
    when = [p.stamp_ns + (40 * S if h else 0) for p, h in zip(packets, hit, strict=True)]
    return [packets[i] for i in np.argsort(when, kind="stable")]


def truncate(packets: list[Packet], rng: np.random.Generator) -> list[Packet]:
    """End early, perhaps at once."""
    return packets[: int(rng.integers(1, max(len(packets), 2)))]


def part_time(packets: list[Packet], rng: np.random.Generator) -> list[Packet]:
    """Let each sensor begin late or end early."""
    first, last = _times(packets)
    span: dict[str, tuple[float, float]] = {}
    for name in sorted({p.sensor for p in packets}):
        a, b = np.sort(rng.random(2)) if name else (0.0, 1.0)
        span[name] = (first + a * (last - first), first + b * (last - first))
    return [p for p in packets if span[p.sensor][0] <= p.stamp_ns <= span[p.sensor][1]]


def huge_turns(packets: list[Packet], rng: np.random.Generator) -> list[Packet]:
    """Let an encoder jump, once or a few times."""
    size = float(rng.choice([30.0, 1e3, 1e6, -1e6]))
    out = []
    for p in packets:
        if not p.sensor and rng.random() < 0.01:
            angles = p.values.copy()
            angles[int(rng.integers(angles.size))] += size
            p = replace(p, values=angles)
        out.append(p)
    return out


def wild_fixes(packets: list[Packet], rng: np.random.Generator) -> list[Packet]:
    """Put some fixes, or all of them, a kilometre off."""
    share = float(rng.choice([0.05, 0.5, 1.0]))
    same = rng.random() < 0.5
    offset = rng.normal(size=3) * np.array([1e3, 1e3, 1.0])
    out = []
    for p in packets:
        if p.sensor and p.extra is not None and rng.random() < share:
            d = offset if same else rng.normal(size=3) * np.array([1e3, 1e3, 1.0])
            p = replace(p, values=p.values + d[: p.values.size])
        out.append(p)
    return out


def lying_headings(packets: list[Packet], rng: np.random.Generator) -> list[Packet]:
    """Turn a heading or rate sensor's sign, scale it, or add noise."""
    factor, noise = float(rng.choice([-1.0, 0.0, 1.0, 2.0])), float(rng.choice([0.0, 1.0]))
    return [
        replace(p, values=factor * p.values + noise * rng.normal(size=1))
        if p.sensor and p.values.size == 1
        else p
        for p in packets
    ]


def standing(packets: list[Packet], rng: np.random.Generator) -> list[Packet]:
    """Let the wheels stand from some time on, while all other sensors go on."""
    begin, end = _window(packets, rng, float(rng.choice([20.0, 1e6])))
    return [
        replace(p, values=np.zeros_like(p.values))
        if not p.sensor and begin <= p.stamp_ns < end
        else p
        for p in packets
    ]


def few_wheels(packets: list[Packet], rng: np.random.Generator) -> list[Packet]:
    """Leave only the first one to three wheel packets."""
    left = int(rng.integers(1, 4))
    out = []
    for p in packets:
        if not p.sensor:
            left -= 1
            if left < 0:
                continue
        out.append(p)
    return out


MUTATIONS: tuple[Mutation, ...] = (
    silence,
    bad_values,
    bad_sigmas,
    clock_step,
    duplicate,
    shuffle,
    very_late,
    truncate,
    part_time,
    huge_turns,
    wild_fixes,
    lying_headings,
    standing,
    few_wheels,
)
