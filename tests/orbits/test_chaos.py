"""Lyapunov exponents and alignment indices, against matrix exponentials, SciPy and theory."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from helpers.example_scenes import stirred, struck
from scipy.integrate import solve_ivp
from scipy.linalg import expm

from lmpchain import Chain, Damping, Drive, InputError, Law, Profile, Scene, laws
from lmpchain.orbits import Chaos, chaos_of
from lmpchain.orbits import chaos as chaos_module

BEADS = {"diameter": 5e-3, "material": "steel", "gravity": 0.0, "top": "wall", "bottom": "wall"}


def start(size: int, count: int, seed: int) -> np.ndarray:
    """Return the orthonormal initial deviations of a seed."""
    random = np.random.default_rng(seed).standard_normal((size, count))
    return np.linalg.qr(random)[0]


def log_volume(deviations: np.ndarray) -> float:
    """Return the logarithm of the volume of unit deviations, by singular values."""
    unit = deviations / np.linalg.norm(deviations, axis=0)
    return float(np.log(np.linalg.svd(unit, compute_uv=False)).sum())


def test_a_linear_chain_has_the_indices_of_its_matrix() -> None:
    """All exponents are 0 within their intervals; indices agree with the exponential to 1e-8."""
    chain = Chain(grains=4, top_load=10.0, exponent=1.0, **BEADS)
    scene = struck(chain, 1e-3, 5e-3)
    found = chaos_of(scene, seed=3)
    assert not found.chaotic
    assert (np.abs(found.exponent) <= found.half_width).all()
    # A deviation that grows in proportion to time is not resolved.
    unresolved = np.log(5) / (0.8 * scene.duration)
    assert (found.half_width >= unresolved).all()
    assert (found.half_width < 2 * unresolved).all()
    root = np.sqrt(chain.masses)
    springs = chain.contacts.stiffness
    pull = np.diag(springs[:-1] + springs[1:]) - np.diag(springs[1:-1], 1)
    pull -= np.diag(springs[1:-1], -1)
    rate = scene.fastest_motion
    # The variables are q = sqrt(m) phi and p = sqrt(m) phi' / rate.
    matrix = np.zeros((8, 8))
    matrix[:4, 4:] = rate * np.eye(4)
    matrix[4:, :4] = -pull / np.outer(root, root) / rate
    deviation = expm(matrix * found.time[-1]) @ start(8, 8, 3)
    for count in range(2, 9):
        expected = log_volume(deviation[:, :count])
        assert found.log_gali[-1, count - 1] == pytest.approx(expected, abs=1e-8)
        assert found.gali(count)[-1] == pytest.approx(np.exp(expected), abs=1e-8)


def test_indices_and_growth_agree_with_variational_equations_by_scipy(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Volumes of deviations agree with an independent integration over a chaotic time."""
    # Chaos amplifies the error of the steps in which a contact opens.
    monkeypatch.setattr(chaos_module, "REACH", 0.003)
    chain = Chain(grains=3, **BEADS)
    scene = struck(chain, 0.1, 0.8e-3)
    found = chaos_of(scene, exponents=3, seed=5)
    assert found.exponent[0] * scene.duration > 1
    constants = np.array(
        [chain.wall_constants[0], *chain.contact_constants, chain.wall_constants[1]]
    )
    root = np.sqrt(chain.masses)
    rate = scene.fastest_motion

    def slope(_: float, state: np.ndarray) -> np.ndarray:
        columns = state.reshape(2, 3, 4)
        between_walls = np.zeros((5, 4))
        between_walls[1:4] = columns[0]
        closer = between_walls[:-1] - between_walls[1:]
        overlap = np.maximum(closer[:, 0], 0.0)
        root_overlap = np.sqrt(overlap)
        closer *= (1.5 * constants * root_overlap)[:, None]
        closer[:, 0] = constants * overlap * root_overlap
        pull = (closer[:-1] - closer[1:]) / chain.masses[:, None]
        return np.concatenate((columns[1].ravel(), pull.ravel()))

    units = np.concatenate((root, root / rate))[:, None]
    begin = np.zeros((6, 4))
    begin[3, 0] = 0.1
    begin[:, 1:] = start(6, 3, 5) / units
    answer = solve_ivp(slope, (0, scene.duration), begin.ravel(), "DOP853", rtol=1e-10, atol=1e-16)
    deviation = units * answer.y[:, -1].reshape(6, 4)[:, 1:]
    for count in (2, 3):
        expected = log_volume(deviation[:, :count])
        assert found.log_gali[-1, count - 1] == pytest.approx(expected, abs=2e-4)
    grown = float(np.log(np.linalg.norm(deviation[:, 0])))
    assert found.running[-1, 0] * scene.duration == pytest.approx(grown, abs=2e-4)
    assert found.energy_drift < 1e-7


