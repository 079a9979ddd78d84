"""The rows of the page on papers: every call runs, and gives the numbers that the page prints."""

import re
from collections.abc import Callable
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from helpers.example_chains import column
from helpers.example_scenes import run, scene_of, struck
from helpers.thinned import thinned

import lmpchain
from lmpchain import Chain, Damping, Drive, Impulse, Riemann, Trajectory, laws, simulate
from lmpchain.measure import (
    echo,
    energy,
    flight,
    harmonic,
    planar,
    power,
    self_similar,
    shock,
    spectrum,
    wavenumbers,
)

PAGE = Path(__file__).parents[2] / "docs" / "papers.md"
BEADS = {"material": "steel", "diameter": 9.5e-3, "gravity": 0.0, "top_load": 10.0}
# Ours, what it is compared with, and by how much they may differ.
Row = tuple[float, float, float]


@cache
def train() -> Trajectory:
    """Simulate the dispersive shock of a piston."""
    chain = Chain(grains=600, top="wall", bottom="wall", **BEADS)
    piston = Drive(shape="piston", velocity=0.07, rise=2e-4, grain=0)
    return run(chain, piston, 9e-3, 1601, 1e-5)


@cache
def opening() -> Trajectory:
    """Simulate a rarefaction wave: half of the chain is expanded to half the overlap at t = 0."""
    chain = Chain(grains=600, top="free", bottom="wall", **BEADS)
    less = -0.5 * float(chain.equilibrium_overlap[0]) / 9.5e-3
    step = Riemann(velocity=(0, 0), strain=(less, 0), grain=350)
    return simulate(scene_of(chain, step, 4e-3, 1601), "native", 1e-5)


def shares() -> Row:
    """Compare the shares of a strike with own integrations."""
    found = lmpchain.strike_shares([1.5, 2, 3])
    own = np.array([0.99366100753, 0.99845213883, 0.99989110533])
    assert np.abs(found.share - own).max() < 1e-8
    return float(found.share[0]), own[0], 1e-9


def bands() -> Row:
    """Compare the sum of the energies of wavenumber bands with the energy of the chain."""
    chain = column(60, gravity=0.0, top_load=1.0)
    scene = struck(chain, 1e-4, 3e-5, 2)

    def share(t: Trajectory) -> float:
        return float(wavenumbers.bands(t).energy[-1].sum() / energy.ledger(t).total[-1])

    found = lmpchain.disorder.measured_over(scene, share, m=5, realisations=10, seed=1)
    return float(found.mean), 1.0, 1e-6


def planar_orbits() -> Row:
    """Compare the distance of the first two crests with that of the closed orbit."""
    waves = planar.orbits(train())
    off = float(waves.spacing_error[0] + waves.orbit_spacing_error[0])
    assert self_similar.view(train()).shock.kind == "dispersive shock"
    return float(waves.spacing[0]), float(waves.orbit_spacing[0]), off


def leading_edge() -> Row:
    """Compare the leading edge with the exact solitary wave of its height."""
    found = shock.find(train())
    return found.leading.speed, found.solitary, found.leading.error


def trailing_edge() -> Row:
    """Compare the trailing edge with Whitham's theory."""
    found = shock.find(train())
    known = found.predictions["whitham"].trailing
    return found.trailing.speed, known, 2 * found.trailing.error


def rarefaction() -> Row:
    """Compare the leading edge of a rarefaction with the speed of sound ahead."""
    found = self_similar.view(opening()).shock
    known = found.predictions["continuum"].leading
    return found.leading.speed, known, found.leading.error


def travelling_wave() -> Row:
    """Compare the speed of a solitary wave with its published constant of a sonic vacuum."""
    return lmpchain.theory.soliton.solve(1.5, velocity=1.0).speed, 0.907470, 1e-6


