"""What seed A prints of its three laboratory runs (Tables 4.1 to 4.3 and the text of chapter 4)."""

from __future__ import annotations

from fgloc.experiments.seed_a.published import (
    CASES,
    HEADING,
    POSITION,
    QUANTITIES,
    RELATIVE,
    TRACK,
    TURN,
    Printed,
    Scale,
)

SCALES = {
    "straight": Scale(4.5, 360.0),
    "spin": Scale(4.5, 720.0),
    "circle": Scale(13.1, 360.0),
}
"""What the printed percentages are of. Of the spin, 0.051 m is printed as 1.14 %, which makes 4.41
to 4.54 m, though its wheels must have gone 7.0 m; its angles are relative to 720°, not 1070°."""


def _lines(*lines: tuple[str, ...]) -> dict[tuple[str, str], str]:
    """Return the cells of a table: position, %, heading, %, and the track where it is printed."""
    names = (*QUANTITIES, TRACK)
    return {
        (case, quantity): text
        for case, line in zip(CASES, lines, strict=True)
        for quantity, text in zip(names, line, strict=False)
    }


TABLES: tuple[Printed, ...] = (
    Printed(
        "4.1",
        "model2",
        "vehicle",
        _lines(
            ("0.03", "0.67", "1.9", "0.52"),
            ("0.051", "1.14", "16.9", "2.35"),
            ("0.252", "1.92", "1.1", "0.31"),
        ),
    ),
    Printed(
        "4.2",
        "model3",
        "vehicle",
        _lines(
            ("0.049", "1.09", "7.6", "2.11", "0.4896"),
            ("0.037", "0.82", "16.8", "2.33", "0.8205"),
            ("0.224", "1.71", "0.9", "0.25", "0.8969"),
        ),
    ),
    Printed(
        "4.3",
        "model1",
        "vehicle",
        {
            ("straight", RELATIVE): "0.86",
            ("straight", TURN): "0.18",
            ("spin", RELATIVE): "1.09",
            ("spin", HEADING): "605",
            ("spin", TURN): "84.08",
            ("circle", RELATIVE): "8.25",
            ("circle", HEADING): "310",
            ("circle", TURN): "86.11",
        },
    ),
    Printed(
        "4.1-figure",
        "model1",
        "unselected",
        {("straight", RELATIVE): "3", ("straight", HEADING): "2.3"},
    ),
)
"""Tables 4.1 to 4.3; the last one is the text to figure 4.1."""
_ = POSITION