@cache
def chaotic(seed: int) -> Chaos:
    """Return the exponents of one of many motions of one energy, in a sonic vacuum of 5 grains."""
    chain = Chain(grains=5, **BEADS)
    start = stirred(chain, 1.0, seed=seed)
    start = start.scaled(0.1 / np.linalg.norm(start.velocity))
    scene = Scene(chain=chain, excitation=start, duration=0.03)
    return chaos_of(scene, seed=seed)


@pytest.mark.slow
def test_intervals_cover_the_mean_of_many_motions() -> None:
    """Motions of one energy have one spectrum; 90 % or more of the intervals contain its mean."""
    motions = [chaotic(seed) for seed in range(16)]
    exponents = np.array([each.exponent for each in motions])
    half_widths = np.array([each.half_width for each in motions])
    mean = exponents.mean(0)
    assert (np.abs(exponents - mean) <= half_widths).mean() >= 0.9
    # The intervals are narrow: the largest exponent is accurate to a quarter.
    assert (half_widths[:, 0] < 0.25 * mean[0]).all()
    # By scale invariance, the time is proportional to the energy to the power -1/10.
    chain = Chain(grains=5, **BEADS)
    strong = chaos_of(struck(chain, 10.0, 0.03 * 100**-0.2))
    assert strong.exponent[0] * 100**-0.2 == pytest.approx(mean[0], rel=0.25)


def test_exponents_come_in_pairs_and_volume_is_conserved() -> None:
    """The map is symplectic: exponents are opposite in pairs, and their sum vanishes."""
    for each in (chaotic(0), chaotic(1)):
        paired = each.exponent + each.exponent[::-1]
        assert (np.abs(paired) <= each.half_width).all()
        assert abs(each.running[-1].sum()) < 1e-9 * each.exponent[0]
        # The exponents are growth rates after the first fifth of the time.
        grown = each.running[-1] * each.time[-1] - each.running[63] * each.time[63]
        assert each.exponent == pytest.approx(grown / (each.time[-1] - each.time[63]), rel=1e-9)
        assert 0 < each.energy_drift < 1e-3
        # The pair of the energy has no growth.
        assert np.abs(each.exponent[4:6]).max() < 0.1 * each.exponent[0]


def test_indices_decay_by_the_differences_of_exponents() -> None:
    """In chaos the index of k deviations decays as exp(-sum of lambda_1 - lambda_j) in time."""
    for each in (chaotic(0), chaotic(1)):
        duration = each.time[-1] - each.time[63]
        for count in (2, 3, 6):
            fall = (each.log_gali[63, count - 1] - each.log_gali[-1, count - 1]) / duration
            expected = (each.exponent[0] - each.exponent[:count]).sum()
            assert fall == pytest.approx(expected, rel=0.05)


@pytest.mark.slow
def test_indices_of_regular_motion_decay_as_powers_of_time() -> None:
    """On a torus of N dimensions the index of k > N deviations falls as t^(-2 (k - N))."""
    found = chaos_of(struck(Chain(grains=3, top_load=50.0, **BEADS), 0.2, 0.2))
    assert not found.chaotic
    assert (found.gali(2)[64:] > 0.3).all()
    late = found.time > found.time[-1] / 5
    for count in (4, 5, 6):
        logarithm = found.log_gali[late, count - 1]
        slope = np.polyfit(np.log(found.time[late]), logarithm, 1)[0]
        assert slope == pytest.approx(-2 * (count - 3), rel=0.15)


