"""Results of every engine and integrator keep their bits: random scenes against a stored table.

See `tests/simulation/test_bits.py` for what is compared on another kind of processor.
"""

import pytest
from data import make_bits


@pytest.mark.parametrize(
    "number",
    [
        pytest.param(
            n, marks=() if n % 40 == 0 else pytest.mark.slow if n % 8 == 4 else pytest.mark.soak
        )
        for n in range(make_bits.SCENES)
    ],
)
def test_answers_to_a_random_scene(number: int):
    assert not list(make_bits.differences(str(number), make_bits.engine_cases(number), some=True))
