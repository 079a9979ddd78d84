"""Bands of periodic chains and modes in gaps, against closed forms and dense matrices."""

from typing import Any

import numpy as np
import pytest
from scipy.optimize import brentq

from lmpchain import Chain, InputError, Law
from lmpchain.theory.bands import Cell, branches, gap_modes, gaps, local_bands, repeating, waves
from lmpchain.theory.modes import eigenmodes

LOADED = {"gravity": 0.0, "top_load": 3.0, "diameter": 1e-3}
Q = np.linspace(-np.pi, np.pi, 23)
DECORATED = Cell([1.0, 2.0, 3.0], [1.0, 1.5, 1.0], [[0, 0], [0.5, 0.3], [0, 0]])
CELLS = [
    DECORATED, Cell([2.0], [3.0]), Cell([1.0, 3.0], [1.0, 1.0]), Cell([1, 2, 5, 1], [3, 1, 2, 2]),
]  # fmt: skip
GROUNDED = [
    Cell([2.0], [3.0], ground=0.7),
    Cell([1.0, 2.0, 3.0], [1.0, 1.5, 1.0], DECORATED.resonators, ground=[0.5, 0.0, 2.0]),
]
each = pytest.mark.parametrize("cell", CELLS + GROUNDED)


def unit_chain(masses: np.ndarray, **keys: Any) -> Chain:
    """Return a chain of these masses under a load of 1 with contact constants of 1."""
    size = len(masses)
    units = {"diameter": 1e5, "gravity": 0.0, "top_load": 1.0}
    return Chain(
        **{"grains": size, "masses": masses, "contact_constants": np.ones(size - 1)} | units | keys
    )


def test_uniform_chain():
    """A cell of four equal grains has the branch of the uniform chain, folded four times."""
    found = branches(Cell([2.0], [3.0]), Q)
    exact = 2 * np.sqrt(1.5) * np.abs(np.sin(Q / 2))
    assert np.asarray(found)[0] == pytest.approx(exact, rel=1e-13, abs=1e-14)
    assert found[0] is not found.frequency
    assert found.gaps.size == 0
    folded = branches(Chain(grains=4, **LOADED), Q)
    one = branches(Chain(grains=2, **LOADED), 2 * np.pi * np.arange(2)[:, None].T[0]).cell
    unit = np.sqrt(one.stiffness[0] / one.masses[0])
    exact = np.sort([2 * unit * np.abs(np.sin((Q + 2 * np.pi * j) / 8)) for j in range(4)], axis=0)
    assert folded.frequency == pytest.approx(exact, rel=1e-12, abs=1e-13 * unit)
    assert folded.gaps.size == 0


@each
def test_rings_of_cells_have_frequencies_of_the_branches(cell: Cell):
    """The frequencies agree with the dense matrix of a ring of 6 cells."""
    m = np.tile(cell.masses, 6)
    k = np.tile(cell.stiffness, 6)
    inside = np.tile(
        np.zeros((len(cell.masses), 2)) if cell.resonators is None else cell.resonators, (6, 1)
    )
    n = m.size
    carried = np.flatnonzero(inside[:, 0])
    total = n + carried.size
    matrix = np.zeros((total, total))
    springs = [(i, (i + 1) % n, k[i]) for i in range(n)] + [
        (g, n + j, inside[g, 1]) for j, g in enumerate(carried)
    ]
    for a, b, spring in springs:
        matrix[[a, b], [a, b]] += spring
        matrix[[a, b], [b, a]] -= spring
    matrix[range(n), range(n)] += np.tile(np.broadcast_to(cell.ground, len(cell.masses)), 6)
    root = np.sqrt(np.append(m, inside[carried, 0]))
    exact = np.linalg.eigvalsh(matrix / np.outer(root, root))
    found = np.sort(branches(cell, 2 * np.pi * np.arange(6) / 6).frequency.ravel())
    assert found**2 == pytest.approx(exact, rel=1e-10, abs=1e-13)


