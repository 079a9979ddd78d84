"""The command line: `lmpchain`, or `python -m lmpchain.cli`."""

from .command_line import main as main