def dispersion() -> Row:
    """Compare the phase of weak waves with 2 asin(0.6)."""
    chain = Chain(grains=200, material="steel", diameter=1e-2, gravity=0.0, top_load=20.0)
    fastest = 2 * np.sqrt(chain.linear_stiffness[0] / chain.masses[0])
    frequency = 0.6 * float(fastest) / (2 * np.pi)
    drive = Drive(amplitude=1e-9, frequency=frequency)
    scene = scene_of(chain, drive, 50 / frequency)
    found = lmpchain.dispersion(scene, [frequency], [1e-10])
    return float(found.phase[0, 0]), 2 * np.arcsin(0.6), 3 * float(found.phase_error[0, 0])


def diode() -> Row:
    """Compare a tone through two segments with the frequency of its drive."""
    diameter = np.repeat([1e-2, 6e-3], 15)
    chain = Chain(grains=30, diameter=diameter, material="steel", gravity=0.0, top_load=10.0)
    tone = Drive(amplitude=1e-8, frequency=2000.0)
    found = spectrum.spectrum(run(chain, tone, 2e-2, 2001, 1e-8), window="hann")
    peak = float(found.frequency[found.amplitude[:, 4].argmax()])
    return peak, 2000.0, 60.0


def gradient() -> Row:
    """Compare the derivative of an energy with respect to a mass with central differences."""
    chain = Chain(grains=10, diameter=5e-3, material="steel", gravity=0.0, top_load=10.0)
    scene = struck(chain, 1e-2, 5e-5, 51)
    peak = lmpchain.design.PeakForce(5)
    found = lmpchain.design.gradient(scene, peak, ["masses"], 1e-9)["masses"][3]

    def value(factor: float) -> float:
        masses = chain.masses.copy()
        masses[3] *= factor
        changed = scene.replace(chain=chain.replace(masses=masses))
        return lmpchain.design.gradient(changed, peak, ["masses"], 1e-9).value

    step = 1e-4
    known = (value(1 + step) - value(1 - step)) / (2 * step * chain.masses[3])
    return float(found / known), 1.0, 1e-5


def impact() -> Row:
    """Compare the speed of a hard impact under gravity with that of its solitary wave."""
    chain = Chain(grains=40, material="steel", diameter=5e-3)
    found = flight.time_of_flight(run(chain, Impulse(velocity=1.0), 2.5e-4, 401, 1e-8), 5, 12).speed
    wave = lmpchain.theory.soliton.solve(1.5, velocity=0.68163).speed
    scale = (chain.contact_constants[0] / chain.masses[0]) ** 0.4
    return float(found), float(wave * scale * 5e-3), 1.0


def reflected() -> Row:
    """Compare the energy of an echo from a wall with that of the solitary wave before."""
    beads = Chain(grains=40, material="steel", diameter=5e-3, gravity=0.0, bottom="wall")
    return float(echo.find(simulate(struck(beads, 0.1, 9e-4, 1201)), grain=15).share), 1.0, 0.01


def balance(law: lmpchain.Law, **keys: float) -> Row:
    """Compare the energy of a chain with a law by formula with that at the start."""
    chain = Chain(grains=12, diameter=5e-3, material="steel", gravity=0.0, law=law, **keys)
    beads = run(chain, Impulse(velocity=1e-2), 1e-4, 401, 1e-8)
    total = energy.ledger(beads).total
    return float(total[-1] / total[0]), 1.0, 1e-6


def turns() -> Row:
    """Run a chain of hardening and softening contacts in turns."""
    exponents = [1.5, 0.8] * 5 + [1.5]
    return balance(laws.power(exponents, k=1e5), top_load=1.0)


def bistable() -> Row:
    """Run a bistable chain."""
    return balance(laws.bistable(1e-4, 2e-4, k=1e5), bottom="free")


def bilinear() -> Row:
    """Compare the power through two contacts of a driven chain of bilinear springs."""
    chain = Chain(
        grains=8,
        diameter=1e-2,
        material="steel",
        gravity=0.0,
        law=laws.bilinear(0.5, k=1e5),
        bottom="free",
        damping=Damping(drag=200.0),
    )
    tone = Drive(amplitude=1e-7, frequency=100.0)
    run = simulate(scene_of(chain, tone, 0.6, 1801), "native", 1e-8)
    first, later = power.through(run, 1), power.through(run, 4)
    assert np.mean(first.power) > np.mean(later.power) > 0
    return balance(laws.bilinear(0.5, k=1e5), bottom="free")


