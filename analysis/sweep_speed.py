"""Speed of a sweep of random columns: scenes per second, share of the integration, files.

Arrival times and largest velocities are kept. With one worker the CPU time of the integration and
its error estimate is set against that of everything; with more, wall time counts, from nothing to
the dataset, start of the processes included. Kernels are compiled beforehand. Compare numbers of
one run only: other work on the machine slows all of them.
"""

import argparse
import os
import resource
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from unittest import mock

import lmpchain
from lmpchain.engines.base import ErrorBudget, Run
from lmpchain.engines.stepping.time_stepping import SteppingRun
from lmpchain.trajectory.record import Block

KEEP = ["arrival_time", "peak_velocity"]


def cpu() -> float:
    """Return the user and system time that this process and its children have used, s."""
    used = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    return sum(each.ru_utime + each.ru_stime for each in used)


def asked(realisations: int, seed: int = 1) -> dict[str, object]:
    """Return a sweep over disordered columns."""
    scene = lmpchain.Scene(
        chain=lmpchain.Chain(grains=120, diameter=1e-3),
        excitation=lmpchain.Impulse(velocity=8.57e-4),
        duration=100e-6,
    )
    return {
        "scene": scene,
        "keep": KEEP,
        "disorder": {"m": 20.0, "seed": seed, "realisations": realisations},
    }


def share(realisations: int) -> tuple[float, float]:
    """Return the CPU time of a sweep in this process, s, and the fraction of the integration."""
    inside = [0.0]
    blocks = SteppingRun.blocks
    errors = SteppingRun.errors

    def timed(run: Run) -> Iterator[Block]:
        parts = blocks(run)  # type: ignore[arg-type]
        while True:
            began = time.process_time()
            block = next(parts, None)
            inside[0] += time.process_time() - began
            if block is None:
                return
            yield block

    def estimated(run: Run) -> list[ErrorBudget]:
        began = time.process_time()
        try:
            return errors(run)  # type: ignore[arg-type]
        finally:
            inside[0] += time.process_time() - began

    patches = {"blocks": timed, "errors": estimated}
    with mock.patch.multiple(SteppingRun, **patches), tempfile.TemporaryDirectory() as folder:
        began = time.process_time()
        lmpchain.sweep(asked(realisations), folder)
        spent = time.process_time() - began
    return spent, inside[0] / spent


def main() -> None:
    """Print the figures."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--scenes", type=int, default=10_000)
    parser.add_argument("--workers", type=int, default=len(os.sched_getaffinity(0)))
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        lmpchain.sweep(asked(64, seed=2), folder)  # This call compiles.
    spent, part = share(arguments.scenes)
    each = f"{1e3 * spent / arguments.scenes:.3f} ms of CPU a scene"
    print(f"one process: {each}, {100 * part:.1f} % of it integration and estimate")
    with tempfile.TemporaryDirectory() as folder:
        before = cpu()
        began = time.perf_counter()
        lmpchain.sweep(asked(arguments.scenes), folder, workers=arguments.workers)
        seconds = time.perf_counter() - began
        used = cpu() - before
        files = sum(path.is_file() for path in Path(folder).rglob("*"))
    done = f"{arguments.scenes} scenes in {seconds:.1f} s ({used:.1f} s of CPU)"
    print(
        f"{arguments.workers} workers: {done}, {arguments.scenes / seconds:.0f} a second, in "
        f"{files} files"
    )


if __name__ == "__main__":
    main()
