"""What all tests begin with."""

import os

import pytest


def pytest_xdist_auto_num_workers(config: pytest.Config) -> int:
    """Return how many processes `-n auto` starts: one for each core that we may use, up to 8."""
    return min(len(os.sched_getaffinity(0)), 8)


def pytest_configure(config: pytest.Config) -> None:
    """Have all loops compiled that a machine compiles once, so that no test waits for it or reads of it.

    It is done before `-n` starts its workers, which then find them compiled.
    """
    if hasattr(config, "workerinput") or config.option.collectonly:
        return
    from helpers.example_scenes import paper

    from lmpchain import simulate

    for name, engine, options in (
        ("weak", "chebyshev", {}),
        ("weak", "native", {"integrator": "dop853"}),
        ("weak", "native", {"integrator": "gear4"}),
        ("weak", "native", {}),
        ("fig1", "native", {}),
    ):
        simulate(paper(name, 5), engine, 1e-2, **options)