def test_laws_by_formula_have_exponents() -> None:
    """Toda's chain is integrable; the Fermi-Pasta-Ulam-Tsingou chain is not."""
    fields = {"grains": 4, "gravity": 0.0, "diameter": 1e-2, "masses": np.full(4, 1e-3)}
    ends = {"top": "wall", "bottom": "wall"}
    scene = Scene(
        chain=Chain(law=laws.toda(b=1e5, k=1e5), **fields, **ends),
        excitation=Profile(velocity=[0.2, -0.1, 0.15, -0.05]),
        duration=0.2,
    )
    toda = chaos_of(scene)
    assert not toda.chaotic
    assert (toda.gali(2) > 0.01).all()
    other = scene.chain.replace(law=laws.fput(beta=1e15, k=1e5))
    chaotic = chaos_of(scene.replace(chain=other))
    assert chaotic.chaotic
    assert chaotic.gali(2)[-1] < 1e-6
    assert max(toda.energy_drift, chaotic.energy_drift) < 1e-6


def test_pictures_tables_and_refusals() -> None:
    """Pictures have labels, tables have columns, and invalid requests are rejected by key."""
    found = chaotic(0)
    ax = found.plot()
    assert ax.get_xlabel() == "time"
    size = found.exponent.size
    curves = [line for line in ax.lines if np.size(line.get_xdata()) == found.time.size]
    for line, running in zip(curves, found.running.T, strict=True):
        assert line.get_ydata().tolist() == running.tolist()
    ends = [bar.lines[2][0].get_segments()[0] for bar in ax.containers]
    both = np.array([found.exponent - found.half_width, found.exponent + found.half_width]).T
    assert np.array(ends)[:, :, 1] == pytest.approx(both, rel=1e-12)
    assert (np.array(ends)[:, :, 0] == found.time[-1]).all()
    later = found.running[64:]
    assert ax.get_ylim() == pytest.approx((1.3 * later.min(), 1.3 * later.max()), rel=1e-12)
    assert ax.get_title("left").startswith(f"largest {found.exponent[0]:.4g} ± ")
    gali = found.plot_gali()
    assert gali.get_ylabel() == "generalised alignment index"
    assert (gali.get_xscale(), gali.get_yscale()) == ("log", "log")
    assert [line.get_label() for line in gali.lines] == [
        f"{count} deviations" for count in range(2, size + 1)
    ]
    for count, line in enumerate(gali.lines, 2):
        expected = np.exp(found.log_gali[:, count - 1])
        seen = expected > 1e-300
        assert line.get_xdata().tolist() == found.time[seen].tolist()
        assert line.get_ydata() == pytest.approx(expected[seen], rel=1e-12)
    assert {"time [s]", "exponent_1 [1/s]", "log_gali_10"} <= set(found.to_dataframe().columns)
    assert (found.gali(10)[-1:] == 0).all()
    # The largest exponent alone decides.
    for half_width, expected in (([1.0, 3.0], True), ([3.0, 1.0], False)):
        few = {"exponent": np.array([2.0, 0.0]), "half_width": np.array(half_width)}
        assert replace(found, **few).chaotic == expected
    chain = Chain(grains=4, **BEADS)
    scene = struck(chain, 0.1, 1e-3)
    assert chaos_of(scene, exponents=2).exponent.shape == (2,)
    with pytest.raises(InputError, match="exponents"):
        chaos_of(scene, exponents=1)
    with pytest.raises(InputError, match="steps"):
        chaos_of(scene.replace(duration=1e5))
    with pytest.raises(InputError, match="excitation"):
        chaos_of(scene.replace(excitation=Drive(amplitude=1e-9, frequency=1e3)))
    with pytest.raises(InputError, match="does not move the chain"):
        chaos_of(struck(chain, 0.0, 1e-3))
    with pytest.raises(InputError, match=r"^chain\.ground: an orbit or its tangent map does not"):
        chaos_of(scene.replace(chain=chain.replace(ground=Law("k*u", k=1.0))))
    with pytest.raises(InputError, match="damping"):
        chaos_of(scene.replace(chain=chain.replace(damping=Damping(drag=1.0))))
    for count in (1, 11, 2.5):
        with pytest.raises(InputError, match="count"):
            found.gali(count)
    with pytest.raises(InputError, match=r"exponents: must be 2 to 8 \(got 9\)"):
        chaos_of(scene, exponents=9)
