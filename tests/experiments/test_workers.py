"""Work in processes: order, errors, and an end that leaves no process behind."""

from __future__ import annotations

import multiprocessing
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from fgloc.errors import FglocError
from fgloc.experiments.workers import run_jobs

ROOT = Path(__file__).resolve().parents[2]


def silent(done: int, total: int, text: str) -> None:
    pass


def test_results_are_in_order_and_every_job_is_told() -> None:
    # Functions that a spawned process can import by name; this file is no module to it.
    for processes in (1, 2):
        told: list[tuple[int, int, str]] = []

        def tell(done: int, total: int, text: str, told: list[tuple[int, int, str]] = told) -> None:
            told.append((done, total, text))

        found = run_jobs(abs, [-3, 1, -2], processes, tell, lambda j: f"job {j}")
        assert found == [3, 1, 2]
        assert [(done, total) for done, total, _ in told] == [(1, 3), (2, 3), (3, 3)]
        assert {text for _, _, text in told} == {"job -3", "job 1", "job -2"}


def test_no_jobs_and_one_process_start_none() -> None:
    assert run_jobs(abs, [], 2, silent) == []
    assert run_jobs(lambda j: j, [1, 2], 1, silent) == [1, 2]


def test_an_error_in_a_worker_is_raised_and_ends_the_others() -> None:
    begin = time.monotonic()
    with pytest.raises(ValueError, match="non-negative"):
        # The other job would sleep for a minute.
        run_jobs(time.sleep, [60.0, -1.0], 2, silent)
    assert time.monotonic() - begin < 30.0
    assert multiprocessing.active_children() == []


def test_a_killed_worker_is_a_known_error() -> None:
    with pytest.raises(FglocError, match="--processes 1"):
        run_jobs(os._exit, [3, 3], 2, silent)


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGKILL])
def test_workers_end_with_their_parent(number: int) -> None:
    script = (
        "import time\n"
        "from fgloc.experiments.workers import run_jobs\n"
        "def tell(done, total, text):\n"
        "    import multiprocessing\n"
        "    print(*[c.pid for c in multiprocessing.active_children()], flush=True)\n"
        "if __name__ == '__main__':\n"
        "    run_jobs(time.sleep, [0.0, 60.0, 60.0], 2, tell)\n"
    )
    process = subprocess.Popen(
        [sys.executable, "-c", script],
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        env=os.environ | {"PYTHONPATH": str(ROOT)},
    )
    assert process.stdout is not None
    workers = [int(word) for word in process.stdout.readline().split()]
    process.stdout.close()
    assert len(workers) == 2
    process.send_signal(number)
    process.wait(30)
    end = time.monotonic() + 30.0
    while any(_alive(pid) for pid in workers):
        assert time.monotonic() < end
        time.sleep(0.05)


def _alive(pid: int) -> bool:
    """Return True while a process runs (a zombie nobody waits for does not)."""
    try:
        state = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0]
    except (FileNotFoundError, ProcessLookupError):
        return False
    return state != "Z"
