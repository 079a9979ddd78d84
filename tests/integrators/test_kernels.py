"""The compiled loops: accuracy of force forms, tiles, and vector instructions."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import mpmath
import numba
import numpy as np
import pytest
from helpers.example_scenes import smooth
from numba import float64, types
from numba.core.registry import cpu_target
from numpy.typing import NDArray

from lmpchain import Chain
from lmpchain.integrators.batch import ChainBatch, series, weakest
from lmpchain.integrators.kernels import contact_forces as forces
from lmpchain.integrators.kernels import sample_loop, window
from lmpchain.integrators.kernels.contact_forces import ROOTS, Form
from lmpchain.integrators.kernels.layout import ALONE, STATE, Chains, Links
from lmpchain.integrators.kernels.openings import Near, _find_nearness, _score

Array = NDArray[np.float64]
EPSILON = np.finfo(float).eps
PRESSED = [
    (Form.CORRECTED, 1.5),
    (Form.SPRING, 1.0),
    (Form.POWER, 1.25),
    (Form.POWER, 1.5),
    (Form.POWER, 2.3),
    (Form.POWER, 3.0),
]
PLAIN = [(form, form / 4) for form in ROOTS]


def spread(low: float, high: float, count: int = 400) -> Array:
    """Return logarithmically spaced numbers between two."""
    return np.exp(np.random.default_rng(1).uniform(np.log(low), np.log(high), count))


def links_of(
    inverse_length: Array, strength: Array, form: int, precompressed: float, exponent: float
) -> Links:
    """Return contacts without a touching one."""
    loops = np.array(forces.addresses(form))
    numbers = 0.0, int(form), loops, precompressed, series(exponent)
    return Links(inverse_length, strength, *numbers, np.zeros((0, strength.size)), 0)


def force(
    form: int, exponent: float, r: Array, precompressed: float = 1.0, strength: float = 1.0
) -> Array:
    """Return the forces of contacts with approaches r, from one call of a loop."""
    bodies = np.zeros(2 * r.size)
    bodies[::2] = r
    found = np.zeros(2 * r.size - 1)
    alike = np.ones(2 * r.size - 1)
    links = links_of(alike, strength * alike, form, precompressed, exponent)
    forces.LOOPS[form][0](found, bodies, links)
    return found[::2]


def exact(exponent: float, s: Array) -> list[Any]:
    """Return (1 + s)^delta - 1 to 60 digits."""
    with mpmath.workdps(60):
        return [(1 + mpmath.mpf(x)) ** mpmath.mpf(exponent) - 1 for x in s]


def relative(found: Array, true: list[Any]) -> float:
    """Return the largest relative error in ulps."""
    with mpmath.workdps(60):
        return max(float(abs(f - t) / abs(t)) for f, t in zip(found, true, strict=True)) / EPSILON


@pytest.mark.parametrize(("form", "exponent"), PRESSED)
def test_forces_are_accurate_at_any_amplitude(form: int, exponent: float):
    s = np.concatenate((spread(1e-12, 30), -spread(1e-12, 1)))
    assert relative(force(form, exponent, s), exact(exponent, s)) < 8


@pytest.mark.parametrize("exponent", [1.01, 1.25, 1.5, 2.0, 2.3, 3.0, 6.0])
def test_the_weak_form_is_accurate_for_weak_waves(exponent: float):
    s = np.concatenate((spread(1e-15, weakest(exponent)), -spread(1e-15, weakest(exponent))))
    assert weakest(exponent) > 1e-2
    assert relative(force(Form.POLYNOMIAL, exponent, s), exact(exponent, s)) < 1.5


@pytest.mark.parametrize(("form", "exponent"), PLAIN)
def test_plain_forms_lose_an_ulp_of_the_force_at_rest(form: int, exponent: float):
    s = np.concatenate((spread(1e-12, 1e5), -spread(1e-12, 1)))
    true = exact(exponent, s)
    off = [
        float(abs(f - t) / max(1, t)) for f, t in zip(force(form, exponent, s), true, strict=True)
    ]
    assert max(off) < 3 * EPSILON


@pytest.mark.parametrize(
    ("form", "exponent"),
    [
        *PLAIN,
        (Form.SPRING, 1.0),
        *((Form.UNCOMPRESSED_POWER, delta) for delta in (1.01, 1.3, 2.3, 3.0)),
    ],
)
def test_forces_in_an_uncompressed_chain(form: int, exponent: float):
    """Forces are accurate down to 1e-30 m, up to the error of an exponential's argument."""
    r = spread(1e-30, 10)
    with mpmath.workdps(60):
        true = [mpmath.mpf(x) ** mpmath.mpf(exponent) for x in r]
    lost = exponent * 70 if form == Form.UNCOMPRESSED_POWER else 0
    assert relative(force(form, exponent, r, precompressed=0.0), true) < 2 + lost


