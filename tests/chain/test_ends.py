"""Walls given by constants, chains of one grain, and a wall that mirrors a chain."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.example_chains import column
from helpers.example_scenes import scene_of, struck
from helpers.independent_integrators import distance, extended_reference
from helpers.thinned import thinned
from scipy.integrate import quad

from lmpchain import Chain, InputError, Profile, Scene, design, engines, simulate
from lmpchain.measure import fit
from lmpchain.report.document import write
from lmpchain.theory import scattering


@pytest.mark.parametrize("delta", [1.0, 1.5, 2.2])
@pytest.mark.parametrize("load", [0.0, 1e-2])
@pytest.mark.parametrize(
    "engine", ["native", pytest.param("lammps", marks=pytest.mark.slow), "modes"]
)
def test_a_wall_mirrors_the_chain(delta: float, load: float, engine: str):
    """With K_wall = 2^delta K the chain is half of a symmetric one around a squeezed contact."""
    if (engine == "lammps" and delta == 2.2) or (engine == "modes" and not load):
        return
    rng = np.random.default_rng(5)
    n = 6
    diameters = 1e-3 * rng.uniform(0.8, 1.2, 6)
    ends = {"gravity": 0.0, "exponent": delta, "top_load": load, "top": "wall"}
    double = Chain(
        grains=2 * n,
        diameter=[*diameters, *diameters[::-1]],
        bottom="wall",
        wall_constants=[3e8, 3e8],
        **ends,
    )
    across = double.contact_constants[n - 1]
    half = Chain(
        grains=n, diameter=diameters, bottom="wall", wall_constants=[3e8, 2**delta * across], **ends
    )
    speed = 1e-4 * rng.normal(size=n) * (1e-4 if engine == "modes" else 1.0)
    duration = 30e-6
    options: dict[str, Any] = {"step": duration / 600} | (
        {"diameter": "gauge"} if engine == "lammps" else {}
    )
    solver = engines.get(engine, **({} if engine == "modes" else options))

    def started(chain: Chain, velocity: Any) -> Any:
        return simulate(scene_of(chain, Profile(velocity=velocity), duration, 7), solver)

    one = started(half, speed)
    two = started(double, np.append(speed, -speed[::-1]))
    tolerance = 1e-8 if engine == "lammps" else 1e-12  # LAMMPS has the rounding errors of heights.
    assert distance(one, (two.displacement[:, :n], two.velocity[:, :n])) < tolerance
    assert (
        np.abs(two.velocity + two.velocity[:, ::-1]).max() < tolerance * np.abs(two.velocity).max()
    )


def test_wall_constants_replace_materials():
    given = {"grains": 7, "diameter": 1e-3, "top": "wall", "bottom": "wall", "top_load": 1e-3}
    usual = Chain(**given, top_material="steel", bottom_material="ptfe")
    same = Chain(**given, wall_constants=usual.wall_constants)
    assert np.array_equal(same.contacts.constant, usual.contacts.constant)
    assert np.array_equal(same.contacts.overlap, usual.contacts.overlap)
    below = same.part(3, 7)
    above = same.part(1, 4)
    assert below.wall_constants.tolist() == [0.0, usual.wall_constants[1]]
    assert above.wall_constants.tolist() == [usual.wall_constants[0], 0.0]
    for part in (below, above, same):
        assert Chain(**part.given()) == part


LONE = {
    "under gravity on a wall": {"bottom": "wall"},
    "between walls": {"gravity": 0.0, "top_load": 1e-2, "top": "wall", "bottom": "wall"},
    "below a wall that just touches": {"top": "wall", "bottom": "wall"},
    "loaded on a wall": {"gravity": 0.0, "top_load": 1e-2, "bottom": "wall"},
}


@pytest.mark.parametrize("name", LONE)
@pytest.mark.parametrize("strike", [1e-7, 3e-3])
def test_one_grain(name: str, strike: float):
    chain = column(1, **LONE[name])
    assert chain.movable == 1
    assert chain.band_edge == pytest.approx(
        np.sqrt(chain.contacts.stiffness.sum() / chain.masses[0]), rel=1e-14
    )
    scene = struck(chain, strike, 7 * chain.time_scale, 9)
    u, v, own = extended_reference(scene)
    for engine in ("native", "auto", "lammps"):
        t = simulate(scene, engine, 1e-6)
        true = distance(t, (u, v))
        assert true < 1e-6
        assert t.error_estimate.total > (true - own) / 3
    assert Scene.from_text(scene.to_text()) == scene


@pytest.mark.parametrize("end", [{"bottom": "fixed"}, {"bottom": "free", "top": "free"}])
def test_one_grain_that_is_fixed_or_has_no_contact(end: dict[str, str]):
    with pytest.raises(InputError, match="grains: a single grain must move and touch a wall"):
        column(1, gravity=0.0, **{"top": "wall"} | end)


@pytest.mark.parametrize("name", thinned(["between walls", "under gravity on a wall"], 2))
def test_what_is_measured_of_one_grain(name: str, tmp_path: Path):
    """The report of one grain works; measures that need a wave or two grains are rejected."""
    chain = column(1, **LONE[name])
    scene = struck(chain, 1e-5, 20 * chain.time_scale, 101)
    run = simulate(scene, "native", 1e-8)
    write(run, tmp_path / "report.html")
    assert isinstance(fit.summary(run).rows, tuple | list)
    refused = {
        "contact_constants: there is no contact": lambda: design.gradient(
            scene, design.PeakForce(1), ["contact_constants"]
        ),
        "grains: must be two or more": lambda: scattering.transmission(chain, 1e3),
        "grains: must be two or more: a single grain": lambda: fit.fit_bessel(run),
    }
    for message, call in refused.items():
        with pytest.raises(InputError, match=message):
            call()
    found = design.gradient(scene, design.Momentum([1]), ["wall_constants"], tolerance=1e-7)[
        "wall_constants"
    ]
    walls = np.where(found != 0, chain.wall_constants * 1e-4, 0.0)

    def momentum(sign: int) -> float:
        k = chain.wall_constants + sign * walls
        moved = scene.replace(chain=chain.replace(wall_constants=k))
        return float(chain.masses[0] * simulate(moved, "native", 1e-12).velocity[-1, 0])

    assert found @ walls == pytest.approx((momentum(1) - momentum(-1)) / 2, rel=1e-4)


def test_the_bounce_of_one_grain():
    """The contact time of a grain on a wall without gravity equals Hertz's quadrature."""
    chain = column(1, gravity=0.0, bottom="wall")
    m = float(chain.masses[0])
    k = float(chain.wall_constants[1])
    v = 1e-2
    deepest = (5 * m * v**2 / (4 * k)) ** 0.4
    share, _ = quad(lambda s: 2 * s / np.sqrt(1 - (1 - s**2) ** 2.5), 0, 1, epsabs=0, epsrel=1e-13)
    contact_time = 2 * deepest / v * share
    t = simulate(struck(chain, v, contact_time, 3), "native", 1e-9)
    assert t.displacement[1, 0] == pytest.approx(deepest, rel=1e-8)
    assert t.velocity[:, 0] == pytest.approx([v, 0.0, -v], rel=1e-8, abs=1e-8 * v)
