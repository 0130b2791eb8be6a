"""The numbers that seed A prints, and why some of them cannot follow from what it describes.

Numbers are kept as printed: their digits say how exact they are.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

CASES = ("straight", "spin", "circle")
"""The three motions."""


@dataclass(frozen=True)
class Scale:
    """What relative errors of one case are divided by."""

    path_m: float
    """Mean wheel path [m]."""
    turn_deg: float
    """Angle [deg]."""


SCALES = {
    "straight": Scale(4.5239, 360.0),
    "spin": Scale(4.5239, 720.0),
    "circle": Scale(11.317, 360.0),
}
"""Of the simulated cases, as printed. The spin's path is that of its wheels; the circle's is 2π
times the radius 1.801 m on which the corners of the recursion's polygon lie (its sides sum to
11.310 m)."""

POSITION = "position [m]"
RELATIVE = "position [%]"
HEADING = "heading [deg]"
TURN = "heading [%]"
TRACK = "effective track [m]"
QUANTITIES = (POSITION, RELATIVE, HEADING, TURN)
"""Errors at the end point, in the order of the printed tables."""


@dataclass(frozen=True)
class Printed:
    """One printed table."""

    id: str
    """Key of the table, e.g. "table-3.1"; "text-4.2" for what section 4.2 says."""
    method: str
    """Id of the method it is about."""
    scenario: str
    """noise, slip, vehicle or unselected."""
    cells: Mapping[tuple[str, str], str]
    """Printed numbers by case and quantity."""
    explanations: Mapping[tuple[str, str], str] = field(default_factory=dict)
    """Why a number cannot follow, by case and quantity."""


def _positions(*pairs: tuple[str, str]) -> dict[tuple[str, str], str]:
    """Return the cells of a table that prints position errors only, in m and %."""
    found = {}
    for case, (metres, percent) in zip(CASES, pairs, strict=True):
        found[case, POSITION] = metres
        found[case, RELATIVE] = percent
    return found


def _all(*lines: tuple[str, str, str, str]) -> dict[tuple[str, str], str]:
    """Return the cells of a table that prints all four quantities."""
    return {
        (case, quantity): text
        for case, line in zip(CASES, lines, strict=True)
        for quantity, text in zip(QUANTITIES, line, strict=True)
    }


def _both(case: str, text: str) -> dict[tuple[str, str], str]:
    """Return the same explanation for both position errors of a case."""
    return {(case, POSITION): text, (case, RELATIVE): text}


SPIN_NOISE = (
    "Noise of ±0.5 count on four wheels moves the centre by a standard deviation of 0.41 mm a "
    "packet, whatever the track is; 40 moving packets and 10 at rest add up to 2.9 mm. 16 mm are "
    "more than five standard deviations, and more than all draws here."
)
TABLE_3_2_TURN = (
    "The printed percentage is that of the rounded angle: 6.8° are 1.89 % of 360°, 6.75° are "
    "1.875 %."
)
TABLE_3_4_SLIP = (
    "The text describes wheels that turn 20 % faster. That gives 0.085, 0.026 and 0.173 m; the "
    "printed numbers follow from 40 counts more per packet instead (the rows below). Those of "
    "Model 1 in Table 3.2 follow from 20 %, so the two tables have different slip."
)
TABLE_3_4_CIRCLE = (
    "40 counts more in 10 packets on the left and 5 on the right (3 s < t ≤ 5 s and 4 s < t ≤ 5 s) "
    "give 0.399 m. The printed 0.402 m follows from 9 and 6 packets (3 s < t < 5 s and 4 s ≤ t ≤ "
    "5 s; the last row), which changes the other two cases by less than their last digit."
)
TABLE_3_5_STRAIGHT = (
    "The printed 0.0004 m and 0.1 % contradict each other: 0.1 % of 4.524 m is 0.0045 m. Neither "
    "can come from a yaw that drifts by 0.01 rad in 7 s: the last two seconds of driving alone, "
    "behind the latest possible step, are 11 mm off to the side, and no draw here is below 5 mm."
)
TABLE_3_CIRCLE = (
    "No initial track between 0.48 and 0.96 m with any initial sigma gives the circle's 0.188 m "
    "(Table 3.5) together with 0.532 m (Table 3.6); see the figure model3-start. The seed prints "
    "neither, nor the equation that moves the state (2.32)."
)

TABLES: tuple[Printed, ...] = (
    Printed(
        "table-3.1",
        "model1",
        "noise",
        _all(
            ("0.013", "0.29", "0.0", "0.0"),
            ("0.016", "0.35", "0.0", "0.0"),
            ("0.003", "0.03", "0.0", "0.0"),
        ),
        _both("spin", SPIN_NOISE),
    ),
    Printed(
        "table-3.2",
        "model1",
        "slip",
        _all(
            ("0.379", "8.38", "6.8", "1.89"),
            ("0.025", "0.56", "13.5", "1.88"),
            ("0.539", "4.76", "12.6", "3.5"),
        ),
        {("straight", TURN): TABLE_3_2_TURN},
    ),
    Printed(
        "table-3.3",
        "model2",
        "noise",
        _positions(("0.023", "0.5"), ("0.002", "0.05"), ("0.031", "0.27")),
    ),
    Printed(
        "table-3.4",
        "model2",
        "slip",
        _positions(("0.424", "9.37"), ("0.128", "2.82"), ("0.402", "3.55")),
        {},
    ),
    Printed(
        "table-3.5",
        "model3",
        "noise",
        _positions(("0.0004", "0.1"), ("0.001", "0.03"), ("0.188", "1.66")),
        _both("straight", TABLE_3_5_STRAIGHT) | _both("circle", TABLE_3_CIRCLE),
    ),
    Printed(
        "table-3.6",
        "model3",
        "slip",
        _positions(("0.085", "1.88"), ("0.026", "0.56"), ("0.532", "4.7")),
        _both("circle", TABLE_3_CIRCLE),
    ),
)
"""Tables 3.1 to 3.6."""
