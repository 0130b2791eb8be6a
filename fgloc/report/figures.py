"""What all figures share: size, colours by method, saving without pyplot's global state."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from matplotlib.figure import Figure

DPI = 150
"""Dots per inch of every PNG."""

# Okabe and Ito's palette: distinct for all common kinds of colour blindness, and in grey together
# with the line styles.
COLOURS = {
    "model1": "#0072B2",
    "model2": "#E69F00",
    "model3": "#56B4E9",
    "pose-ekf": "#CC79A7",
    "rl-ekf": "#7F4FC9",
    "ekf-slam": "#8C6D31",
    "batch": "#D55E00",
    "online": "#009E73",
    "nominal": "#0072B2",
    "calibrated": "#D55E00",
}
"""Colour of each method, the same in all figures."""
STYLES = {
    "model1": (0, (5, 2)),
    "nominal": (0, (5, 2)),
    "model2": (0, (1, 1)),
    "model3": (0, (3, 1, 1, 1)),
    "pose-ekf": (0, (7, 2, 1, 2)),
    "rl-ekf": (0, (4, 1, 1, 1, 1, 1)),
    "ekf-slam": (0, (2, 2)),
}
"""Dash pattern of methods that are not drawn as a solid line."""
TRUTH = "#000000"
FIX = "#009E73"


def new_figure(width: float, height: float) -> Figure:
    """Return an empty figure of `width` × `height` inches that belongs to no window."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(width, height), dpi=DPI, layout="constrained")
    FigureCanvasAgg(figure)
    return figure


def save(figure: Figure, path: Path) -> Path:
    """Write the figure as PNG and return its path."""
    figure.savefig(path, format="png", dpi=DPI)
    return path


def save_svg(figure: Figure, path: Path) -> Path:
    """Write the figure as SVG, without a date so that equal figures are equal files; return it."""
    figure.savefig(path, format="svg", dpi=DPI, metadata={"Date": None})
    return path


def colour(method: str) -> str:
    """Return the method's colour; grey for one that is not known."""
    return COLOURS.get(method, "#666666")


def style(method: str) -> str | tuple[int, tuple[int, ...]]:
    """Return the method's line style."""
    return STYLES.get(method, "-")


def height(method: str) -> float:
    """Return the method's zorder: dashes above solid lines, so that both are seen where equal."""
    return 2.4 if method in STYLES else 2.2
