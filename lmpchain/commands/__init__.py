"""What the commands of the command line do, one function a verb."""

from .comparing import compare, doctor, stability, workprec
from .planning import plan
from .reading import dyson, fit, report
from .running import deck, resume, run, run_folder, sweep

__all__ = [
    "compare",
    "deck",
    "doctor",
    "dyson",
    "fit",
    "plan",
    "report",
    "resume",
    "run",
    "run_folder",
    "stability",
    "sweep",
    "workprec",
]