@pytest.mark.parametrize(("form", "exponent"), [*PRESSED, *PLAIN])
def test_open_contacts_and_rest_are_exact(form: int, exponent: float):
    found = force(form, exponent, np.array([-1.0, -1 - 1e-15, -1.5, -1e6, 0.0]), strength=0.7)
    assert np.array_equal(found, [-0.7, -0.7, -0.7, -0.7, 0.0])


@pytest.mark.parametrize(
    ("form", "exponent"), [*PLAIN, (Form.SPRING, 1.0), (Form.UNCOMPRESSED_POWER, 2.3)]
)
def test_contacts_without_compression_do_not_pull(form: int, exponent: float):
    assert not force(form, exponent, np.array([-1e-30, -1.0, -1e6, 0.0]), precompressed=0.0).any()


@pytest.mark.parametrize("exponent", [1.0, 1.3, 1.5, 2.5])
def test_force_is_the_derivative_of_the_energy(exponent: float):
    """The force is -dU/dx by central differences, for compressed and open contacts."""
    chain = Chain(grains=6, material="glass", diameter=1e-3, exponent=exponent)
    form = {1.0: Form.SPRING, 1.5: Form.CORRECTED}.get(exponent, Form.POWER)
    eps = chain.equilibrium_overlap
    u = np.append(0.0, np.cumsum([-0.5, 0.3, 2.0, -1.4, 0.1] * eps))
    found = np.zeros(7)
    # A copy is used, because compiled loops require writable arrays.
    at_rest = chain.equilibrium_force.copy()
    links = links_of(1 / eps, at_rest, form, 1.0, exponent)
    forces.LOOPS[form][0](found[1:-1], u, links)
    moved = 1e-5 * eps[0] * np.eye(6)
    rest = np.zeros(6)
    slope = [
        (chain.excess_energy(u + d, rest) - chain.excess_energy(u - d, rest)) / (2e-5 * eps[0])
        for d in moved
    ]
    assert -np.array(slope) == pytest.approx(found[:-1] - found[1:], rel=1e-6, abs=0)


# --- tiles and compiled instructions


@pytest.mark.parametrize(
    "path", sorted(Path(forces.__file__).parent.glob("*.py")), ids=lambda path: path.stem
)
def test_kernels_depend_only_on_their_folder(path: Path):
    """Kernels import only from their monitored folder, or uncompiled functions from `util`."""
    above = re.findall(
        r"^\s*from (\.\.\S*|lmpchain\S*) import", path.read_text(encoding="utf-8"), re.MULTILINE
    )
    assert set(above) <= {"...util.arrays", "...util.compilation"}


# Without an FMA instruction each fma is a function call, and loops with calls are not vectorised.
with_fma = pytest.mark.skipif(
    "+fma" not in cpu_target.target_context.codegen().magic_tuple()[2].split(","),
    reason="needs an x86 processor with FMA instructions, and looks for them",
)


def packed(assembly: str, operation: str) -> int:
    """Return the number of vector instructions of a kind."""
    return len(re.findall(rf"\n\s+(?:{operation}pd\s|v{operation}\w*pd\s.*[yz]mm)", assembly))


