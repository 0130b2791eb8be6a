"""What the numbers of seed A's simulated cases say, in sentences with the numbers found."""

from __future__ import annotations

import statistics
from collections.abc import Iterator, Mapping, Sequence

from fgloc.experiments.seed_a.published import CASES
from fgloc.experiments.seed_a.runs import Ends, Entrant, Scenario
from fgloc.experiments.seed_a.start_scan import PRINTED, Start

TICK_MM = 2.827
"""What one count rolls [mm]."""


def worst(ends: Ends, scenarios: Sequence[str], entrant: str) -> float:
    """Return the largest median end error [m] of a method over scenarios and cases."""
    return max(
        statistics.median(e.position_m for e in ends[scenario, case, entrant])
        for scenario in scenarios
        for case in CASES
    )


def scenario_3(ends: Ends, who: Sequence[Entrant]) -> str:
    """Return the largest errors with slip of two wheels."""
    found = ", ".join(
        f"{e.title} {worst(ends, ('slip20', 'slip40ticks'), e.id):.3f} m" for e in who
    )
    return (
        "Scenario 3, no encoder selection, largest error at the end over three cases and both "
        f"kinds of slip: {found}. The seed prints 0.532 m for its Model 3."
    )


def scenario_4(ends: Ends, smoothers: Sequence[Entrant]) -> Iterator[str]:
    """Yield the smoothers' errors in parts of Model 3's."""
    for e in smoothers:
        parts = []
        for case in CASES:
            ours, theirs = (ends["bothleft", case, name][0].position_m for name in (e.id, "model3"))
            parts.append(f"{case} {ours / theirs:.2f}")
        camera = worst(ends, ("bothleft-camera",), e.id)
        yield (
            f"Scenario 4, {e.title}: error with yaw only over Model 3's: {', '.join(parts)}; with "
            f"camera odometry the largest median error is {camera:.3f} m."
        )


def observability(ends: Ends, smoothers: Sequence[Entrant]) -> str:
    """Return what yaw alone cannot tell of slip, with the evidence."""
    found = ", ".join(
        f"{e.title} {ends['allwheels', 'straight', e.id][0].position_m:.3f} m" for e in smoothers
    )
    return (
        "With yaw only, slip is seen where the wheels turn and the yaw does not, or the other way "
        "round; a slipping left side is, in all three cases, and the right side then tells the "
        "way. Not seen is slip of both sides by the same way: where all four wheels slip in the "
        f"straight run, 0.226 m too much is driven and remains ({found}). Left too fast and right "
        "too slow look alike; driven wheels are taken to be too fast."
    )


def selection(ends: Ends) -> Iterator[str]:
    """Yield what encoder selection costs where counts are noisy, and what an accelerometer does."""
    mean = {
        key: statistics.fmean(e.x_m for e in ends[key, "straight", "model2"])
        for key in ("noise", "slip20noise-selection")
    }
    short = 1e3 * (mean["slip20noise-selection"] - mean["noise"])
    yield (
        "Encoder selection with noisy counts takes the smaller of two, which is short by a sixth "
        "of a count on average. In the straight run that happens to 30 packets on the left and 35 "
        "on the right, in which no wheel slips: "
        f"{65 / 2 * TICK_MM / 6.0:.1f} mm; found are {-short:.1f} mm."
    )
    lines = []
    for case in CASES:
        without, with_it = (
            statistics.median(e.position_m for e in ends[key, case, "model1"])
            for key in ("slip20noise-selection", "slip20noise-selection-acc")
        )
        lines.append(f"{case} {without:.3f} m without, {with_it:.3f} m with")
    yield (
        "An accelerometer (0.05 m/s² noise, 0.02 m/s² bias, steps of 0.038 m/s²) says little at "
        "constant speed, but decides which wheel is believed: a negative mean takes the larger, "
        f"slipping one. Model 1 with selection, median: {'; '.join(lines)}."
    )


def start_of_model3(starts: Sequence[Start]) -> str:
    """Return how near any start of the track comes to both of the circle's printed errors."""
    best = min(starts, key=lambda s: s.miss)
    return (
        f"Model 3 in the circle: of {len(starts)} starts (track 0.48 to 0.96 m, sigma 0 to 0.5 m) "
        f"the one nearest to both printed errors, {PRINTED[0]} m and {PRINTED[1]} m, is "
        f"{best.miss:.3f} m off one of them (track {best.track:g} m, sigma {best.sigma:.4f} m)."
    )


def how_they_start(who: Sequence[Entrant]) -> str:
    """Return how methods start."""
    names = ", ".join(e.title for e in who if e.nominal_track is not None)
    own = ", ".join(e.title for e in who if e.nominal_track is None)
    return (
        f"{own} are given the track of each case (0.48, 0.72, 0.9 m), as in the seed; {names} "
        "start from 0.48 m with the prior of a skid-steer base (±0.168 m)."
    )


def how_many(scenarios: Mapping[str, Scenario]) -> str:
    """Return over how many seeds each noisy scenario runs."""
    found = ", ".join(f"{key} {s.seeds}" for key, s in scenarios.items() if s.seeds)
    return (
        f"Seeds: {found}; a number with brackets is the median with the central 95 %. In noisy "
        "scenarios the yaw's zero is drawn evenly within its step of 0.01 rad: the seed does not "
        "say when, within its seven seconds, the first step of the drift comes."
    )
