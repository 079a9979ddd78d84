"""Solitary waves of dimer chains: equation of motion, propagation, scans and refusals."""

from functools import cache

import numpy as np
import pytest
from helpers.faults import faults
from helpers.independent_theory import derivatives
from scipy.optimize import minimize_scalar

import lmpchain
from lmpchain import Chain, InputError
from lmpchain.theory import dimer_soliton
from lmpchain.theory.dimer_soliton import DimerSoliton, antiresonances, solve

VELOCITIES = {1.5: 0.1, 2.0: 3.0}
each = pytest.mark.parametrize("delta", VELOCITIES)


@cache
def wave_of(delta: float = 1.5) -> DimerSoliton:
    """Return the wave near the mass ratio 0.35 with the velocity in `VELOCITIES`."""
    return solve(0.35, delta, VELOCITIES[delta])


def dimer(grains: int = 40, heavy_first: bool = True, ratio: float | None = None, **keys) -> Chain:
    """Return a dimer chain of grains of 3e-5 kg and light ones, with contact constants of 2e9."""
    if ratio is None:
        ratio = wave_of().mass_ratio
    masses = np.resize([3e-5, 3e-5 * ratio] if heavy_first else [3e-5 * ratio, 3e-5], grains)
    constants = {"masses": masses, "contact_constants": np.full(grains - 1, 2e9)}
    return Chain(**{"grains": grains, "diameter": 1e-2, "gravity": 0.0} | constants | keys)


@pytest.mark.slow
def test_mass_ratio_published():
    """The ratio is 0.3428 (Jayaprakash et al. 2011), to ten digits by another solver."""
    assert wave_of().mass_ratio == pytest.approx(0.3428457812, abs=1e-10)


@each
def test_equation_of_motion(delta: float):
    """c^2 A'' = N(A(1 - x)) - N(A(x)) (1 + 1/m) + N(A(-1 - x)) / m by differences of order 8."""
    wave = wave_of(delta)
    inertia = 1 / wave.mass_ratio
    scale = wave.overlap(0.0)

    def force(x: float) -> float:
        return max(float(wave.overlap(x)), 0.0) ** wave.delta

    for x in (-2.0, -1.1, -0.5, -0.2, 0.0, 0.3, 0.7, 1.6):
        _, bend = derivatives(wave.overlap, x, 0.05)
        right = force(1 - x) - force(x) * (1 + inertia) + inertia * force(-1 - x)
        assert wave.speed**2 * bend == pytest.approx(
            right, rel=0, abs=1e-6 * scale**wave.delta * inertia
        )
    assert np.abs(wave.overlap(np.array([-5.9, -5.5, 5.5, 5.9]))).max() < 1e-11 * scale
    assert wave.overlap(np.array([-30.0, 30.0])).tolist() == [0.0, 0.0]


@each
def test_grains_move_as_contacts_close(delta: float):
    """Overlaps are differences of displacements, and velocities are -c times the slopes."""
    wave = wave_of(delta)
    x = np.array([-9.0, -3.1, -0.8, 0.0, 0.35, 2.0])
    largest = float(wave.displacement(-8.0))
    for light in (False, True):
        behind = wave.displacement(x - 0.5, light)
        ahead = wave.displacement(x + 0.5, not light)
        closer = wave.overlap(x, light_behind=light)
        assert closer == pytest.approx(behind - ahead, rel=0, abs=1e-12 * largest)
        assert closer[3] > 0.1 * largest
        for place in (-1.7, -0.4, 0.0, 0.9):
            slope, _ = derivatives(lambda y, kind=light: wave.displacement(y, kind), place, 0.05)
            velocity = float(wave.velocity(place, light))
            assert velocity == pytest.approx(
                -wave.speed * slope, rel=0, abs=1e-7 * wave.speed * largest
            )
        assert wave.displacement([7.0, 30.0], light).tolist() == [0.0, 0.0]
        behind_all = wave.displacement([-7.3, -8.0, -30.0, -31.0], light)
        assert behind_all == pytest.approx(largest, rel=1e-11)
    assert wave.overlap(0.3, light_behind=True) == wave.overlap(-0.3)