# Inlined functions have no assembly of their own.
alone = numba.njit(error_model="numpy", fastmath=forces.STRICT, _nrt=False)


@with_fma
@pytest.mark.parametrize(
    ("form", "operation"),
    [
        (Form.CORRECTED, "sqrt"),
        pytest.param(6, "sqrt", marks=pytest.mark.slow),
        pytest.param(Form.POLYNOMIAL, "fmadd", marks=pytest.mark.slow),
        pytest.param(Form.POWER, "div", marks=pytest.mark.slow),
        pytest.param(Form.UNCOMPRESSED_POWER, "div", marks=pytest.mark.slow),
    ],
)
def test_loops_over_grains_are_vectorised(form: int, operation: str):
    _, kept, _ = forces.LOOPS[form]
    # The assembly of cached code is not available, so the loop is compiled again.
    loop = alone(kept.py_func)
    loop.compile(forces.SWEEP)
    assert packed(next(iter(loop.inspect_asm().values())), operation) > 0


@alone
def watch_first(chains):
    window.watch(sample_loop.chain_of(chains, 0, 0))


@pytest.mark.slow
@with_fma
def test_other_loops_are_vectorised():
    row = types.Array(float64, 1, "C")
    batch = ChainBatch([smooth()])
    bodies, *_ = batch.place(*(field[None] for field in batch.initial))
    chains = Chains(batch.arrays, bodies, bodies, bodies[:, None], np.zeros(1, STATE), ALONE)
    alike = np.ones(2)
    near = numba.typeof(Near(alike, alike, alike, 1.0, False, 1.0, 1.0, 1.0))
    for loop, takes, operation in (
        (alone(_find_nearness.py_func), (row, row, row, near), "sqrt"),
        (watch_first, (numba.typeof(chains),), "mul"),
    ):
        loop.compile(takes)
        assert packed(loop.inspect_asm(takes), operation) > 0
    loop = alone(forces.LOOPS[Form.CORRECTED][0].py_func)
    loop.compile(forces.FORCES)
    assert packed(next(iter(loop.inspect_asm().values())), "sqrt") > 0


def test_no_contact_that_shortens_a_step_is_missed():
    rng = np.random.default_rng(3)
    size = 100
    find = numba.njit(error_model="numpy", fastmath=forces.STRICT)(_find_nearness.py_func)
    shortened = 0.2
    close = shortened ** (-14 / 3)
    passed = 0
    shortens = 0
    for trial in range(2000):
        y, rates, bends = 10 ** rng.uniform(-3, 3, (3, 1)) * rng.normal(size=(3, size + 1))
        omega = 10 ** rng.uniform(-3, 3)
        weight = 10 ** rng.uniform(-30, 10, size)
        reach = np.cbrt(weight) / (2**0.5 * (2 * omega) ** 3)
        length = 10 ** rng.uniform(-2, 2, size)
        pressed = float(rng.integers(2))
        near = Near(length, weight, np.full(size, np.inf), pressed, False, close, omega, 1e6)
        every = find(y, rates, bends, near)
        found = find(y, rates, bends, near._replace(reach=reach))
        assert found == every or every < shortened**14
        if trial < 20:
            closing = -np.diff([y, rates, bends])
            strains = closing * length + [[pressed], [0.0], [0.0]]
            given = *strains, weight, np.full(size, omega), np.full(size, 1e6)
            scores = [_score.py_func(*row) for row in np.transpose(given).tolist()]
            assert every == pytest.approx(max(scores), rel=1e-13)
            # The overlap of a wall that only touches is the displacement itself.
            wall = _score.py_func(*closing[:, 0].tolist(), float(weight[0]), omega, 1e6)
            touched = find(y, rates, bends, near._replace(touching=True))
            assert touched == pytest.approx(max(every, wall), rel=1e-13)
        passed = passed + (found < every)
        shortens = shortens + (every > shortened**14)
    assert passed > 100
    assert shortens > 100
