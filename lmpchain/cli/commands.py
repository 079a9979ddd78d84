"""What the commands of the command line do, one function a verb."""

from .compare import compare, doctor, stability, workprec
from .orbit import orbit
from .pages import docs
from .plan import plan
from .read import dyson, fit, report
from .run import deck, resume, run, run_folder, sweep

__all__ = [
    "compare",
    "deck",
    "docs",
    "doctor",
    "dyson",
    "fit",
    "orbit",
    "plan",
    "report",
    "resume",
    "run",
    "run_folder",
    "stability",
    "sweep",
    "workprec",
]
