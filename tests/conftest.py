"""What all tests begin with."""

import multiprocessing
import os
import signal
import sys

import pytest
from helpers.relative import approx

pytest.approx = (
    approx  # its absolute tolerance of 1e-12 is more than most joules and metres of a chain
)

os.environ["MPLBACKEND"] = "agg"  # no test opens a window
os.environ["OPENBLAS_NUM_THREADS"] = (
    "1"  # one core for a test: threads of two would wait for each other
)
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)  # some hundred processes load what is tested
sys.dont_write_bytecode = False


@pytest.fixture(autouse=True)
def _figures_are_closed():
    """Let `pyplot` keep no figure of one test for the next."""
    yield
    if "matplotlib.pyplot" in sys.modules:
        sys.modules["matplotlib.pyplot"].close("all")


def pytest_xdist_auto_num_workers(config: pytest.Config) -> int:
    """Return how many processes `-n auto` starts: one for each core that we may use, up to 8."""
    return min(len(os.sched_getaffinity(0)), 8)


def pytest_configure(config: pytest.Config) -> None:
    """Let tests obey Ctrl-C; with `-n`, compile what most tests need before the workers start.

    A shell that starts tests in the background ignores Ctrl-C, which processes would inherit.
    Without `-n`, each test compiles what it needs, so that a single file starts at once.
    """
    if signal.getsignal(signal.SIGINT) == signal.SIG_IGN:
        signal.signal(signal.SIGINT, signal.default_int_handler)
    if hasattr(config, "workerinput") or config.option.collectonly:
        return
    if not getattr(config.option, "numprocesses", None):
        return
    beside = multiprocessing.get_context("fork").Process(
        target=_compile_steps_of_one_length_and_measures
    )
    beside.start()
    _compile_adaptive_steps_and_gradients()
    beside.join()
    assert beside.exitcode == 0, "what tests need could not be compiled: the error is above"


def _compile_steps_of_one_length_and_measures() -> None:
    from helpers.example_scenes import paper

    from lmpchain import measure, simulate

    for integrator in ("rkn4", "dop853"):
        simulate(paper("weak", 5), "native", 1e-2, integrator=integrator)
    simulate(paper("weak", 5), "chebyshev", 1e-2)
    measure.front.track(simulate(paper("weak", 33), "modes", 1e-2))


def _compile_adaptive_steps_and_gradients() -> None:
    from helpers.example_scenes import paper

    from lmpchain import design, simulate

    simulate(
        paper("fig1", 5).replace(quantities=["peak_velocity", "arrival_time", "peak_force:2"]),
        "native",
        1e-2,
    )
    simulate(paper("weak", 5), "native", 1e-2, integrator="gear4")
    design.gradient(paper("fig1", 5), design.Momentum([1]), ["masses"], tolerance=1e-2)
