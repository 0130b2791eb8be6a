"""Tune the filters on some seeds of a simulated drive and judge them on others.

`python -m fgloc.experiments.tune_filters [--methods A,B] [--drive NAME?key=value] [--train N]
[--test N] [--budget N] [--seed N]` prints, per method, the mean position error with its defaults
and tuned, on the training seeds 0, 1, … and on as many others from 1000 on, and the values found.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence

from fgloc.core.drive import Drive
from fgloc.datasets.simulator import load_sim
from fgloc.errors import FglocError
from fgloc.experiments.tunables import TUNABLE, tunable
from fgloc.experiments.tuning import mean_score, tune

DRIVE = "random?duration=60&slip=on&camera=on&gyro=on"
OTHERS = 1000
"""First of the seeds that nothing is tuned on."""


def drives(name: str, first: int, count: int) -> list[Drive]:
    """Return `count` simulated drives `NAME?key=value` with seeds from `first` on."""
    joint = "&" if "?" in name else "?"
    return [load_sim(f"{name}{joint}seed={seed}") for seed in range(first, first + count)]


def row(
    method: str, train: Sequence[Drive], others: Sequence[Drive], budget: int, seed: int
) -> str:
    """Tune one method and return what came of it; raises FglocError as `tune` does."""
    what = tunable(method, train)
    found = tune(what, train, budget, seed)
    usual, tuned = (mean_score(what.build(v), others) for v in (what.defaults, found.values))
    values = ", ".join(f"{name} {value:.2g}" for name, value in found.values.items())
    limit = f"; at its limit: {', '.join(found.at_limit)}" if found.at_limit else ""
    errors = f"{found.default_score:9.4f}{found.score:9.4f}{usual:10.4f}{tuned:9.4f}"
    return f"{method:10}{errors}  {values}{limit}"


def main(arguments: list[str]) -> int:
    """Print the table."""
    parser = argparse.ArgumentParser(prog="python -m fgloc.experiments.tune_filters")
    parser.add_argument("--methods", default=",".join(TUNABLE), help="ids, separated by commas")
    parser.add_argument("--drive", default=DRIVE, help="simulated drive without a seed")
    parser.add_argument("--train", type=int, default=20, help="seeds to tune on")
    parser.add_argument("--test", type=int, default=40, help="seeds to judge on")
    parser.add_argument("--budget", type=int, default=100, help="evaluations for each method")
    parser.add_argument("--seed", type=int, default=0, help="seed of the search")
    options = parser.parse_args(arguments)
    try:
        train = drives(options.drive, 0, options.train)
        others = drives(options.drive, OTHERS, options.test)
        print(
            f"{options.drive}: mean position RMSE [m], {options.budget} evaluations on "
            f"{options.train} seeds, judged on {options.test} others"
        )
        print(
            f"{'':10}{'training':>18}{'others':>19}\n{'method':10}"
            + f"{'default':>9}{'tuned':>9} " * 2
        )
        for method in options.methods.split(","):
            print(row(method, train, others, options.budget, options.seed), flush=True)
    except FglocError as error:
        print(f"fgloc: error: {error}", file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
