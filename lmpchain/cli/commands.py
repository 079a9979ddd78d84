"""Commands of the command line, one function a verb."""

from .compare import compare, doctor, stability, workprec
from .orbit import orbit
from .pages import docs
from .plan import plan
from .read import dyson, fit, report
from .run import deck, resume, run, run_folder, sweep
from .sensitivity import UNCERTAIN, sensitivity

__all__ = [
    "UNCERTAIN",
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
    "sensitivity",
    "stability",
    "sweep",
    "workprec",
]
