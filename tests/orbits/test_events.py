"""Location of events for pairs of multipliers with closed-form means."""

from collections.abc import Callable
from types import SimpleNamespace

import numpy as np
import pytest

from lmpchain.orbits.events import locate


def place(means: list[complex], rate: float = 1.0, turning: float = 1.0) -> SimpleNamespace:
    """Return a stand-in for a member, with the attributes that `locate` reads."""
    return SimpleNamespace(
        orbit=SimpleNamespace(means=np.array(means, complex)),
        rate=rate,
        turning=turning,
        multipliers=None,
    )


def located(
    kind: str, at: Callable[[float], SimpleNamespace | None], most: int = 25
) -> SimpleNamespace | None:
    """Return the event between 0 and 1, found with a limited number of orbits."""
    taken = []

    def counted(way: float) -> SimpleNamespace | None:
        assert 0 < way < 1
        taken.append(way)
        return at(way)

    here = at(0.0)
    there = at(1.0)
    assert here is not None
    assert there is not None
    event = locate(kind, here, there, counted)
    assert len(taken) <= most
    return event


@pytest.mark.parametrize("meets", [0.0123, 0.4, 0.77, 0.999])
@pytest.mark.parametrize("sign", [1, -1])
def test_pairs_that_meet_among_others_are_located(meets: float, sign: int):
    """The means are 0.3 +- (root of a distance), while two others pass each other within 1e-6."""

    def at(way: float) -> SimpleNamespace:
        root = np.sqrt(complex(sign * 0.01 * (meets - way) * (1 + way)))
        drift = 1e-4 * way
        return place(
            [0.3 + drift + root, 0.3 + drift - root, -0.5, -0.5 + 2e-6 + 1e-4 * way, 0.8, -0.9]
        )

    event = located("Neimark-Sacker", at, 13)
    assert event is not None
    assert event.orbit.means.real[:2].mean() - 0.3 == pytest.approx(1e-4 * meets, abs=2e-10)


@pytest.mark.parametrize("where", [0.013, 0.35, 0.9, 0.9995])
@pytest.mark.parametrize("sign", [1, -1])
@pytest.mark.parametrize(("kind", "value"), [("period doubling", -1.0), ("branch point", 1.0)])
def test_a_pair_that_passes_another_is_located(kind: str, value: float, sign: int, where: float):
    """A pair is located although its mean is curved and other pairs are close."""

    def at(way: float) -> SimpleNamespace:
        passing = value + sign * (way - where) * (0.1 + 0.2 * way)
        return place([passing, 0.2, -value * 0.5, 0.5 + 0.1j, 0.5 - 0.1j])

    event = located(kind, at, 13)
    assert event is not None
    assert event.orbit.means[0].real == pytest.approx(value, abs=4e-6)
    assert np.sign(event.orbit.means[0].real - value) == sign  # The event has happened there.
    for other in {"fold", "period doubling", "branch point", "Neimark-Sacker"} - {kind}:
        assert located(other, at) is None


@pytest.mark.parametrize("where", [0.02, 0.6, 0.98])
@pytest.mark.parametrize("sign", [1, -1])
def test_a_fold_is_where_the_rate_of_the_parameter_is_0(sign: int, where: float):
    def at(way: float) -> SimpleNamespace:
        return place([0.2, 0.4], rate=sign * (np.exp(3 * where) - np.exp(3 * way)))

    event = located("fold", at, 13)
    assert event is not None
    assert event.rate == pytest.approx(0, abs=1e-4)
    assert sign * event.rate <= 0


def test_a_pair_that_passes_1_at_a_fold_is_no_branch_point():
    """A pair passes 1 at every fold; without a fold, the event is a branch point."""
    for turning, passes in (
        ((1.0, -1.0), False),
        ((1.0, 1.0), True),
        ((-1.0, -2.0), True),
        ((np.nan,) * 2, True),
    ):

        def at(way: float, turning: tuple[float, ...] = turning) -> SimpleNamespace:
            return place([0.7 + way, 0.1], turning=turning[int(way > 0.3)])

        assert (located("branch point", at) is not None) == passes
        crossing = place([0.7, 0.1], turning=turning[0]), place([-1.7, 0.1], turning=turning[1])
        assert locate("period doubling", *crossing, lambda _: None) is crossing[1]


