"""What all tests begin with."""

import pytest
from helpers.example_scenes import paper

from lmpchain import simulate


@pytest.fixture(scope="session", autouse=True)
def _compiled():
    """Have all loops compiled that a machine compiles once, so that no test waits for it or reads of it."""
    for name, engine, options in (
        ("weak", "chebyshev", {}),
        ("weak", "native", {"integrator": "dop853"}),
        ("weak", "native", {"integrator": "gear4"}),
        ("weak", "native", {}),
        ("fig1", "native", {}),
    ):
        simulate(paper(name, 5), engine, 1e-2, **options)