@each
def test_group_velocity_by_differences(cell: Cell):
    q = np.array([-2.5, -1.0, 0.3, 1.7, 2.9])
    step = 1e-5
    found = branches(cell, q)
    slope = (branches(cell, q + step).frequency - branches(cell, q - step).frequency) / (2 * step)
    assert found.group_velocity == pytest.approx(slope, abs=1e-8)


@each
def test_density_of_states(cell: Cell):
    """Each branch contributes 1 / (pi |v|); the integral counts the modes below a frequency."""
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
        count += (
            (high - low)
            / 2
            * (found.density_of_states((low + high) / 2 + (high - low) / 2 * x) @ weight)
        )
    assert count == pytest.approx(found.frequency.shape[0] * 2.6 / np.pi, rel=1e-6)


@each
def test_edges_agree_with_a_fine_scan(cell: Cell):
    fine = branches(cell, np.linspace(0, np.pi, 801)).frequency
    between = np.column_stack((fine[:-1].max(1), fine[1:].min(1)))
    assert gaps(cell) == pytest.approx(between[between[:, 1] - between[:, 0] > 1e-6], rel=1e-9)


def test_a_local_resonator_opens_a_gap():
    """The gap begins below the resonator frequency sqrt(k/m) and ends at q = 0, m_eff = 0."""
    ((low, high),) = gaps(Cell([1.0], [1.0], [[0.4, 0.2]]))
    assert low < np.sqrt(0.5) < high
    assert high == pytest.approx(np.sqrt(0.2 / 0.4 * (1 + 0.4)), rel=1e-13)
    assert low**2 * (1 + 0.4 / (1 - low**2 / 0.5)) == pytest.approx(4, rel=1e-12)


def test_a_chain_as_a_cell():
    """The cell is closed by a contact of the last grain with the first, given or Hertzian."""
    kinds = {
        "material": ["steel", "ptfe", "glass"],
        "diameter": [1e-3, 2e-3, 1.5e-3],
        "gravity": 0.0,
        "top_load": 3.0,
    }
    cell = Cell.of(Chain(grains=3, **kinds))
    twice = Chain(grains=6, **{k: v * 2 if isinstance(v, list) else v for k, v in kinds.items()})
    assert cell.stiffness == pytest.approx(twice.linear_stiffness[:3], rel=1e-12)
    given = Cell.of(Chain(grains=3, **kinds, contact_constants=2 * twice.contact_constants[:2]))
    assert given.stiffness == pytest.approx(cell.stiffness * 2 ** (2 / 3), rel=1e-12)
    # Bonds need no load.
    bonded = Chain(grains=3, **kinds | {"top_load": 0.0}, law=Law("k*o", k=[1e6, 2e6]))
    assert Cell.of(bonded).stiffness.tolist() == [1e6, 2e6, 2e6]
    # A law with its own constant and parameters applies those of the last contact.
    for grains, k, c in ((3, 1e6, 0.0), (3, [1e6, 2e6], [0.0, 0.5]), (1, 1e6, 0.5)):
        alike = {} if grains == 3 else {"material": "steel", "diameter": 1e-3, "bottom": "wall"}
        chain = Chain(grains=grains, law=Law("k*o*(1 + c)", k=k, c=c), **kinds | alike)
        last = np.ravel(k)[-1] * (1 + np.ravel(c)[-1])
        expected = [*np.resize(k, 2) * (1 + np.resize(c, 2)), last][3 - grains :]
        assert Cell.of(chain).stiffness == pytest.approx(expected, rel=1e-14)


@pytest.mark.parametrize("exponent", [1.5, 2.5])
def test_a_chain_of_one_grain_as_a_cell(exponent: float):
    one, two = (Chain(grains=n, bottom="wall", exponent=exponent, **LOADED) for n in (1, 2))
    cell = Cell.of(one)
    assert cell.masses.tolist() == one.masses.tolist()
    assert cell.stiffness == pytest.approx(two.linear_stiffness, rel=1e-13)


