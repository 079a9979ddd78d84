"""Families of orbits: folds, bifurcations, and continuation in both directions."""

import re
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.optimize import brentq

from lmpchain import Chain, Drive, orbits
from lmpchain.orbits import Family, continuation
from lmpchain.orbits.events import Aspect, aspects
from lmpchain.orbits.modes import mode_family
from lmpchain.orbits.shooting import Equations
from lmpchain.theory import modes

# One grain moves, below the driven one.
CHAIN = Chain(grains=3, diameter=1e-3, gravity=0.0, top_load=1.0)
OMEGA = float(np.sqrt(2 * CHAIN.linear_stiffness[0] / CHAIN.masses[0]))


@cache
def resonance() -> Family:
    """Return a driven grain from below its softening resonance through two folds of the period."""
    drive = Drive(amplitude=0.05 * CHAIN.length_scale, frequency=0.7 * OMEGA / (2 * np.pi))
    return orbits.follow(orbits.find(CHAIN, drive=drive), "period", 2 * np.pi / OMEGA)


def test_a_driven_grain_has_a_fold_where_a_multiplier_passes_1():
    family = resonance()
    assert family.reached
    assert [event.kind for event in family.events] == ["fold", "fold"]
    for event in family.events:
        assert np.abs(event.orbit.multipliers - 1).max() < 1e-4
    assert family.value[-1] == pytest.approx(2 * np.pi / OMEGA, rel=1e-12)
    turns = np.sign(np.diff(family.period))
    assert np.sum(turns[1:] != turns[:-1]) == 2
    # Independent integration of an orbit past a fold in the period of the drive.
    orbit = family[len(family) // 2]
    k = CHAIN.contact_constants
    eps = CHAIN.length_scale
    m = CHAIN.masses[0]

    def rate(t: float, y: np.ndarray) -> list[float]:
        push = k[0] * max(eps + orbit.drive.motion(t)[0] - y[0], 0.0) ** 1.5
        return [y[1], (push - k[1] * max(eps + y[0], 0.0) ** 1.5) / m]

    start = [orbit.displacement[1], orbit.velocity[1]]
    scale = [1e-14 * eps, 1e-14 * eps * OMEGA]
    end = solve_ivp(rate, (0, orbit.period), start, "DOP853", rtol=1e-12, atol=scale).y[:, -1]
    assert end == pytest.approx(start, abs=1e-8 * max(abs(start[0]), abs(start[1]) / OMEGA) * OMEGA)
    assert end[0] == pytest.approx(start[0], abs=1e-8 * orbit.amplitude)


def test_a_grain_driven_at_twice_its_frequency_doubles_its_period():
    """The trace of the tangent map of the only moving grain is -2, by independent integration."""
    k = CHAIN.contact_constants
    eps = CHAIN.length_scale
    m = CHAIN.masses[0]
    w = 1.95 * OMEGA
    drive = Drive(amplitude=0.02 * eps, frequency=w / (2 * np.pi))
    family = orbits.follow(orbits.find(CHAIN, drive=drive), "amplitude", 0.4 * eps)
    (event,) = family.events[:1]
    assert event.kind == "period doubling"
    assert np.abs(event.orbit.multipliers + 1).max() < 1e-2

    def returned(amplitude: float, state: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the state and derivatives after a period in overlaps and radians of the drive."""

        def rate(t: float, y: np.ndarray) -> np.ndarray:
            above = max(1 + amplitude * np.sin(t) - y[0], 0.0)
            below = max(1 + y[0], 0.0)
            pull = (k[0] * above**1.5 - k[1] * below**1.5) * eps**0.5 / m / w**2
            stiff = 1.5 * (k[0] * above**0.5 + k[1] * below**0.5) * eps**0.5 / m / w**2
            return np.array([y[1], pull, y[3], -stiff * y[2], y[5], -stiff * y[4]])

        end = solve_ivp(
            rate, (0, 2 * np.pi), [*state, 1, 0, 0, 1], "DOP853", rtol=1e-12, atol=1e-13
        ).y[:, -1]
        return end[:2], end[2:].reshape(2, 2).T

    def excess(amplitude: float) -> float:
        state = np.array([event.orbit.displacement[1] / eps, event.orbit.velocity[1] / eps / w])
        for _ in range(6):
            end, slope = returned(amplitude, state)
            state = state - np.linalg.solve(slope - np.eye(2), end - state)
        return float(np.trace(returned(amplitude, state)[1]) + 2)

    near = event.value / eps * np.array([0.98, 1.02])
    assert event.value / eps == pytest.approx(brentq(excess, *near, rtol=1e-9), rel=1e-5)


def test_a_family_passes_its_folds_and_returns():
    there = resonance()
    back = orbits.follow(there[-1], "period", there.period[0], events=False)
    assert back.reached
    turns = np.sign(np.diff(back.period))
    assert np.sum(turns[1:] != turns[:-1]) == 2
    assert back[-1].velocity == pytest.approx(there[0].velocity, rel=1e-9)
    assert np.abs(back[-1].displacement - there[0].displacement).max() < 1e-9 * there[0].amplitude


def test_from_a_linear_mode_through_two_folds_and_back():
    """The slowest mode of a column meets a resonance, at which its energy has two folds."""
    chain = Chain(grains=5, diameter=1e-3)
    there = orbits.mode_family(chain, 1, 4e-14)
    back = orbits.follow(there[-1], "energy", there[0].energy)
    for way in (there, back):
        assert way.reached
        turns = np.sign(np.diff(way.energy))
        assert np.sum(turns[1:] != turns[:-1]) == 2
    folds = [
        sorted(event.value for event in way.events if event.kind == "fold") for way in (there, back)
    ]
    assert folds[0] == pytest.approx(folds[1], rel=1e-6)
    assert there[0].period == pytest.approx(
        2 * np.pi / modes.eigenmodes(chain).frequency[0], rel=1e-3
    )
    assert back[-1].period == pytest.approx(there[0].period, rel=1e-10)
    assert back[-1].displacement == pytest.approx(
        there[0].displacement, abs=1e-9 * there[0].amplitude
    )


def test_each_orbit_of_a_family_needs_one_tangent_map(monkeypatch: pytest.MonkeyPatch):
    """One tangent map suffices even if rounding is far above an ulp, as in slow modes."""
    taken = []
    linearise = Equations.linearise

    def counted(self, *arguments):
        taken.append(1)
        return linearise(self, *arguments)

    monkeypatch.setattr(Equations, "linearise", counted)
    chain = Chain(grains=24, diameter=1e-3)
    family = orbits.mode_family(chain, 1, chain.length_scale * chain.masses[0] * 9.81, events=False)
    assert family.reached
    assert max(orbit.residual for orbit in family.orbits) < 1e-12
    assert len(taken) < 1.5 * len(family)


@pytest.mark.parametrize(
    ("parameter", "factor"),
    [("masses[2]", 1.3), ("diameter[3]", 1.1), ("gravity", 2.0), ("exponent", 1.1)],
)
def test_any_parameter_of_the_chain_can_change(parameter: str, factor: float):
    plain = Chain(grains=5, diameter=np.full(5, 1e-3), top_load=1e-5)
    name, _, number = parameter.rstrip("]").partition("[")
    # Given masses and constants would not follow from changed diameters.
    chain = plain.replace(**{name: getattr(plain, name)})
    orbit = orbits.normal_mode(chain, 2, 0.1 * chain.length_scale * chain.masses[0] * 9.81)

    def value(chain: Chain) -> float:
        values = chain.diameters if name == "diameter" else getattr(chain, name)
        return float(values[int(number) - 1] if number else values)

    start = value(chain)
    family = orbits.follow(orbit, parameter, factor * start, hold="energy", events=False)
    assert family.reached
    end = family[-1].chain
    assert value(end) == pytest.approx(factor * start, rel=1e-12)
    assert (family.value[0], family.value[-1]) == pytest.approx((start, value(end)), rel=1e-12)
    assert family.energy == pytest.approx(np.full(len(family), orbit.energy), rel=1e-9)
    exact = orbits.normal_mode(end, 2, orbit.energy)
    assert family[-1].period == pytest.approx(exact.period, rel=1e-9)


def growth(orbit: orbits.Orbit) -> float:
    """Return the largest Floquet multiplier from independently integrated variations."""
    chain = orbit.chain
    n = orbit.chain.grains
    constant = np.array(chain.contacts.constant)
    overlap = np.array(chain.contacts.overlap)
    unit = chain.length_scale
    clock = orbit.period / (2 * np.pi)

    def rate(_: float, y: np.ndarray) -> np.ndarray:
        u, v = y.reshape(2, n, n * 2 + 1)
        squeezed = np.maximum(overlap + np.diff(-u[:, 0] * unit, prepend=0.0, append=0.0), 0.0)
        force = constant * squeezed**1.5 / unit
        stiff = 1.5 * constant * squeezed**0.5
        pull = np.empty_like(u)
        pull[:, 0] = force[:-1] - force[1:]
        change = -stiff[:, None] * np.diff(u[:, 1:], axis=0, prepend=0.0, append=0.0)
        pull[:, 1:] = change[:-1] - change[1:]
        return np.concatenate((v, pull * clock**2 / chain.masses[:, None])).ravel()

    state = np.concatenate((orbit.displacement / unit, orbit.velocity * clock / unit))
    start = np.concatenate((state[:, None], np.eye(2 * n)), axis=1).ravel()
    end = (
        solve_ivp(rate, (0, 2 * np.pi), start, "DOP853", rtol=3e-14, atol=1e-15)
        .y[:, -1]
        .reshape(2 * n, -1)
    )
    assert np.abs(end[:, 0] - state).max() < 1e-8 * np.abs(state).max()
    return float(np.abs(np.linalg.eigvals(end[:, 1:])).max())


@pytest.mark.slow
def test_stability_of_a_breather_changes_where_pairs_of_multipliers_collide():
    masses = np.where(np.arange(11) % 2 == 0, 3e-3, 1e-3)
    chain = Chain(
        grains=11,
        diameter=1e-2,
        gravity=0.0,
        top_load=20.0,
        top="wall",
        bottom="wall",
        masses=masses,
    )
    u, period = orbits.linear_mode(chain, 7, 1e-2)
    rest = np.zeros(11)
    first = orbits.find(chain, (u, rest), period, energy=float(chain.excess_energy(u, rest)))
    there = orbits.follow(first, "period", 1.04 * period)
    # One step may pass both events.
    events = there.events + orbits.follow(there[-1], "period", 1.05 * period).events
    assert [event.kind for event in events] == ["Neimark-Sacker", "Neimark-Sacker"]
    for event, inside in zip(events, (1, -1), strict=True):
        near = [
            orbits.find(chain, event.orbit, event.value * (1 + side * 2e-4))
            for side in (-inside, inside)
        ]
        assert growth(near[0]) == pytest.approx(1, abs=1e-4)
        assert growth(near[1]) > 1.001


def third_mode() -> tuple[Chain, orbits.Orbit, float]:
    """Return a column, an orbit of its third mode, and a higher energy."""
    chain = Chain(grains=6, diameter=1e-3)
    energy = chain.length_scale * chain.masses[0] * 9.81
    return chain, orbits.normal_mode(chain, 3, 0.1 * energy), 0.3 * energy


def test_a_closed_family_ends(
    monkeypatch: pytest.MonkeyPatch,
):
    """After its return, the family would repeat its orbits, shifted by half a period."""
    chain, first, until = third_mode()
    seen: list = []

    def recorded(equations, member):
        seen.append([equations.unpack(aspect.unknown) for aspect in aspects(equations, member)])
        return []

    monkeypatch.setattr(continuation, "aspects", recorded)
    assert orbits.follow(first, "energy", until, events=False).reached
    half = first.motion()[1][first.mesh.size // 2]
    later = orbits.find(chain, (half, np.zeros(6)), first.period, energy=first.energy)
    for aspect, ended in ((0, ""), (1, "it returns to its earlier orbits")):
        points = [points[aspect] for points in seen[1:]]
        monkeypatch.setattr(
            continuation, "aspects", lambda eq, _, of=points: [Aspect(eq.pack(p), 0.0) for p in of]
        )
        family = orbits.follow(later, "energy", until, events=False)
        assert family.ended.startswith(ended)
        assert family.reached == (not ended)


def test_a_family_that_fails_keeps_its_orbits_and_the_reason(monkeypatch: pytest.MonkeyPatch):
    _, first, until = third_mode()
    family = orbits.follow(first, "energy", until, points=3, events=False)
    assert (len(family), family.reached) == (3, False)
    assert family.ended.startswith("the limit of 3 orbits is reached at energy")
    assert "ended='the limit of 3 orbits" in repr(family)
    assert family.plot().get_title("left").startswith("The limit of 3 orbits is reached at energy")
    hasty = replace(continuation.STEPS, still=np.inf, patience=2)
    monkeypatch.setattr(continuation, "STEPS", hasty)
    family = orbits.follow(first, "energy", until, events=False)
    assert (len(family), family.ended[:37]) == (3, "its steps become too short at energy ")
    monkeypatch.setattr(continuation.SolutionBranch, "along", lambda *_: None)
    monkeypatch.setattr(continuation, "STEPS", replace(hasty, patience=60))
    family = orbits.follow(first, "energy", until, events=False)
    assert (len(family), family.ended[:34]) == (1, "it cannot be followed beyond energ")


@pytest.mark.parametrize("failures", [3, 100])
def test_a_target_is_approached_by_halving_if_no_orbit_is_found_there(
    failures: int, monkeypatch: pytest.MonkeyPatch
):
    """The first guesses at the target fail; the orbit is found from shorter steps, or never."""
    _, first, until = third_mode()
    exact = orbits.follow(first, "energy", until, events=False)
    failed = []
    solve = continuation.solve

    def failing(equations, *arguments, **options):
        solution = solve(equations, *arguments, **options)
        energy = equations.flow_at(0.0).energy(solution.point.state)[0] if solution else 0.0
        if energy != pytest.approx(until, rel=1e-9) or len(failed) == failures:
            return solution
        failed.append(energy)
        return None

    monkeypatch.setattr(continuation, "solve", failing)
    family = orbits.follow(first, "energy", until, events=False)
    assert family.reached == (failures == 3)
    if family.reached:
        assert len(failed) == failures
        assert family.period[-1] == pytest.approx(exact.period[-1], rel=1e-10)
    else:
        assert family.ended == f"no orbit of the family is found at {until:g}"
        # Halving ends at a ten-millionth of the size of the orbit.
        assert 15 < len(failed) < 30
        assert family.value.tolist() == exact.value[:-1].tolist()


def test_a_family_with_crowded_events_ends_with_the_located_ones(
    monkeypatch: pytest.MonkeyPatch,
):
    whole = resonance()
    monkeypatch.setattr(continuation, "STEPS", replace(continuation.STEPS, crowded=3))
    family = orbits.follow(orbits.find(CHAIN, drive=whole[0].drive), "period", 2 * np.pi / OMEGA)
    assert (len(family.events), family.reached) == (1, False)
    assert family.events[0].value == pytest.approx(whole.events[0].value, rel=1e-12)
    assert family.ended.startswith("it has too many events, 1 up to period")
    assert len(family) < len(whole)


@pytest.mark.soak
def test_continuation_of_a_long_column_in_a_resonance_stops_soon(monkeypatch: pytest.MonkeyPatch):
    taken = []
    linearise = Equations.linearise
    monkeypatch.setattr(Equations, "linearise", lambda *given: taken.append(1) or linearise(*given))
    chain = Chain(grains=100, diameter=1e-3)
    family = orbits.mode_family(
        chain, 2, 1e4 * chain.length_scale * chain.masses[0] * 9.81, events=False
    )
    assert family.ended.startswith("its steps become too short at energy")
    assert len(taken) < 200
    assert max(orbit.residual for orbit in family.orbits) < 1e-12


def test_a_long_family_is_announced_once(monkeypatch: pytest.MonkeyPatch):
    """The announcement follows two steps, with the position and the remaining time."""
    for module in ("lmpchain.engines.cost_model", "lmpchain.orbits.continuation"):
        monkeypatch.setattr(f"{module}.PATIENCE_S", 50.0)
    seconds = iter(range(0, 10**5, 10))
    monkeypatch.setattr(continuation, "clock", lambda: next(seconds))
    chain = CHAIN.replace(grains=6)
    with pytest.warns(UserWarning, match="the family of orbits from energy") as told:
        family = mode_family(chain, 5, 1e-8)
    assert len(told) == 1
    # Each step takes 10 s of this clock, and the energy grows by equal factors.
    steps = len(family) - 3
    said = re.search(r"takes about ([\d.]+) (s|minutes): a nearer end", str(told[0].message))
    left_s = float(said[1]) * {"s": 1, "minutes": 60}[said[2]]
    assert left_s == pytest.approx(10 * steps, rel=0.5)
