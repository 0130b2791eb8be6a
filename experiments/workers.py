"""The same work on many jobs in a few processes: results in order, whatever finishes first."""

from __future__ import annotations

import contextlib
import multiprocessing
import os
import signal
import threading
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from typing import TypeVar

from fgloc.errors import FglocError

J = TypeVar("J")
R = TypeVar("R")
Progress = Callable[[int, int, str], None]
"""Told the number of finished pieces, of all pieces, and what was finished last."""


def run_jobs(
    work: Callable[[J], R],
    jobs: Sequence[J],
    processes: int,
    progress: Progress,
    describe: Callable[[J], str] = str,
) -> list[R]:
    """Return `work(job)` for every job, in the jobs' order.

    With more than one process, `work` must be a function of a module, and jobs and results must
    pickle. A job gets nothing but its own arguments, so the number of processes changes nothing
    but the time. Processes are spawned (GTSAM and numba start threads, which a fork would not
    survive); each imports the package once. Whatever ends this function early, Ctrl-C included,
    ends the processes. Raises what `work` raises, and FglocError if a process was killed.
    """
    number = min(processes, len(jobs))
    if number <= 1:
        results = []
        for k, job in enumerate(jobs, 1):
            results.append(work(job))
            progress(k, len(jobs), describe(job))
        return results
    found: dict[int, R] = {}
    with _pool(number) as pool:
        futures: dict[Future[R], int] = {pool.submit(work, job): k for k, job in enumerate(jobs)}
        try:
            for future in as_completed(futures):
                k = futures[future]
                found[k] = future.result()
                progress(len(found), len(jobs), describe(jobs[k]))
        except BrokenProcessPool:
            raise FglocError(
                "a worker process was killed, probably for want of memory; "
                "try again with --processes 1"
            ) from None
    return [found[k] for k in range(len(jobs))]


@contextlib.contextmanager
def _pool(number: int) -> Iterator[ProcessPoolExecutor]:
    """Give a pool of `number` processes; when the block raises, they are ended at once."""
    before = set(multiprocessing.active_children())
    pool = ProcessPoolExecutor(
        number, mp_context=multiprocessing.get_context("spawn"), initializer=_begin
    )
    try:
        yield pool
    except BaseException:
        # Waiting for a job that nobody wants any more could take minutes.
        for child in set(multiprocessing.active_children()) - before:
            child.terminate()
        # The pool's own thread reaps the processes; doing it here as well, one of the two may
        # return before the other has noted the end.
        pool.shutdown(wait=True, cancel_futures=True)
        raise
    pool.shutdown(wait=True)


def _begin() -> None:
    """Prepare a worker: Ctrl-C is its parent's business, and it ends when the parent is gone."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    parent = multiprocessing.parent_process()
    if parent is not None:
        threading.Thread(target=_follow, args=(parent.join,), daemon=True).start()


def _follow(wait: Callable[[], None]) -> None:
    """End this process when `wait` returns: a parent that was killed cannot end its workers."""
    wait()
    os._exit(1)
