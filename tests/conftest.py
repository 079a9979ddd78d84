"""Settings and fixtures of all tests."""

import gc
import multiprocessing
import os
import signal
import sys

import numpy as np
import pytest
from helpers.relative import approx

# The default absolute tolerance of 1e-12 exceeds most energies and lengths of a chain.
pytest.approx = approx

os.environ["MPLBACKEND"] = "agg"  # No test opens a window.
# Every test uses one core, because two threads of OpenBLAS would wait for each other.
os.environ["OPENBLAS_NUM_THREADS"] = "1"
# The processes that tests start share the byte code of the package.
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)
sys.dont_write_bytecode = False
# The processes that tests start buffer their output, as they do for a user.
os.environ.pop("PYTHONUNBUFFERED", None)
# Collection creates objects that all stay alive; garbage collection would take a third of its time.
gc.disable()


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Run a case that is marked as soak with the soak tests alone, even if its test is slow."""
    for item in items:
        if item.get_closest_marker("soak"):
            item.own_markers = [mark for mark in item.own_markers if mark.name != "slow"]


def pytest_collection_finish(session: pytest.Session) -> None:
    """Exclude all collected tests from later garbage collections."""
    gc.freeze()
    gc.enable()


@pytest.fixture(autouse=True)
def _figures_are_closed():
    """Close the figures of a test."""
    yield
    if "matplotlib.pyplot" in sys.modules:
        sys.modules["matplotlib.pyplot"].close("all")


@pytest.fixture
def rng(request: pytest.FixtureRequest) -> np.random.Generator:
    """Return a generator of random numbers; its seed is the parameter `seed` of the test, or 1."""
    parameters = request.node.callspec.params if hasattr(request.node, "callspec") else {}
    return np.random.default_rng(parameters.get("seed", 1))


def pytest_xdist_auto_num_workers(config: pytest.Config) -> int:
    """Return the number of processes of `-n auto`: one for each available core, up to 8."""
    return min(len(os.sched_getaffinity(0)), 8)


def pytest_configure(config: pytest.Config) -> None:
    """Enable Ctrl-C in tests and, with `-n`, compile the common kernels before the workers start.

    A shell that starts tests in the background ignores Ctrl-C, and all child processes inherit
    this. Without `-n` each test compiles its kernels, so that a single file starts at once.
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
    assert beside.exitcode == 0, "the kernels could not be compiled: the error is above"


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