def test_missing_events_are_not_located():
    same = place([0.3, 0.5 + 0.1j, 0.5 - 0.1j])
    for kind in ("fold", "period doubling", "branch point", "Neimark-Sacker"):
        assert located(kind, lambda _: same) is None
    split = place([0.3, 0.5 + 0.9e-6j, 0.5 - 0.9e-6j]), place([0.3, 0.5, 0.5])
    assert locate("Neimark-Sacker", *split, lambda _: None) is None  # Rounding of a double mean.
    split = place([0.3, 0.5 + 1.1e-6j, 0.5 - 1.1e-6j]), place([0.3, 0.5, 0.5])
    assert locate("Neimark-Sacker", *split, lambda _: None) is split[1]


def test_without_further_orbits_the_last_known_one_is_returned():
    """Orbits exist only before 0.9, and the nearest one after the event is returned."""
    end = place([1.5, 0.1])

    def at(way: float) -> SimpleNamespace | None:
        return end if way == 1 else place([0.5 + way, 0.1]) if way < 0.45 else None

    assert located("branch point", at) is end


def test_an_event_by_a_jump_is_located_by_bisection():
    """A mean that jumps has no root in between; at most 30 orbits are computed."""

    def at(way: float) -> SimpleNamespace:
        return place([0.2 if way < 0.7183 else 1.3, way])

    event = located("branch point", at, 30)
    assert event is not None
    assert event.orbit.means[1].real - 0.7183 == pytest.approx(0, abs=2e-6)
    assert event.orbit.means[0] == 1.3


def test_isolated_pairs_that_meet_are_located():
    """There are two pairs, possibly none real afterwards, and one remaining pair."""

    def at(way: float) -> SimpleNamespace:
        root = np.sqrt(complex(0.02 * (0.37 - way)))
        return place([way / 100 + root, way / 100 - root])

    event = located("Neimark-Sacker", at, 13)
    assert event is not None
    assert event.orbit.means.real.mean() == pytest.approx(0.0037, rel=1e-5)


def test_the_discriminant_belongs_to_the_pair_that_meets():
    """The lower two of three means on a line become complex, although the upper two are closer."""

    def at(way: float) -> SimpleNamespace:
        root = np.sqrt(complex(0.04 * (0.62 - way)))
        return place([-0.4 + root, -0.4 - root, 0.7, 0.7 + 1e-3 * (1 + way)])

    event = located("Neimark-Sacker", at, 9)
    assert event is not None
    assert event.orbit.means.real[:2].mean() == pytest.approx(-0.4, rel=1e-9)
    assert abs(event.orbit.means.imag[0]) < 1e-3


def damped(multipliers: list[complex], turning: float = 1.0) -> SimpleNamespace:
    """Return a stand-in for a member of a damped chain with the attributes that `locate` reads."""
    return SimpleNamespace(rate=1.0, turning=turning, multipliers=np.array(multipliers, complex))


@pytest.mark.parametrize("where", [0.013, 0.35, 0.98])
@pytest.mark.parametrize("sign", [1, -1])
@pytest.mark.parametrize(
    ("kind", "turn"), [("branch point", 1.0), ("period doubling", -1.0), ("Neimark-Sacker", 1j)]
)
def test_a_damped_multiplier_that_crosses_the_unit_circle_is_located(
    kind: str, turn: complex, sign: int, where: float
):
    """A real multiplier passes 1 or -1, or a complex pair crosses, among others on both sides."""

    def at(way: float) -> SimpleNamespace:
        passing = turn * (1 + sign * (way - where) * (0.1 + 0.2 * way))
        pair = [passing, passing.conjugate()] if kind == "Neimark-Sacker" else [passing]
        return damped([*pair, 2.0, -3.0, 0.9 + 0.1j, 0.9 - 0.1j, 0.5])

    event = located(kind, at, 25)
    assert event is not None
    assert abs(event.multipliers[0]) - 1 == pytest.approx(0, abs=4e-6)
    assert np.sign(abs(event.multipliers[0]) - 1) == sign
    for other in {"fold", "period doubling", "branch point", "Neimark-Sacker"} - {kind}:
        assert located(other, at) is None


@pytest.mark.parametrize("side", [1, -1])
def test_damped_multipliers_that_meet_outside_the_circle_are_no_event(side: int):
    """Two real multipliers become a complex pair, far from the unit circle."""

    def at(way: float) -> SimpleNamespace:
        root = np.sqrt(complex(0.4 - way))
        return damped([side * (2 + root), side * (2 - root), 0.3])

    for kind in ("fold", "period doubling", "branch point", "Neimark-Sacker"):
        assert located(kind, at) is None
