"""Waves in damped chains against dense solutions of the driven linear chain, and their energy."""

import numpy as np
import pytest
from helpers.thinned import thinned

from lmpchain import Chain, InputError
from lmpchain.theory.bands import Cell, branches, gap_modes, gaps, waves
from lmpchain.theory.scattering import reflection, transmission, transparent

RNG = np.random.default_rng(7)
LOADED = {"diameter": 1e-3, "gravity": 0.0, "top_load": 1.0}
CELLS = {
    "one grain": Cell([2.0], [3.0], viscoelastic=0.3, drag=0.2),
    "drag alone": Cell([2.0], [3.0], drag=0.5),
    "two, unlike": Cell([1.0, 3.0], [1.0, 2.0], viscoelastic=[0.1, 0.5], drag=[0.3, 0.0]),
    "resonators": Cell(
        [1.0, 2.0, 3.0], [1.0, 1.5, 1.0], [[0, 0], [0.5, 0.3], [0, 0]], 0.2, [0.1, 0.2, 0.3]
    ),
}


def ratio(cell: Cell, w: float, cells: int = 150) -> complex:
    """Return the ratio of the motions of successive cells driven at w."""
    m, k = (np.asarray(x, float) for x in (cell.masses, cell.stiffness))
    size = m.size
    gamma = np.broadcast_to(cell.drag, size)
    viscosity = np.broadcast_to(cell.viscoelastic, size)
    total = cells * size
    matrix = np.zeros((total, total), complex)
    for n in range(total):
        i = n % size
        matrix[n, n] -= m[i] * w**2 + 1j * w * m[i] * gamma[i]
        if cell.resonators is not None and cell.resonators[i][0]:
            mass, stiffness = cell.resonators[i]
            matrix[n, n] += stiffness - stiffness**2 / (stiffness - mass * w**2)
        if n + 1 < total:
            spring = k[i] * (1 - 1j * w * viscosity[i])
            matrix[n : n + 2, n : n + 2] += spring * np.array([[1, -1], [-1, 1]])
    # The first grain moves with amplitude 1.
    x = np.linalg.solve(matrix[1:, 1:], -matrix[1:, 0])
    motion = np.append(1.0, x)[::size]
    return complex(motion[3] / motion[2])


@pytest.mark.parametrize("name", thinned(CELLS, 2))
def test_the_wavenumber_agrees_with_a_driven_chain(name):
    cell = CELLS[name]
    w = np.array([0.35, 1.4, 4.0])
    found = waves(cell, w)
    assert (found.wavenumber.imag > 0).all()
    exact = np.array([ratio(cell, one) for one in w])
    assert np.exp(1j * found.wavenumber) == pytest.approx(exact, abs=1e-10)
    size = len(cell.masses)
    assert found.attenuation == pytest.approx(-np.log(abs(exact)) / size, rel=1e-9)


def test_one_grain_in_closed_form():
    for w in (1e-4, 1e-2, 1.0, 2.4):
        exact = 2 * np.arcsin(np.sqrt(2.0 * w**2 * (1 + 0.2j / w) / 3.0 / (1 - 0.3j * w)) / 2)
        assert waves(CELLS["one grain"], w).wavenumber == pytest.approx([exact], rel=1e-13)


def test_weak_damping_gives_its_rate_over_the_group_velocity():
    viscosity = 1e-6
    drag = 3e-6
    lossless = branches(Cell([1.0, 3.0], [1.0, 2.0]), [0.4, 1.5, 2.9])
    damped = Cell([1.0, 3.0], [1.0, 2.0], viscoelastic=viscosity, drag=drag)
    for w, velocity in zip(lossless.frequency, lossless.group_velocity, strict=True):
        expected = (viscosity * w**2 + drag) / 2 / abs(velocity) / 2
        assert waves(damped, w).attenuation == pytest.approx(expected, rel=1e-4)


def test_without_damping_waves_decay_only_in_gaps():
    cell = Cell([1.0, 3.0], [1.0, 2.0])
    q = np.array([0.4, 1.5, 2.9])
    for branch in branches(cell, q).frequency:
        found = waves(cell, branch)
        assert found.wavenumber == pytest.approx(q + 0j, abs=1e-12)
    low, high = gaps(cell)[0]
    inside = waves(cell, [(low + high) / 2])
    assert inside.wavenumber.real == pytest.approx([np.pi])
    assert np.exp(1j * inside.wavenumber) == pytest.approx(
        [ratio(cell, (low + high) / 2)], abs=1e-10
    )


