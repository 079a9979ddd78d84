"""Bands of periodic chains: closed forms, differences, densities, and modes in gaps against exact ones."""

import numpy as np
import pytest

from lmpchain import Chain, InputError
from lmpchain.theory.bands import Cell, branches, gap_modes, gaps, repeating
from lmpchain.theory.modes import eigenmodes

LOADED = {"gravity": 0.0, "top_load": 3.0, "diameter": 1e-3}
Q = np.linspace(-np.pi, np.pi, 23)
DECORATED = Cell([1.0, 2.0, 3.0], [1.0, 1.5, 1.0], [[0, 0], [0.5, 0.3], [0, 0]])
each = pytest.mark.parametrize(
    "cell", [DECORATED, Cell([2.0], [3.0]), Cell([1.0, 3.0], [1.0, 1.0]), Cell([1, 2, 5, 1], [3, 1, 2, 2])]
)


def test_uniform_chain():
    found = branches(Cell([2.0], [3.0]), Q)
    exact = 2 * np.sqrt(1.5) * np.abs(np.sin(Q / 2))
    assert np.asarray(found)[0] == pytest.approx(exact, rel=1e-13, abs=1e-14)
    assert found[0] is not found.frequency
    inner = Q[(np.abs(Q) > 0.1) & (np.abs(Q) < 3)]
    slope = np.sqrt(1.5) * np.cos(inner / 2) * np.sign(inner)
    assert branches(found.cell, inner).group_velocity[0] == pytest.approx(slope, rel=1e-12)
    assert branches(found.cell, 0.0).group_velocity == pytest.approx(np.sqrt(1.5), rel=1e-13)
    assert found.gaps.size == 0


def test_a_uniform_chain_folded():
    """A cell of four like grains has the one branch of the uniform chain, folded four times."""
    folded = branches(Chain(grains=4, **LOADED), Q)
    one = branches(Chain(grains=2, **LOADED), 2 * np.pi * np.arange(2)[:, None].T[0]).cell
    unit = np.sqrt(one.stiffness[0] / one.masses[0])
    exact = np.sort([2 * unit * np.abs(np.sin((Q + 2 * np.pi * j) / 8)) for j in range(4)], axis=0)
    assert folded.frequency == pytest.approx(exact, rel=1e-12, abs=1e-13 * unit)
    assert folded.gaps.size == 0


@pytest.mark.parametrize("m", [0.1, 1.0, 2.5])
def test_dimer(m: float):
    found, both = branches(Cell([m, 3.0], [2.0, 2.0]), Q), 1 / m + 1 / 3
    root = np.sqrt(both**2 - 4 * np.sin(Q / 2) ** 2 / (3 * m))
    assert found.frequency[0] ** 2 == pytest.approx(2 * (both - root), abs=1e-13)
    assert found.frequency[1] ** 2 == pytest.approx(2 * (both + root), rel=1e-13)
    assert found.gaps == pytest.approx(np.sqrt([[4 / 3, 4 / m]]), rel=1e-13)


@each
def test_many_cells_have_these_frequencies(cell: Cell):
    """A ring of 6 cells by a dense matrix."""
    m, k = np.tile(cell.masses, 6), np.tile(cell.stiffness, 6)
    inside = np.tile(np.zeros((len(cell.masses), 2)) if cell.resonators is None else cell.resonators, (6, 1))
    n, carried = m.size, np.flatnonzero(inside[:, 0])
    total = n + carried.size
    matrix = np.zeros((total, total))
    springs = [(i, (i + 1) % n, k[i]) for i in range(n)] + [(g, n + j, inside[g, 1]) for j, g in enumerate(carried)]
    for a, b, spring in springs:
        matrix[[a, b], [a, b]] += spring
        matrix[[a, b], [b, a]] -= spring
    root = np.sqrt(np.append(m, inside[carried, 0]))
    exact = np.linalg.eigvalsh(matrix / np.outer(root, root))
    found = np.sort(branches(cell, 2 * np.pi * np.arange(6) / 6).frequency.ravel())
    assert found**2 == pytest.approx(exact, rel=1e-10, abs=1e-13)


@each
def test_group_velocity_by_differences(cell: Cell):
    q, step = np.array([-2.5, -1.0, 0.3, 1.7, 2.9]), 1e-5
    found = branches(cell, q)
    slope = (branches(cell, q + step).frequency - branches(cell, q - step).frequency) / (2 * step)
    assert found.group_velocity == pytest.approx(slope, abs=1e-8)


@each
def test_density_of_states(cell: Cell):
    """1 / (pi |v|) of every branch; the integral over all frequencies up to one counts the modes below it."""
    q = np.linspace(0.05, 3.05, 31)
    found = branches(cell, q)
    assert found.density_of_states(found.frequency) == pytest.approx(
        1 / (np.pi * np.abs(found.group_velocity)), rel=1e-5
    )
    assert all(found.density_of_states(gap.mean()) == 0 for gap in found.gaps)
    assert found.density_of_states(2 * found.frequency.max()) == 0
    count = 0.0
    for branch in branches(cell, [0.2, 2.8]).frequency:
        x, weight = np.polynomial.legendre.leggauss(60)
        low, high = np.sort(branch)
        count += (high - low) / 2 * (found.density_of_states((low + high) / 2 + (high - low) / 2 * x) @ weight)
    assert count == pytest.approx(found.frequency.shape[0] * 2.6 / np.pi, rel=1e-6)


@each
def test_edges_are_where_a_fine_scan_finds_them(cell: Cell):
    fine = branches(cell, np.linspace(0, np.pi, 801)).frequency
    between = np.column_stack((fine[:-1].max(1), fine[1:].min(1)))
    assert gaps(cell) == pytest.approx(between[between[:, 1] - between[:, 0] > 1e-6], rel=1e-9)


