"""The command line of lmpchain with a checkpoint at every few samples, and first attempts whose steps are too long.

    python tests/helpers/hurried.py run scene.toml -o run/

So a run of a second has as many attempts and checkpoints to be killed at as one of an hour.
"""

import os
import sys
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import replace
from multiprocessing import get_context
from multiprocessing.context import ForkProcess as Process
from pathlib import Path

from lmpchain.cli import command_line
from lmpchain.engines import error_estimate, time_stepping
from lmpchain.simulation import run_folder

LONGER = 20  # than the steps that it would choose


def main(words: list[str]) -> int:
    """Run a command of lmpchain."""
    error_estimate.BLOCK_S = run_folder.OFTEN_S = 0.02
    run_folder.SHARE = 0.5
    honest = time_stepping.TimeSteppingEngine.candidate

    def candidate(engine, *arguments):
        right = honest(engine, *arguments)
        steps = right.steps_per_sample if engine.step else max(1, right.steps_per_sample // LONGER)
        return replace(right, steps_per_sample=steps, step=right.step * right.steps_per_sample / steps)

    time_stepping.TimeSteppingEngine.candidate = candidate
    return command_line.main(words)


def forked(words: Sequence[object], environment: Mapping[str, str], said: Path) -> Process:
    """Run a command in a fork of this process, which saves the time to import and compile.

    What it says goes to a file. It is the first process of a group of its own.
    """

    def child() -> None:
        os.setsid()
        os.environ.clear()
        os.environ.update(environment)
        with open(said, "w", encoding="utf-8", buffering=1) as file:
            for number in (1, 2):
                os.dup2(file.fileno(), number)
            sys.stdout = sys.stderr = file
            tempfile.tempdir = None  # anew from the environment
            code = main([str(word) for word in words])
            file.flush()
        os._exit(code)

    process = get_context("fork").Process(target=child)
    process.start()
    return process


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