def test_the_given_velocity_is_the_largest_of_heavy_grains():
    plain = solve(0.35)
    assert plain.delta == 1.5
    for wave, velocity in ((wave_of(), 0.1), (wave_of(2.0), 3.0), (plain, 1.0)):
        coarse = np.linspace(-2, 2, 41)
        near = coarse[wave.velocity(coarse).argmax()] + np.array([-0.1, 0.0, 0.1])
        peak = minimize_scalar(lambda x, wave=wave: -wave.velocity(x), tuple(near))
        assert -peak.fun == pytest.approx(velocity, rel=1e-8)


@pytest.mark.parametrize("heavy_first", [True, False])
def test_travels_unchanged(heavy_first: bool):
    """The engine moves the wave by four grains, and leaves no motion behind."""
    chain = dimer(32, heavy_first)
    start = wave_of().on(chain, 11)
    end = wave_of().on(chain, 15)
    time = (3e-5 / 2e9) ** 0.4 * 4 / wave_of().speed
    scene = lmpchain.Scene(chain=chain, excitation=start, duration=time, samples=2)
    t = lmpchain.simulate(scene, engine="native", tolerance=1e-9)
    assert t.velocity[-1] == pytest.approx(end.velocity, rel=0, abs=1e-9 * 0.1)
    assert t.displacement[-1] == pytest.approx(
        end.displacement, rel=0, abs=1e-9 * end.displacement.max()
    )
    heavy = slice(0 if heavy_first else 1, None, 2)
    assert 0.08 < np.max(start.velocity[heavy]) <= 0.1 * (1 + 1e-9)


def test_newtons_method_needs_few_steps(monkeypatch):
    """Correct derivatives reduce the 2 % error of the first approximation to 1e-12 in 4 steps."""
    wave = wave_of()
    steps = []
    solve_linear = np.linalg.solve

    def counted(matrix, right):
        steps.append(1)
        return solve_linear(matrix, right)

    monkeypatch.setattr(dimer_soliton.np.linalg, "solve", counted)
    again = solve(0.343, 1.5, 0.1)
    assert again.mass_ratio == pytest.approx(wave.mass_ratio, rel=1e-12)
    assert len(steps) == 4
    assert again.values == pytest.approx(wave.values, rel=0, abs=1e-11 * wave.values.max())


def scan(least: float, monkeypatch, **keys) -> tuple[tuple[float, ...], list[float]]:
    """Return the ratios of a scan whose searches end at the nearest of four, and their starts."""
    begun = []

    def nearest(near: float, delta: float):
        begun.append(near)
        assert delta == keys.get("delta", 1.5)
        if near > 0.5:
            raise InputError([("near", "there is none")])
        ratios = np.array([1.7, 0.3428457812, 0.1547515139, 0.0901, 0.0615])
        ratio = ratios[np.abs(1 / np.sqrt(ratios) - 1 / np.sqrt(near)).argmin()]
        return float(ratio + 1e-12 * np.sin(near)), None, None

    monkeypatch.setattr(dimer_soliton, "_solve", nearest)
    return antiresonances(least, **keys), begun


def test_a_scan_gives_every_ratio_once_in_descending_order(monkeypatch):
    ratios = (0.3428457812, 0.1547515139, 0.0901, 0.0615)
    for least, count in ((0.06, 4), (0.0901, 3), (0.1, 2), (0.2, 1), (0.35, 0), (0.03, 4)):
        values, _ = scan(least, monkeypatch)
        assert values == ratios[:count]
    values, begun = scan(0.1, monkeypatch)
    searches = len(begun)
    assert antiresonances() == values
    assert begun[:searches] == begun[searches:]
    assert scan(0.1, monkeypatch, delta=2.5)[0] == ratios[:2]


@pytest.mark.parametrize("least", [0.03, 0.06, 0.1, 0.3, 0.9])
def test_searches_start_at_half_the_distance_of_the_ratios(least: float, monkeypatch):
    """The waves are some 0.8 apart in s = 1 / sqrt(ratio), which starts at 1."""
    _, begun = scan(least, monkeypatch)
    s = 1 / np.sqrt(begun)
    assert 1 < s[0] < 1.4
    assert np.diff(s).max(initial=0.0) < 0.4
    assert np.diff(s).min(initial=1.0) > 0.3
    assert 0.3 < s[-1] - 1 / np.sqrt(least) < 0.71


def test_a_scan_shows_its_progress_on_request(monkeypatch, capsys):
    _, begun = scan(0.1, monkeypatch)
    assert not capsys.readouterr().err
    scan(0.1, monkeypatch, progress=True)
    assert f"antiresonances: {len(begun)} of {len(begun)} |" in capsys.readouterr().err