def test_parameters_of_contacts_and_a_ground_may_repeat() -> None:
    """Factors c of the stiffness, or springs of the ground, make a uniform chain diatomic."""
    fields = {"grains": 12, "diameter": 1e-3, "gravity": 0.0, "top_load": 1.0}
    mass = Chain(**fields).masses[0]
    k = np.array([1e6, 2e6])
    given = Chain(**fields, law=Law("k*o*c", c=np.resize([1.0, 2.0], 11), k=1e6))
    edges = np.sqrt([0.0, 2 * k[0] / mass, 2 * k[1] / mass, 2 * k.sum() / mass])
    held = Chain(**fields, law=Law("k*o", k=1e6), ground=Law("s*u", s=np.resize([1e5, 3e5], 12)))
    mean = (2e5 + 2e6) / mass
    apart = np.sqrt(1e5**2 + 2e6**2) / mass
    on_ground = np.sqrt([mean - apart, 2.1e6 / mass, 2.3e6 / mass, mean + apart])
    for chain, expected in ((given, edges), (held, on_ground)):
        assert repeating(chain) == 2
        assert local_bands(chain)[5].ravel() == pytest.approx(expected, rel=1e-12, abs=1e-3)
    assert repeating(given.replace(law=Law("k*o*c", c=np.arange(11.0) + 1, k=1e6))) == 1


def period_of(masses, constants, first: int, last: int, most: int) -> int:
    """Return the period by comparing one grain after the other."""
    grains = range(first, last + 1)
    for period in range(1, most + 1):
        same = all(masses[n - 1] == masses[n - 1 + period] for n in grains if n + period <= last)
        same &= all(
            constants[n - 1] == constants[n - 1 + period] for n in grains if n + period < last
        )
        if same and 2 * period <= len(grains):
            return period
    return 1


def test_periods_of_repeating_chains(rng):
    """Random patterns with up to two faults, between random grains."""
    periods = []
    for _ in range(150):
        grains = rng.integers(4, 24)
        length = rng.integers(1, 7)
        masses = np.resize(rng.integers(1, 3, length), grains).astype(float)
        constants = np.resize(rng.integers(1, 3, length), grains - 1).astype(float)
        masses[rng.integers(grains, size=rng.integers(3))] = 3.0
        constants[rng.integers(grains - 1, size=rng.integers(2))] = 4.0
        chain = unit_chain(masses, contact_constants=constants)
        first, last = np.sort(rng.choice(np.arange(1, grains + 1), 2, replace=False)).tolist()
        most = int(rng.integers(1, 8))
        assert repeating(chain, first, last, most) == period_of(
            masses, constants, first, last, most
        )
        periods.append(repeating(chain))
        assert periods[-1] == period_of(masses, constants, 1, grains, 8)
    assert len(set(periods)) > 4


def test_tolerance_and_largest_length_of_a_period():
    for odd, period in ((0.9e-9, 1), (1.1e-9, 2)):
        assert repeating(unit_chain(np.resize([1.0, 1 + odd], 8))) == period
    for length, period in ((8, 8), (9, 1)):
        assert repeating(unit_chain(np.resize(np.arange(1.0, length + 1), 30))) == period


@pytest.mark.parametrize("cell", CELLS)
def test_long_waves_and_edges(cell: Cell):
    """Sound has the mean mass and compliance of a cell; other branches are flat at 0 and pi."""
    inside = 0.0 if cell.resonators is None else np.sum(cell.resonators, axis=0)[0]
    sound = 1 / np.sqrt((np.sum(cell.masses) + inside) * np.sum(1 / np.array(cell.stiffness)))
    velocity = branches(cell, [0.0, 1e-5, -1e-5, np.pi]).group_velocity
    assert velocity[0, :3] == pytest.approx([sound, sound, -sound], rel=1e-8)
    assert velocity[1:, 0] == pytest.approx(0, abs=1e-7)
    assert velocity[:, 3] == pytest.approx(0, abs=1e-7)