def test_a_local_resonator_opens_a_gap():
    """Mass in mass: the gap begins below the frequency sqrt(k/m) of the resonator and ends at q = 0, m_eff = 0."""
    ((low, high),) = gaps(Cell([1.0], [1.0], [[0.4, 0.2]]))
    assert low < np.sqrt(0.5) < high
    assert high == pytest.approx(np.sqrt(0.2 / 0.4 * (1 + 0.4)), rel=1e-13)
    assert low**2 * (1 + 0.4 / (1 - low**2 / 0.5)) == pytest.approx(4, rel=1e-12)


def test_a_chain_as_a_cell():
    """Closed by the contact of its last grain with its first, whether contacts are given or follow from Hertz."""
    kinds = {"material": ["steel", "ptfe", "glass"], "diameter": [1e-3, 2e-3, 1.5e-3], "gravity": 0.0, "top_load": 3.0}
    cell = Cell.of(Chain(grains=3, **kinds))
    twice = Chain(grains=6, **{k: v * 2 if isinstance(v, list) else v for k, v in kinds.items()})
    assert cell.stiffness == pytest.approx(twice.linear_stiffness[:3], rel=1e-12)
    given = Cell.of(Chain(grains=3, **kinds, contact_constants=2 * twice.contact_constants[:2]))
    assert given.stiffness == pytest.approx(cell.stiffness * 2 ** (2 / 3), rel=1e-12)


def test_what_repeats():
    masses = np.resize([1.0, 2.0, 2.0], 30)
    assert repeating(Chain(grains=30, diameter=1e4, masses=masses, contact_constants=np.ones(29))) == 3
    assert repeating(Chain(grains=30, diameter=1e-3)) == 1
    broken = Chain(
        grains=30, diameter=1e-3, material=["steel", "glass"] * 15, impurity=[{"grain": 20, "diameter": 2e-3}]
    )
    assert repeating(broken) == 1
    assert repeating(broken, 1, 18) == 2
    assert repeating(broken, 22, 30) == 2


def test_a_light_impurity_has_a_mode_above_the_band():
    """w / w_max = [mu (2 - mu)]^(-1/2) for the mass mu < 1 among equal springs; displacements fall by mu / (2 - mu)."""
    mu, host = 0.5, Chain(grains=81, diameter=1e5, masses=np.ones(81), contact_constants=np.ones(80), gravity=0.0,
                          top_load=1.0)  # fmt: skip
    chain = Chain(**host.given() | {"masses": np.where(np.arange(81) == 40, mu, 1.0)})
    found = gap_modes(chain, Cell([1.0], [1.5]))
    assert found.frequency == pytest.approx(2 * np.sqrt(1.5 / (mu * (2 - mu))), rel=1e-12)
    shape = found.shape[0] / found.shape[0, 40]
    assert shape[41:50] == pytest.approx((-mu / (2 - mu)) ** np.arange(1, 10), rel=1e-9)
    share = np.append(mu, 2 * (mu / (2 - mu)) ** (2 * np.arange(1, 40)))
    both = mu**2 + 2 * ((mu / (2 - mu)) ** (4 * np.arange(1, 40))).sum()
    assert found.participation == pytest.approx(share.sum() ** 2 / both, rel=1e-9)
    assert found.centre == pytest.approx(41, abs=1e-9)
    assert gap_modes(host, Cell([1.0], [1.5])).frequency.size == 0


def test_a_surface_mode_at_a_light_free_end():
    """w^2 = K (1/m + 1/M) in the gap of a dimer; amplitudes fall by m / M a cell. Theocharis et al. (2010)."""
    for first, count in (([1.0, 3.0], 1), ([3.0, 1.0], 0)):
        chain = Chain(grains=80, diameter=1e5, masses=np.resize(first, 80), contact_constants=np.ones(79), gravity=0.0,
                      top_load=1.0)  # fmt: skip
        found = gap_modes(chain, Cell([1.0, 3.0], [1.5, 1.5]))
        at_top = found.centre < 5
        assert at_top.sum() == count
        if count:
            assert found.frequency[at_top] == pytest.approx(np.sqrt(1.5 * 4 / 3), rel=1e-12)
            assert 1 < found.participation[at_top] < 4
    assert (np.isin(found.frequency, eigenmodes(chain).frequency)).all()


def test_pictures():
    found = branches(Cell([1.0, 3.0], [1.0, 1.0]), Q)
    axes = found.plot().figure.axes[0]
    assert (len(axes.lines), len(axes.patches)) == (2, 1)
    chain = Chain(grains=20, **LOADED, impurity=[{"grain": 9, "diameter": 0.5e-3}])
    modes = gap_modes(chain, Chain(grains=2, **LOADED))
    assert len(modes.plot().figure.axes[0].lines) == modes.frequency.size == 1


@pytest.mark.parametrize(
    ("call", "key"),
    [
        (lambda: branches(Cell([1.0, -1.0], [1.0, 1.0]), 0.1), "masses"),
        (lambda: branches(Cell([1.0, 1.0], [1.0]), 0.1), "stiffness"),
        (lambda: branches(Cell([1.0], [1.0], [[1.0]]), 0.1), "resonators"),
        (lambda: branches(Chain(grains=2, diameter=1e-3), 0.1), "gravity"),
        (lambda: branches(Chain(grains=2, diameter=1e-3, gravity=0.0), 0.1), "top_load"),
    ],
)
def test_refusals(call, key: str):
    with pytest.raises(InputError, match=f"{key}: "):
        call()
