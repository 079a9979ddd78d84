"""The run that the tests of the report share."""

import pytest
from helpers.example_chains import column
from helpers.example_scenes import run

from lmpchain import Impulse, Trajectory


@pytest.fixture(scope="package")
def wave() -> Trajectory:
    """Return a weak wave in a column that it has not crossed."""
    return run(column(40), Impulse(velocity=1e-3), 60e-6, 121)