def test_density_of_states_at_edges_and_of_any_shape():
    """The density of a uniform chain is 2 / (pi sqrt(4 - w^2)), infinite at the band edge."""
    bands = branches(Cell([1.0], [1.0]), 0.3)
    w = np.array([[0.1, 1.0], [1.9, 1.99]])
    assert bands.density_of_states(w) == pytest.approx(2 / np.pi / np.sqrt(4 - w**2), rel=1e-7)
    assert bands.density_of_states(1.0).shape == ()
    assert bands.density_of_states(2.0) > 1e9
    assert bands.density_of_states([2.0001, 5.0]).tolist() == [0.0, 0.0]


def test_nothing_passes_a_resonator_at_its_frequency_or_a_ground_at_rest():
    """Both once ended in an error of the singular value decomposition."""
    carried = Cell([1.0], [1.0], [[0.5, 0.125]])
    assert branches(carried, 0.3).density_of_states([0.5]).tolist() == [0.0]
    found = waves(carried, [0.1, 0.5])
    assert found.attenuation.tolist() == [0.0, np.inf]
    close = waves(carried, 0.5 * (1 + np.array([-1e-9, 1e-9]))).attenuation
    assert (close > 15).all()
    for ground in (0.5, [0.5]):
        held = branches(Cell([1.0], [1.0], ground=ground), 0.3)
        assert held.density_of_states([0.0, 0.5]).tolist() == [0.0, 0.0]
        # w^2 = g + 4 sin(q / 2)^2, so that dw/dq = sin(q) / w.
        exact = held.frequency[0] / np.sin(0.3) / np.pi
        assert held.density_of_states(held.frequency[0]) == pytest.approx(exact, rel=1e-9)


def test_very_narrow_gaps_are_ignored():
    # Widths in 1e-9 of the highest frequency: 0.95 and 1.04.
    for odd, count in ((2.7e-9, 0), (2.95e-9, 1)):
        assert len(gaps(Cell([1.0, 1 + odd], [1.0, 1.0]))) == count


def edges_around(chain: Chain, period: int) -> np.ndarray:
    """Return frequencies at wavenumbers 0 and pi of the cells around grains, by dense matrices."""
    m = chain.masses
    k = chain.linear_stiffness
    edges = np.zeros((chain.grains, period, 2))
    for grain in range(chain.grains):
        begin = min(grain, chain.grains - 1 - period)
        cell = begin + np.arange(period)
        mass = m[cell] if period > 1 else m[[grain]]
        for at, turn in enumerate((1.0, -1.0)):
            own = cell if period > 1 else [grain]
            matrix = np.diag(chain.ground_stiffness[own])
            for i in range(period):
                after = (i + 1) % period
                sign = turn if i == period - 1 else 1.0
                matrix[i, i] += k[cell[i]]
                matrix[after, after] += k[cell[i]]
                matrix[i, after] -= sign * k[cell[i]]
                matrix[after, i] -= sign * k[cell[i]]
            square = np.linalg.eigvalsh(matrix / np.sqrt(np.outer(mass, mass)))
            edges[grain, :, at] = np.sqrt(np.maximum(square, 0))
    return np.sort(edges, axis=2)


@pytest.mark.parametrize(
    ("period", "keys"),
    [
        (1, {"material": "glass", "top_load": 2.0}),
        (1, {"diameter": np.geomspace(1e-3, 3e-3, 12)}),
        (2, {"material": ["steel", "ptfe"] * 6}),
        (3, {"material": ["steel", "glass", "ptfe"] * 4, "gravity": 0.0, "top_load": 2.0}),
        (1, {"ground": Law("s*u", s=np.linspace(1e5, 2e5, 12))}),
        (2, {"material": ["steel", "ptfe"] * 6, "ground": Law("s*u", s=1e5)}),
    ],
)
def test_bands_around_every_grain(period: int, keys):
    chain = Chain(**{"grains": 12, "diameter": 1e-3} | keys)
    bands = local_bands(chain)
    assert bands.shape == (12, period, 2)
    exact = edges_around(chain, period)
    assert bands == pytest.approx(exact, rel=1e-10, abs=1e-7 * exact.max())