def test_a_chain_is_a_cell_with_its_damping():
    damping = {"viscoelastic": 1e-8, "drag": [1e3, 2e3]}
    dimer = Chain(grains=2, material=["steel", "glass"], damping=damping, **LOADED)
    w = 0.5 * dimer.band_edge
    closing = Cell.of(dimer)
    assert np.asarray(closing.viscoelastic).tolist() == [1e-8, 1e-8]
    assert np.asarray(closing.drag).tolist() == [1e3, 2e3]
    unit = Cell(
        np.asarray(closing.masses) * w**2 / 1e4,
        np.asarray(closing.stiffness) / 1e4,
        viscoelastic=1e-8 * w,
        drag=np.array([1e3, 2e3]) / w,
    )
    q = waves(dimer, w).wavenumber
    assert q == pytest.approx(waves(unit, 1.0).wavenumber, rel=1e-12)
    found = waves(dimer, [w, 0.5 * w])
    ax = found.plot()
    assert ax.get_ylabel() == "attenuation a grain"
    assert ax.lines[0].get_xdata() == pytest.approx(found.frequency / (2 * np.pi), rel=1e-14)
    assert ax.lines[0].get_ydata().tolist() == found.attenuation.tolist()
    assert found.attenuation == pytest.approx(found.wavenumber.imag / 2, rel=1e-14)


def test_real_bands_of_damped_cells_are_rejected():
    words = "(does not support|must have no) damping"
    chain = Chain(grains=9, damping={"drag": 1.0}, **LOADED)
    for refused in (
        lambda: branches(CELLS["one grain"], [0.1]),
        lambda: gaps(CELLS["one grain"]),
        lambda: gap_modes(chain.replace(damping=None), CELLS["one grain"]),
        lambda: branches(chain, [0.1]),
        lambda: gap_modes(chain, CELLS["one grain"]),
        lambda: transparent(chain, 1e3, [5, 6]),
    ):
        with pytest.raises(InputError, match=words):
            refused()


def scattered(chain: Chain, w: float) -> tuple[complex, complex, float]:
    """Return both amplitudes, and the dissipated fraction of the energy, by a dense solve."""
    m = chain.masses
    k = chain.linear_stiffness
    n = chain.grains
    viscosity = chain.contact_viscosity[1:-1]
    # The leads are undamped.
    turns = [2 * np.arcsin(w / 2 * np.sqrt(m[end] / k[end])) for end in (0, -1)]
    matrix = np.diag(-m * w**2 - 1j * w * m * chain.drag)
    for i in range(n - 1):
        spring = k[i] * (1 - 1j * w * viscosity[i])
        matrix[i : i + 2, i : i + 2] += spring * np.array([[1, -1], [-1, 1]])
    matrix[0, 0] += k[0] * (1 - np.exp(1j * turns[0]))
    matrix[-1, -1] += k[-1] * (1 - np.exp(1j * turns[1]))
    right = np.zeros(n, complex)
    right[0] = k[0] * (np.exp(-1j * turns[0]) - np.exp(1j * turns[0]))
    x = np.linalg.solve(matrix, right)
    in_contacts = (k * viscosity * w**2 * np.abs(np.diff(x)) ** 2).sum()
    in_grains = (m * chain.drag * w**2 * np.abs(x) ** 2).sum()
    coming = k[0] * w * np.sin(turns[0])
    return x[0] - 1, x[-1], float((in_contacts + in_grains) / coming)