def test_picture():
    axes = wave_of().plot().figure.axes[0]
    lines = {line.get_label(): line for line in axes.lines}
    drawn = {
        "velocity of heavy grains": wave_of().velocity,
        "velocity of light grains": lambda x: wave_of().velocity(x, light=True),
        "overlap ahead of heavy grains": wave_of().overlap,
        "overlap ahead of light grains": lambda x: wave_of().overlap(x, light_behind=True),
    }
    assert list(lines) == [list(drawn)[i] for i in (0, 2, 1, 3)]
    for label, function in drawn.items():
        x = lines[label].get_xdata()
        assert x[[0, -1]].tolist() == [-4, 4]
        assert np.diff(x).max() < 0.021
        assert x[x.size // 2] == 0
        assert lines[label].get_ydata() == pytest.approx(function(x), rel=1e-14)
    assert lines["overlap ahead of heavy grains"].get_linestyle() == "--"
    assert (axes.get_xlabel(), axes.get_ylabel()) == (
        "x − ct (grains)",
        "units of heavy mass and contact",
    )
    assert axes.get_title("left") == f"δ = 1.5, mass ratio 0.34284578, speed {wave_of().speed:.7g}"
    assert len(axes.get_legend().get_texts()) == 4


@pytest.mark.parametrize(
    ("call", "key", "message"),
    [
        (lambda: solve(1.0), "near", "must be between 0 and 1"),
        (lambda: solve(0.0), "near", "must be between 0 and 1"),
        (lambda: solve(0.3, 1.0), "delta", "must be above 1, and 3 or less"),
        (lambda: solve(0.3, 3.01), "delta", "must be above 1, and 3 or less"),
        (lambda: solve(0.3, velocity=0.0), "velocity", "must be above 0"),
        (lambda: solve(0.3, velocity=np.inf), "velocity", "must be above 0"),
        (lambda: antiresonances(0.0299), "least", "must be from 0.03 to 1"),
        (lambda: antiresonances(1.0), "least", "must be from 0.03 to 1"),
        (lambda: antiresonances(0.5, 1.0), "delta", "must be above 1, and 3 or less"),
        (lambda: antiresonances(0.5, 3.01), "delta", "must be above 1, and 3 or less"),
        (
            lambda: wave_of().on(Chain(grains=1, diameter=1e-3, bottom="wall"), 1),
            "grains",
            "must be two or more",
        ),
        (
            lambda: wave_of().on(dimer(exponent=2.0), 20),
            "chain",
            "must have the exponent 1.5 of the wave",
        ),
        (lambda: wave_of().on(dimer(top_load=1.0), 20), "chain", "must be in a sonic vacuum"),
        (
            lambda: wave_of().on(dimer(ratio=wave_of().mass_ratio * (1 + 1.1e-9)), 20),
            "masses",
            "ratio 0.3428457811",
        ),
        (lambda: wave_of().on(dimer(masses=np.ones(40)), 20), "masses", "must alternate"),
        (
            lambda: wave_of().on(dimer(contact_constants=np.append(np.ones(38), 1.1)), 20),
            "contact_constants",
            "be equal",
        ),
        (lambda: wave_of().on(dimer(), 6.9), "grain", "must lie from 7 to 33 for"),
        (lambda: wave_of().on(dimer(), 33.1), "grain", "must lie from 7 to 33 for"),
    ],
)
def test_refusals(call, key: str, message: str):
    ((where, text),) = faults(call)
    assert where == key
    assert message in text


def test_values_at_the_limits_are_accepted(monkeypatch):
    wave_of().on(dimer(ratio=wave_of().mass_ratio * (1 + 0.9e-9)), 7)
    wave_of().on(dimer(contact_constants=np.append(np.full(38, 2e9), 2e9 * (1 + 0.5e-9))), 33)
    assert scan(0.5, monkeypatch, delta=3.0)[0] == ()
    assert scan(0.999, monkeypatch, delta=3)[0] == ()


def test_a_search_without_convergence_is_reported(monkeypatch):
    monkeypatch.setattr(dimer_soliton.np.linalg, "solve", lambda _, right: np.ones(right.size))
    with pytest.raises(
        InputError,
        match=r"^near: there is no wave that does not radiate near the mass ratio 0.7: try",
    ):
        solve(0.7)