def test_bands_around_a_single_grain_and_in_a_vacuum():
    one = Chain(grains=1, diameter=1e-3, bottom="wall", top="wall", top_load=1.0)
    above, below = one.contacts.stiffness
    assert local_bands(one).shape == (1, 1, 2)
    assert local_bands(one).ravel() == pytest.approx(
        [np.sqrt((above + below) / one.masses[0])] * 2, rel=1e-14
    )
    held = one.replace(ground=Law("s*u", s=1e5))
    total = above + below + 1e5
    assert local_bands(held).ravel() == pytest.approx([np.sqrt(total / one.masses[0])] * 2)
    assert not local_bands(Chain(grains=5, diameter=1e-3, gravity=0.0)).any()


def test_a_light_impurity_has_a_mode_above_the_band():
    """w / w_max = [mu (2 - mu)]^(-1/2) for a mass mu < 1 among equal springs."""
    mu = 0.5
    host = unit_chain(np.ones(81))
    chain = host.replace(masses=np.where(np.arange(81) == 40, mu, 1.0))
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
    """w^2 = K (1/m + 1/M) in the gap of a dimer; amplitudes fall by m / M per cell.

    Theocharis et al. (2010).
    """
    for first, count in (([1.0, 3.0], 1), ([3.0, 1.0], 0)):
        chain = unit_chain(np.resize(first, 80))
        found = gap_modes(chain, Cell([1.0, 3.0], [1.5, 1.5]))
        at_top = found.centre < 5
        assert at_top.sum() == count
        if count:
            assert found.frequency[at_top] == pytest.approx(np.sqrt(1.5 * 4 / 3), rel=1e-12)
            assert 1 < found.participation[at_top] < 4
    assert (np.isin(found.frequency, eigenmodes(chain).frequency)).all()


def test_modes_at_the_edges_of_bands_are_not_in_gaps():
    """Heavy grains alternate between walls, and light grains rest at the nodes of this mode."""
    masses = np.resize([3.0, 1.0], 20)
    chain = unit_chain(masses, top="wall", wall_constants=(1.0, 0.0))
    edge = np.sqrt(2 * 1.5 / 3.0)
    assert np.abs(eigenmodes(chain).frequency - edge).min() < 1e-14
    assert gap_modes(chain, Cell([1.0, 3.0], [1.5, 1.5])).frequency.size == 0


def test_a_heavy_grain_on_a_ground_has_a_mode_below_the_band():
    """Such modes were once missing, because the range below the band did not count."""
    ground, heavy = 0.8, 2.5
    masses = np.where(np.arange(81) == 40, heavy, 1.0)
    chain = unit_chain(masses, ground=Law("s*u", s=ground))
    found = gap_modes(chain, Cell([1.0], [1.5], ground=ground))
    # Amplitudes fall by the factor r from grain to grain: w^2 = g - k (1 - r)^2 / r beside the
    # impurity, and M w^2 = g + 2 k (1 - r) at the impurity.
    r = brentq(lambda r: heavy * (ground - 1.5 * (1 - r) ** 2 / r) - ground - 3 * (1 - r), 0.1, 0.9)
    assert found.frequency.tolist() == pytest.approx(
        [np.sqrt(ground - 1.5 * (1 - r) ** 2 / r)], rel=1e-9
    )
    assert found.shape[0, 41] == pytest.approx(r * found.shape[0, 40], rel=1e-9)
    assert found.centre == pytest.approx(41, abs=1e-6)


def test_picture_of_bands():
    """Branches are in Hz in the order of wavenumbers, and gaps are spans."""
    q = np.array([2.0, 0.5, 3.0])
    bands = branches(Cell([1.0, 3.0], [1e8, 1e8]), q)
    (axes,) = bands.plot().figure.axes
    for number, line in enumerate(axes.lines):
        assert line.get_label() == f"branch {number + 1}"
        assert line.get_xdata().tolist() == [0.5, 2.0, 3.0]
        assert line.get_ydata() == pytest.approx(
            bands.frequency[number, [1, 0, 2]] / (2 * np.pi), rel=1e-14
        )
    assert len(axes.lines) == 2
    (gap,) = axes.patches
    assert gap.get_linewidth() == 0
    span = gap.get_y(), gap.get_y() + gap.get_height()
    assert span == pytest.approx(np.sqrt([2e8 / 3, 2e8]) / (2 * np.pi), rel=1e-12)
    assert axes.get_xlabel() == "wavenumber (radians a cell)"
    assert axes.get_ylabel() == "frequency"
    assert axes.yaxis.get_major_formatter()(2e3) == "2 kHz"
    assert axes.get_ylim()[0] == 0
    assert [text.get_text() for text in axes.get_legend().get_texts()] == ["branch 1", "branch 2"]


