"""Printed numbers of seed D, as they are printed: metres and radians."""

from __future__ import annotations

Axes = tuple[float, float, float]
"""x [m], y [m], heading [rad]."""

STATIC: dict[str, Axes] = {
    "nominal": (0.373399, 0.264832, 0.635582),
    "fmincon (interior point)": (0.12443, 0.094155, 0.326784),
    "Levenberg–Marquardt": (0.097433, 0.097075, 0.291457),
    "genetic algorithm": (0.090409, 0.087725, 0.275981),
    "particle swarm": (0.131921, 0.184906, 0.354527),
}
"""Table 42: sums over the six motions of the mean largest error of a run, wheels alone; all but the
first were driven anew with the new parameters."""

TOTALS: dict[str, Axes] = {
    **{name: STATIC[name] for name in ("nominal", "genetic algorithm", "particle swarm")},
    "nominal + EKF": (0.15862, 0.147522, 0.17618),
    "genetic algorithm + EKF": (0.073437, 0.059183, 0.153992),
    # Printed is 0.073437 in x, the row above once more. Its own Tables 49 to 54 and its printed
    # sum, 0.350955, give this.
    "particle swarm + EKF": (0.092765, 0.093566, 0.164624),
}
"""Table 67: the same with fusion, beside the rows of Table 42 that were fused."""

PARAMETERS_MM: dict[str, tuple[float, ...]] = {
    name: tuple(float(v) for v in text.split())
    for name, text in {
        "fmincon (interior point)": "118.1 -118.1 -116.4 112.4 106.9 118.1 -107.1 -106.9 "
        "25.55 26.67 25.91 25.11",
        "Levenberg–Marquardt": "114.7 -114.7 -113.2 113.2 114.2 114.2 -113.9 -107.7 "
        "25.83 25.86 25.86 25.36",
        "genetic algorithm": "111.4 -114.0 -112.2 107.4 114.4 114.7 -116.3 -116.2 "
        "26.04 25.93 25.67 25.46",
        "particle swarm": "107.9 -116.5 -117.5 108.1 114.4 111.7 -116.7 -108.5 "
        "26.11 25.13 26.61 25.01",
    }.items()
}
"""Parameters a1 … a4, b1 … b4, r1 … r4 that the optimisers found [mm]."""

NOMINAL: dict[str, Axes] = {
    "line x": (0.061529, 0.139242, 0.080808),
    "line y": (0.223026, 0.050721, 0.118598),
    "circle ccw": (0.059866, 0.040622, 0.108808),
    "circle cw": (0.02536, 0.031872, 0.04768),
    "spin ccw": (0.001841, 0.001183, 0.140736),
    "spin cw": (0.001777, 0.001192, 0.13895),
}
"""Tables 36 to 41: wheels alone with nominal parameters, mean largest error of five runs."""

NOMINAL_EKF: dict[str, Axes] = {
    "line x": (0.073012, 0.013552, 0.008399),
    "line y": (0.031522, 0.073872, 0.012244),
    "circle ccw": (0.022691, 0.026178, 0.038393),
    "circle cw": (0.020433, 0.029945, 0.036757),
    "spin ccw": (0.005217, 0.00244, 0.037287),
    "spin cw": (0.005745, 0.001535, 0.0431),
}
"""Tables 43 to 48: the EKF with nominal parameters, on drives that are not published."""

GENETIC_EKF: dict[str, Axes] = {
    "line x": (0.016506, 0.016471, 0.007937),
    "line y": (0.024399, 0.016357, 0.011228),
    "circle ccw": (0.015738, 0.015265, 0.037231),
    "circle cw": (0.014376, 0.00864, 0.021438),
    "spin ccw": (0.001761, 0.001293, 0.035466),
    "spin cw": (0.000657, 0.001157, 0.040692),
}
"""Tables 55 to 60: the EKF with the genetic algorithm's parameters, likewise."""
