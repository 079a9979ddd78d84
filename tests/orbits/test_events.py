"""Where events are located, of pairs of multipliers whose means are given in closed form."""

from types import SimpleNamespace

import numpy as np
import pytest

from lmpchain.orbits.events import between


def place(means: list[complex]) -> SimpleNamespace:
    """Return what `between` reads of a place."""
    return SimpleNamespace(orbit=SimpleNamespace(means=np.array(means, complex)), turning=1.0)


@pytest.mark.parametrize("meets", [0.0123, 0.4, 0.77, 0.999])
@pytest.mark.parametrize("sign", [1, -1])
def test_pairs_that_meet_among_others_are_located(meets: float, sign: int):
    """c = 0.3 +- (root of a distance), while two others pass one another as near as 1e-6, in few orbits."""
    taken = []

    def at(part: float) -> SimpleNamespace:
        taken.append(part)
        root = np.sqrt(complex(sign * 0.01 * (meets - part) * (1 + part)))
        drift = 1e-4 * part
        return place([0.3 + drift + root, 0.3 + drift - root, -0.5, -0.5 + 2e-6 + 1e-4 * part, 0.8, -0.9])

    found = between("Neimark-Sacker", at(0.0), at(1.0), at)
    assert found is not None
    assert found.orbit.means.real[:2].mean() - 0.3 == pytest.approx(1e-4 * meets, abs=2e-10)
    assert len(taken) < 16