def test_picture_of_gap_modes():
    chain = Chain(grains=20, **LOADED, impurity=[{"grain": 9, "diameter": 0.5e-3}])
    modes = gap_modes(chain, Chain(grains=2, **LOADED))
    (axes,) = modes.plot().figure.axes
    (line,) = axes.lines
    largest = modes.shape[0, np.abs(modes.shape[0]).argmax()]
    assert line.get_xdata().tolist() == list(range(1, modes.shape.shape[1] + 1))
    assert line.get_ydata() == pytest.approx(modes.shape[0] / abs(largest), rel=1e-14)
    hertz = modes.frequency[0] / (2 * np.pi)
    assert line.get_label() == f"{hertz / 1e3:.4g} kHz, {modes.participation[0]:.1f} grains"
    assert (axes.get_xlabel(), axes.get_ylabel()) == ("grain", "displacement over the largest")
    assert axes.get_legend() is not None


@pytest.mark.parametrize(
    ("call", "key"),
    [
        (lambda: branches(Cell([1.0, -1.0], [1.0, 1.0]), 0.1), "masses"),
        (lambda: branches(Cell([1.0, 1.0], [1.0]), 0.1), "stiffness"),
        (lambda: branches(Cell([1.0], [1.0], [[1.0]]), 0.1), "resonators"),
        (lambda: branches(Cell([1.0], [1.0], [[1.0, -1.0]]), 0.1), "resonators"),
        (lambda: branches(Cell([], []), 0.1), "masses"),
        (lambda: branches(Cell([[1.0]], [[1.0]]), 0.1), "masses"),
        (lambda: branches(Cell([0.0], [1.0]), 0.1), "masses"),
        (lambda: branches(Cell([np.inf], [1.0]), 0.1), "masses"),
        (lambda: branches(Cell([1.0], [0.0]), 0.1), "stiffness"),
        (lambda: branches(Cell([1.0], [np.inf]), 0.1), "stiffness"),
        (lambda: branches(Cell([1.0], [1.0]), np.nan), "wavenumber"),
        (lambda: branches(Cell([1.0], [1.0]), 0.1).density_of_states([np.inf]), "frequency"),
        (lambda: branches(Cell([1.0], [1.0], ground=-1.0), 0.1), "ground"),
        (lambda: branches(Cell([1.0], [1.0], ground=[1.0, 1.0]), 0.1), "ground"),
        (lambda: waves(Cell([1.0], [1.0], drag=-1.0), 0.1), "drag"),
        (lambda: waves(Cell([1.0], [1.0], viscoelastic=[1.0, 1.0]), 0.1), "viscoelastic"),
        (lambda: waves(Cell([1.0], [1.0]), [0.1, 0.0]), "frequency"),
        (
            lambda: Cell.of(Chain(grains=2, ground=Law("s*sin(t)*u", s=1.0), **LOADED)),
            "chain.ground",
        ),
        (lambda: branches(Cell([1.0], [1.0], ground=np.inf), 0.1), "ground"),
        (lambda: branches(Cell([1.0], [1.0], [[1.0, np.inf]]), 0.1), "resonators"),
        (lambda: waves(Cell([1.0], [1.0], viscoelastic=np.inf), 0.1), "viscoelastic"),
        (lambda: branches(Chain(grains=2, diameter=1e-3), 0.1), "gravity"),
        (lambda: branches(Chain(grains=2, diameter=1e-3, gravity=0.0), 0.1), "top_load"),
    ],
)
def test_refusals(call, key: str):
    with pytest.raises(InputError, match=rf"^{key}: (must (be|have) |.* in time|.* damping)"):
        call()