def softening() -> Row:
    """Run a chain of softening contacts."""
    return balance(laws.softening(1e-4, k=1e5), top_load=1.0)


def apparent_mass() -> Row:
    """Compare the apparent mass of a shaken column, in g, with the linear one."""
    damping = Damping(viscoelastic=4e-6)
    chain = Chain(grains=6, material="steel", diameter=1e-2, bottom="wall", damping=damping)
    shaker = Drive(end="bottom", amplitude=1e-10, frequency=500.0)
    found = harmonic.drive_point(run(chain, shaker, 0.4, 4801, 1e-9))
    linear = -found.linear / (2 * np.pi * 500.0) ** 2
    slack = 1e3 * (found.apparent_mass_error + 1e-8 * abs(linear))
    return 1e3 * abs(found.apparent_mass), 1e3 * abs(linear), slack


def chaos() -> Row:
    """Compare the sum of the Lyapunov spectrum of a chain with 0, that of Hamiltonian motion."""
    chain = Chain(grains=4, diameter=5e-3, gravity=0.0, top="wall", bottom="wall")
    scene = struck(chain, 0.1, 0.02)
    found = lmpchain.orbits.chaos_of(scene)
    return float(found.exponent.sum() / found.exponent[0]), 0.0, 1e-6


ROWS: dict[str, tuple[Callable[[], Row], str]] = {
    "2002.08499": (shares, "{:.8f}"),
    "1815": (bands, "{:.6f}"),
    "2206.06413": (planar_orbits, "{:.2f}"),
    "2402.08218": (leading_edge, "{:.0f}"),
    "2411.17874": (trailing_edge, "{:.0f}"),
    "2512.22913": (rarefaction, "{:.0f}"),
    "2408.15837": (travelling_wave, "{:.6f}"),
    "2009.14357": (dispersion, "{:.5f}"),
    "2408.09551": (diode, "{:.0f}"),
    "2411.15142": (gradient, "{:.5f}"),
    "2509.13860": (impact, "{:.1f}"),
    "041005": (reflected, "{:.3f}"),
    "2210.11690": (turns, "{:.6f}"),
    "2301.09149": (bistable, "{:.6f}"),
    "2502.08726": (bilinear, "{:.6f}"),
    "2007.07961": (apparent_mass, "{:.4f}"),
    "2504.16633": (softening, "{:.6f}"),
    "2112.02254": (chaos, "{:.3f}"),
}


def lines() -> dict[str, str]:
    """Return the line of the page for each key of `ROWS`."""
    table = [line for line in PAGE.read_text().splitlines() if line.startswith("| ")]
    return {key: next(line for line in table if key in line.split("|")[1]) for key in ROWS}


@pytest.mark.parametrize("key", thinned(ROWS, 2))
def test_the_call_of_a_row_gives_the_numbers_of_the_page(key: str) -> None:
    measure, shown = ROWS[key]
    ours, known, allowed = measure()
    assert abs(ours - known) <= allowed
    line = lines()[key]
    assert shown.format(ours).replace("-0.000", "0.000") in line
    assert shown.format(known) in line


def test_every_row_names_a_call_that_exists_or_says_what_is_missing() -> None:
    rows = [line.split("|")[1:-1] for line in PAGE.read_text().splitlines()[8:]]
    rows = [[cell.strip() for cell in row] for row in rows if len(row) == 5]
    assert sum(len(re.findall(r"\d{4}\.\d{5}", row[0])) for row in rows) >= 25
    pages = Path(__file__).parents[2] / "docs" / "gallery"
    for paper, _, call, picture, ours in rows:
        assert call == "-" or "`" in call, paper
        assert call != "-" or picture == "-", paper
        assert picture == "-" or (pages / f"{picture.strip('`')}.py").exists(), paper
        assert ours not in ("", "-"), paper