@pytest.mark.parametrize("strength", [0.0, 1e-4, 1e-2, 1.0])
def test_scattering_against_a_linear_solve(strength):
    """Leads are different, with a viscosity per contact and a drag per grain."""
    grains = 14
    chain = Chain(
        grains=grains, material=["steel", "glass"] * 7, gravity=0.0, top_load=2.0,
        diameter=RNG.uniform(0.8e-3, 1.3e-3, grains),
    )  # fmt: skip
    edges = [2 * np.sqrt(chain.linear_stiffness[end] / chain.masses[end]) for end in (0, -1)]
    w = min(edges) * np.array([0.01, 0.3, 0.7, 0.95])
    damped = chain.replace(
        damping={
            "viscoelastic": strength * RNG.uniform(0.5, 1, grains - 1) / max(edges),
            "drag": strength * RNG.uniform(0.0, 1, grains) * max(edges) / 10,
        }
    )
    found = transmission(damped, w)
    exact = [scattered(damped, one) for one in w]
    assert found.amplitude_reflected == pytest.approx([x[0] for x in exact], rel=1e-10, abs=1e-12)
    assert found.amplitude_transmitted == pytest.approx([x[1] for x in exact], rel=1e-10)
    assert found.absorbed == pytest.approx([x[2] for x in exact], rel=1e-10, abs=1e-12)
    assert found.reflected == pytest.approx(np.abs(found.amplitude_reflected) ** 2, rel=1e-14)
    assert found.absorbed + found.reflected + found.transmitted == pytest.approx(np.ones(4))
    drawn = [line.get_label() for line in found.plot().lines]
    assert drawn == ["transmitted", "reflected", "absorbed"][: 3 if strength else 2]
    assert found.absorbed.any() == (strength > 0)


def sent_back(chain: Chain, grains: int, w: float) -> complex:
    """Return the reflected amplitude at the last grain before the end, by a dense solve."""
    part = slice(chain.grains - grains - 1, chain.movable)
    m = chain.masses[part]
    above, k = chain.contacts.stiffness[part.start], chain.contacts.stiffness[1:][part]
    drag = np.append(0.0, chain.drag[part][1:])  # The lead is undamped.
    matrix = np.diag((-m * w**2 - 1j * w * m * drag).astype(complex))
    for i in range(m.size - 1):
        matrix[i : i + 2, i : i + 2] += k[i] * np.array([[1, -1], [-1, 1]])
    matrix[-1, -1] += k[-1]
    turn = 2 * np.arcsin(w / 2 * np.sqrt(m[0] / above))
    matrix[0, 0] += above * (1 - np.exp(1j * turn))
    right = np.zeros(m.size, complex)
    right[0] = above * (np.exp(-1j * turn) - np.exp(1j * turn))
    return complex(np.linalg.solve(matrix, right)[0] - 1)


@pytest.mark.parametrize("bottom", ["fixed", "wall"])
@pytest.mark.parametrize("strength", [0.0, 1e-2, 1.0])
def test_reflection_by_the_end_of_a_chain(bottom: str, strength: float):
    """The drag of the last grains is uneven; the other end has the same reflection if mirrored."""
    drag = np.zeros(30)
    drag[-12:] = strength * RNG.uniform(0.0, 1.0, 12)
    kinds = {"grains": 30, "gravity": 0.0, "top_load": 2.0, "diameter": 1e-3, "bottom": bottom}
    plain = Chain(**kinds)
    edge = 2 * np.sqrt(plain.linear_stiffness[0] / plain.masses[0])
    chain = Chain(**kinds, damping={"drag": drag * edge})
    w = edge * np.array([0.2, 0.5, 0.9])
    found = reflection(chain, 12, frequency=w)
    exact = np.array([sent_back(chain, 12, one) for one in w])
    assert found.amplitude == pytest.approx(exact, rel=1e-9, abs=1e-12)
    assert found.reflected == pytest.approx(np.abs(exact) ** 2, rel=1e-9, abs=1e-12)
    assert found.bands.ravel() == pytest.approx([0.0, edge], abs=1e-9 * edge)
    if strength == 0:
        assert found.reflected == pytest.approx(np.ones(3), rel=1e-10)
    (line,) = found.plot().lines
    assert line.get_xdata() == pytest.approx(w / (2 * np.pi), rel=1e-14)
    assert line.get_ydata().tolist() == found.reflected.tolist()
    # At the free top, u_0 = u_1.
    turn = 2 * np.arcsin(w / edge)
    free = reflection(chain, 9, "top", frequency=w)
    assert free.amplitude == pytest.approx(np.exp(1j * turn * 19), rel=1e-9)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ((12, "side"), 'end: must be "bottom" or "top"'),
        ((12.5, "top"), "grains: must be whole numbers"),
        ((2, "top"), "grains: must be 3 .three cells. to 30 of the chain .got 2."),
        ((31, "top"), "grains: must be 3 .three cells. to 30 of the chain .got 31."),
        ((12, "top", [1.0, 1e9]), "frequency: must lie within a band, 0 to .* rad/s"),
    ],
)
def test_ends_without_a_reflection(arguments: tuple, message: str):
    with pytest.raises(InputError, match=message):
        reflection(Chain(grains=30, **LOADED), *arguments)
