"""The command line with frequent checkpoints and a first attempt whose steps are too long.

    python tests/helpers/hurried.py run scene.toml -o run/

A run of one second then has as many attempts and checkpoints as a run of one hour.
"""

import sys

from lmpchain.cli import command_line
from lmpchain.engines.stepping import time_stepping
from lmpchain.engines.stepping import time_stepping as stepping_run
from lmpchain.simulation import run_folder

LONGER = 20  # Factor on the steps that the command would choose.


def main(words: list[str]) -> int:
    """Run a command of lmpchain."""
    stepping_run.BLOCK_S = 0.02
    run_folder.INTERVALS = run_folder.INTERVALS._replace(checkpoint_s=0.02, checkpoint_share=0.5)
    honest = time_stepping.TimeSteppingEngine.propose

    def propose(engine, *arguments):
        right = honest(engine, *arguments)
        count = right.steps.per_landing
        steps = right.steps.shorten(count if engine.step else max(1, count // LONGER))
        return right.with_steps(steps)

    time_stepping.TimeSteppingEngine.propose = propose
    return command_line.main(words)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
