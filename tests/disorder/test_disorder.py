"""Chains with random contacts: distribution of factors, averages, and the command `dyson`."""

import json
import signal
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.child_processes import COMMAND, PATIENCE, on_a_terminal
from helpers.command_output import keys
from helpers.example_chains import column
from helpers.example_scenes import scene_of, struck
from helpers.faults import fault_keys
from helpers.independent_integrators import distance

from lmpchain import (
    Chain,
    Displacement,
    Impulse,
    InputError,
    RunFailed,
    Scene,
    ToleranceNotMet,
    disorder,
    engines,
    simulate,
)
from lmpchain.cli.command_line import main
from lmpchain.disorder.averages import at_the_end, disordered, ensemble, factors, realisation
from lmpchain.util.progress import ProgressBar


def weakly_struck(
    grains: int = 30, tau: float = 8.0, samples: int = 2, speed: float = 1e-12, **recorded: Any
) -> Scene:
    """Return the paper's column with a strike on the top grain."""
    chain = column(grains)
    return struck(chain, speed, tau * chain.time_scale, samples, **recorded)


def generator(seed: int = 1) -> np.random.Generator:
    return np.random.default_rng(seed)


# --- the factors


@pytest.mark.parametrize("m", [0.7, 1, 2.5, 20, 300])
@pytest.mark.parametrize(("law", "shape"), [("dyson", lambda m: m), ("paper", lambda m: m + 1)])
def test_moments_of_the_factors(m, law, shape):
    """The mean is 1, and the variance is 1/m.

    (23) as printed 1 + 1/m and (m+1)/m^2; within 5 standard errors.
    """
    size = 400_000
    k = shape(m)
    zeta = factors(m, size, generator(), law)
    mean, variance = {"dyson": (1, 1 / m), "paper": (1 + 1 / m, (m + 1) / m**2)}[law]
    assert zeta.mean() == pytest.approx(mean, rel=0, abs=5 * np.sqrt(variance / size))
    assert zeta.var() == pytest.approx(variance, rel=5 * np.sqrt((2 + 6 / k) / size))
    assert zeta.min() > 0


@pytest.mark.parametrize("m", [2, 5, 30])
def test_mean_compliance_of_the_printed_law(m):
    """The mean of 1/zeta is 1 for every m, and its variance is 1/(m-1).

    The mean of 1 preserves the speed of long waves.
    """
    compliance = 1 / factors(m, 10**6, generator(2), "paper")
    assert compliance.mean() == pytest.approx(1, rel=0, abs=5e-3 * np.sqrt(1 / (m - 1)))
    if m > 3:  # For smaller m, the variance of the variance is infinite.
        assert compliance.var() == pytest.approx(1 / (m - 1), rel=0.02)


# --- the chains


def chains(exponent: float) -> list[Chain]:
    odd = (
        {"grain": 5, "diameter": 1.3e-3},
        {"grain": 8, "material": "steel"},
        {"grain": 9, "mass": 2e-6},
    )
    return [
        column(40, exponent=exponent),
        column(12, exponent=exponent, gravity=0, top_load=1e-3, top="wall", bottom="wall"),
        column(12, exponent=exponent, bottom="wall", bottom_material="steel", impurity=odd),
        Chain(
            grains=9,
            diameter=np.linspace(1, 2, 9) * 1e-3,
            exponent=exponent,
            contact_constants=np.full(8, 1e10),
        ),
    ]


@pytest.mark.parametrize("exponent", [1.0, 1.25, 1.5, 2.2, 3.0])
@pytest.mark.parametrize("law", ["dyson", "paper"])
def test_stiffness_is_multiplied_by_the_factors(exponent, law):
    for chain in chains(exponent):
        zeta = factors(7, chain.grains - 1, generator(), law)
        drawn = disordered(chain, 7, generator(), law)
        assert type(drawn) is Chain
        assert drawn.linear_stiffness / chain.linear_stiffness == pytest.approx(zeta, rel=1e-13)


@pytest.mark.parametrize("exponent", [1.0, 1.5, 3.0])
def test_constants_are_multiplied_by_the_factors(exponent):
    for chain in chains(exponent):
        zeta = factors(7, chain.grains - 1, generator())
        drawn = disordered(chain, 7, generator(), of="constant")
        assert drawn.contact_constants / chain.contact_constants == pytest.approx(zeta, rel=1e-15)
        assert drawn.linear_stiffness / chain.linear_stiffness == pytest.approx(
            zeta ** (1 / exponent), rel=1e-13
        )


@pytest.mark.parametrize("of", ["stiffness", "constant"])
def test_masses_and_diameters_are_unchanged_by_random_stiffness(of):
    for chain in chains(1.5):
        drawn = disordered(chain, 3, generator(), of=of)
        for name in ("masses", "diameters", "equilibrium_force"):
            assert np.array_equal(getattr(drawn, name), getattr(chain, name))
        for name in ("grains", "gravity", "top_load", "exponent", "top", "bottom", "movable"):
            assert getattr(drawn, name) == getattr(chain, name)
        beside = [0, -1]
        walls = [x.wall_constants / x.contact_constants[beside] for x in (drawn, chain)]
        assert walls[0] == pytest.approx(walls[1], rel=1e-14)


def test_a_vacuum_has_constants_but_no_stiffness():
    vacuum = column(6, gravity=0)
    with pytest.raises(InputError, match=r'^gravity: .* use of="constant"$'):
        disordered(vacuum, 2, generator())
    drawn = disordered(vacuum, 2, generator(), of="constant")
    assert drawn.contact_constants / vacuum.contact_constants == pytest.approx(
        factors(2, 5, generator()), rel=1e-15
    )


def test_contacts_too_soft_for_hertz():
    """A single chain is rejected; an average includes it with a warning."""
    scene = weakly_struck(grains=40)
    with pytest.raises(InputError, match=r"^diameter: contact .* is compressed by"):
        disordered(scene.chain, 0.05, generator())
    soft = ensemble(scene, 0.05, 20, seed=1)
    assert soft.squeezed == 20
    assert np.isfinite(soft.velocity_error).all()
    assert ensemble(scene, 20, 20, seed=1).squeezed == 0


@pytest.mark.parametrize(
    ("change", "key"),
    [({"m": m}, "m") for m in (0, -1, np.nan, np.inf, "2", True)]
    + [({"realisations": n}, "realisations") for n in (0, 2.0)]
    + [
        ({"seed": -1}, "seed"),
        ({"law": "gauss"}, "law"),
        ({"of": "colour"}, "of"),
        ({"tolerance": 0}, "tolerance"),
    ]
    + [({"engine": name}, "engine") for name in ("abacus", "lammps", "continuum")],
)
def test_options_that_are_wrong(change, key):
    options: dict[str, Any] = {"m": 2, "realisations": 3, "seed": 1} | change
    assert fault_keys(ensemble, weakly_struck(), **options) == [key]


def test_chains_are_drawn_by_a_generator():
    for change in ({"rng": 1}, {"rng": None}, {"size": -1}, {"size": 2.0}):
        options: dict[str, Any] = {"m": 2, "size": 3, "rng": generator()} | change
        assert fault_keys(factors, **options) == list(change)
    assert fault_keys(at_the_end, None, [2], 3, 1) == ["scene"]
    assert fault_keys(ensemble, None, 2, 3, 1) == fault_keys(realisation, None, 2, 1) == ["scene"]


# --- averages


@pytest.mark.parametrize(
    ("engine", "count", "options"),
    [
        ("chebyshev", 37, {}),
        ("modes", 37, {"law": "paper", "of": "constant"}),
        ("native", 18, {"of": "mass"}),
    ],
)
def test_mean_and_standard_error(engine: str, count: int, options: dict[str, Any]):
    """Batches give the same means as all chains at once, each solved separately."""
    native = engine == "native"
    scene = weakly_struck(samples=5, **({"grains": 20, "tau": 6.0} if native else {}))
    found = ensemble(scene, 2, count, seed=5, engine=engine, **options)
    alone = [simulate(realisation(scene, 2, 5, i, **options), engine) for i in range(count)]
    tolerance = 3e-6 if native else 1e-12
    for name in ("displacement", "velocity"):
        each = np.array([getattr(t, name) for t in alone])
        slack = tolerance * np.abs(each).max()
        assert getattr(found, name) == pytest.approx(each.mean(0), rel=0, abs=slack)
        error = each.std(0, ddof=1) / np.sqrt(count)
        assert getattr(found, f"{name}_error") == pytest.approx(error, rel=0, abs=slack)
    assert found.model_error == max(t.error_estimate.model for t in alone)
    assert 0 < found.solver_error <= 1e-6
    assert (found.realisations, found.engine, found.equation) == (count, engine, 1 if native else 3)
    drawn = {"law": "dyson", "of": "stiffness"} | options
    assert (found.m, found.seed, found.law, found.of) == (2, 5, drawn["law"], drawn["of"])
    assert np.array_equal(found.time, scene.time)
    assert np.array_equal(found.grains, scene.recorded)


# Largest mean velocity over 400 chains with kappa_n = n^(1/3) zeta_n of 60 grains at tau = 15, by
# another code with other random numbers.
PUBLISHED = {1: 0.0995, 5: 0.234, 100: 0.356}


@pytest.mark.slow
def test_largest_mean_velocity():
    """Disorder lowers the true averages, and each average is within 3 standard errors."""
    scene = weakly_struck(grains=60, tau=15.0)
    ordered = simulate(scene, "modes").velocity[-1] / 1e-12
    assert ordered.max() == pytest.approx(0.364, abs=5e-4)
    largest = []
    for m, value in PUBLISHED.items():
        found = ensemble(scene, m, 400, seed=1, engine="modes")
        at = found.velocity[-1].argmax()
        largest.append(found.velocity[-1, at] / 1e-12)
        error = found.velocity_error[-1, at] / 1e-12
        assert abs(largest[-1] - value) < 3 * np.sqrt(2) * error + 5e-4
        assert found.model_error < 1e-7
    assert np.all(np.diff([*largest, ordered.max()]) > 0)


@pytest.mark.parametrize("law", ["dyson", "paper"])
def test_order_is_the_limit_of_large_m(law):
    """The mean deviates by some 1/m, a single chain by some 1/sqrt(m)."""
    scene = weakly_struck()
    ordered = simulate(scene, "chebyshev").velocity[-1]
    size = np.abs(ordered).max()
    for m in (1e6, 1e10):
        found = ensemble(scene, m, 30, seed=1, law=law)
        spread = found.velocity_error[-1] * np.sqrt(30) / size
        assert 0.1 / np.sqrt(m) < spread.max() < 10 / np.sqrt(m)
        assert (
            np.abs(found.velocity[-1] - ordered).max()
            < 5 * found.velocity_error[-1].max() + 30 / m * size
        )


def test_weak_strikes_are_linear_and_strong_ones_are_not():
    """The same chains are solved by Eq. (3) and by Eq. (1)."""
    weak = weakly_struck(grains=20, tau=6.0, speed=1e-12)
    strong = weakly_struck(grains=20, tau=6.0, speed=2e-5)
    linear, full = (ensemble(weak, 5, 20, seed=1, engine=name) for name in ("chebyshev", "native"))
    off = distance(full, linear)
    assert off < linear.model_error + 3e-6
    assert full.model_error == 0
    linear, full = (
        ensemble(strong, 5, 20, seed=1, engine=name) for name in ("chebyshev", "native")
    )
    off = distance(linear, full)
    assert 1e-3 < off < 3 * linear.model_error


MADE = {
    "native": lambda scene: engines.Native(step=scene.duration / 400),
    "chebyshev": lambda _: engines.Chebyshev(),
    "modes": lambda _: engines.Modes(),
}


@pytest.mark.parametrize("engine", MADE)
def test_a_batch_is_its_chains(engine, monkeypatch):
    """The bits are equal for single chains and batches of any size."""
    scene = weakly_struck(samples=4)
    made = MADE[engine](scene)
    scenes = [realisation(scene, 3, 11, i) for i in range(5)]
    alone = [simulate(each, made, 0.9) for each in scenes]
    run = made.start(scenes, made.propose(scenes[0], 1e-6))
    blocks = list(run.blocks())
    for name in ("displacement", "velocity"):
        together = np.concatenate([getattr(block, name) for block in blocks], axis=1)
        assert all(
            np.array_equal(a, getattr(b, name)) for a, b in zip(together, alone, strict=True)
        )
    one = ensemble(scene, 3, 1, seed=11, engine=made)
    assert np.array_equal(one.velocity, alone[0].velocity)
    assert np.array_equal(one.displacement, alone[0].displacement)
    assert np.isnan(one.velocity_error).all()
    whole = ensemble(scene, 3, 21, seed=11, engine=made)
    monkeypatch.setattr("lmpchain.disorder.averages.BATCH", 4)
    assert_same(whole, ensemble(scene, 3, 21, seed=11, engine=made))


def assert_same(one: disorder.Ensemble, other: disorder.Ensemble) -> None:
    for name in ("displacement", "velocity", "displacement_error", "velocity_error"):
        assert getattr(one, name).tobytes() == getattr(other, name).tobytes()


def test_seeds(monkeypatch: pytest.MonkeyPatch):
    scene = weakly_struck()
    first = ensemble(scene, 2, 10, seed=4)
    reached: list[float] = []
    monkeypatch.setattr(ProgressBar, "reach", lambda _, done: reached.append(done))
    ensemble(scene, 2, 20, seed=4)
    assert reached == sorted(reached)
    assert {16, 20} <= set(reached)  # A batch has 16 chains.
    assert_same(first, ensemble(scene, 2, 10, seed=4, progress=True))
    assert not np.array_equal(first.velocity, ensemble(scene, 2, 10, seed=5).velocity)
    more = ensemble(scene, 2, 11, seed=4)  # The same ten chains, and one more.
    last = simulate(realisation(scene, 2, 4, 10), "chebyshev").velocity
    assert more.velocity == pytest.approx(
        (10 * first.velocity + last) / 11, rel=0, abs=1e-15 * np.abs(last).max()
    )
    drawn = [tuple(realisation(scene, 2, 4, i).chain.contact_constants) for i in range(200)]
    assert len(set(drawn)) == 200


def test_failing_ensembles_state_the_reason():
    scene = weakly_struck(grains=10, tau=20.0, speed=1.0)
    with pytest.raises(RunFailed, match="shorter step"):
        ensemble(scene, 5, 2, seed=1, engine=engines.Native(integrator="verlet", step=2e-6))
    with pytest.raises(ToleranceNotMet, match=r"^in chains 1 to 5 "):
        ensemble(weakly_struck(), 5, 5, seed=1, tolerance=1e-17)
    with pytest.raises(
        InputError,
        match=r"^engine: must be one of native, modes, chebyshev for random chains \(got 'bes",
    ):
        ensemble(weakly_struck(), 5, 5, seed=1, engine="bessel")
    drawn = Displacement(displacement=1e-12)
    loose = scene_of(column(5, top="wall"), drawn, 1e-5)
    with pytest.raises(InputError, match=r"^top: a wall that only touches"):
        ensemble(loose, 5, 2, seed=1)


def test_an_interruption_releases_all_resources(monkeypatch):
    closed = []
    engine = engines.Chebyshev()
    begin = engine.start

    def start(*arguments):
        run = begin(*arguments)
        monkeypatch.setattr(run, "errors", lambda: (_ for _ in ()).throw(KeyboardInterrupt))
        monkeypatch.setattr(run, "close", lambda: closed.append(True))
        return run

    monkeypatch.setattr(engine, "start", start)
    with pytest.raises(KeyboardInterrupt):
        ensemble(weakly_struck(), 2, 5, seed=1, engine=engine)
    assert closed == [True]


def test_picture_of_a_mean():
    found = ensemble(weakly_struck(), 2, 10, seed=1)
    for sample in (-1, 0, 1):
        (axes,) = found.plot(sample=sample).figure.axes
        (line,) = axes.lines
        assert np.array_equal(line.get_xdata(), found.grains)
        assert np.array_equal(line.get_ydata(), found.velocity[sample])
        assert line.get_label() == "m = 2: mean of 10 chains"
        (band,) = axes.collections
        assert band.get_label() == "± 2 st. errors"
        (path,) = band.get_paths()
        at_top = path.vertices[path.vertices[:, 0] == 1, 1]
        error = found.velocity_error[sample, 0]
        assert np.ptp(at_top) == pytest.approx(4 * error, rel=1e-9)
        assert axes.get_title("left") == (
            "t = 0 s" if sample == 0 else f"t = {1e6 * found.time[sample]:.4g} µs"
        )
        assert len(axes.get_legend().get_texts()) == 2
    assert (axes.get_xlabel(), axes.get_ylabel()) == (
        "grain number, from the top",
        "mean velocity, downward",
    )
    assert axes.yaxis.get_major_formatter()(2e-6) == "2 µm/s"
    for count, bands in ((1, 0), (2, 1)):
        assert len(ensemble(weakly_struck(), 2, count, seed=1).plot().collections) == bands
    # Grains are drawn along the chain, in whatever order they are recorded.
    mixed = ensemble(weakly_struck().replace(grains=[7, 2, 5]), 2, 2, seed=1)
    (line,) = mixed.plot().lines
    assert line.get_xdata().tolist() == [2, 5, 7]
    assert line.get_ydata().tolist() == mixed.velocity[-1, [1, 2, 0]].tolist()
    for sample in (mixed.time.size, -1 - mixed.time.size, 1.5):
        with pytest.raises(InputError, match=r"^sample: must be a whole number from -"):
            mixed.plot(sample=sample)  # type: ignore[arg-type]


def test_averages_at_the_end():
    """The ordered chain and averages of all grains, at the start and at the end."""
    scene = weakly_struck(samples=7, grains=12)
    ordered, averages = at_the_end(scene.replace(grains=[3]), [2, 5], 4, seed=3)
    end = weakly_struck(samples=2, grains=12)
    assert np.array_equal(ordered, simulate(end, "chebyshev").velocity[-1])
    for m, found in zip((2, 5), averages, strict=True):
        assert_same(found, ensemble(end, m, 4, seed=3))
        assert found.m == m
    for count, seed, key in ((1, 3, "realisations"), (2, -1, "seed")):
        with pytest.raises(InputError, match=f"^{key}: must be a whole number from"):
            at_the_end(scene, [2], count, seed)
    assert len(at_the_end(scene, [2], 2, 0)[1]) == 1


def test_materials_of_grains_whose_modulus_is_drawn():
    """Density and Poisson's ratio are unchanged; Young's modulus is multiplied by the factors."""
    chain = column(6, material=["steel", "glass", "ptfe"] * 2)
    zeta = factors(9, 6, generator())
    drawn = disordered(chain, 9, generator(), of="youngs_modulus")
    for before, after, factor in zip(chain.material, drawn.material, zeta, strict=True):
        assert after.youngs_modulus == pytest.approx(before.youngs_modulus * factor, rel=1e-14)
        assert (after.density, after.poissons_ratio) == (before.density, before.poissons_ratio)
    with pytest.raises(
        InputError,
        match=r"^contact_constants: contact constants are given .* from diameter: use",
    ):
        disordered(
            column(3, contact_constants=[1e9, 1e9]),
            9,
            generator(),
            of="diameter",
        )


# --- Eq. (22) and the command

# Sums over 60 grains at tau = 15, from another code.
SUMS = {
    1: 0.1523,
    3: 0.0258,
    5: -0.0241,
    100: -0.0380,
    1e4: -0.3604,
}


@pytest.fixture
def saved(tmp_path: Path) -> Path:
    path = tmp_path / "run.nc"
    simulate(weakly_struck(grains=60, tau=15.0, samples=4), "modes").save(path)
    return path


def test_dyson(saved: Path, capsys: pytest.CaptureFixture[str]):
    numbers = saved.with_suffix(".json")
    picture = saved.with_suffix(".png")
    orders = ",".join(f"{m:g}" for m in SUMS)
    options = ["--m", orders, "--realisations", "12", "--json", str(numbers), "-o", str(picture)]
    assert main(["dyson", str(saved), *options]) == 0
    said = capsys.readouterr()
    assert said.err == ""
    assert "no average over disorder" in " ".join(said.out.split())
    assert "tau = 15" in said.out
    data = json.loads(numbers.read_text())
    assert [row["m"] for row in data["rows"]] == list(SUMS)
    assert [row["as_printed"] for row in data["rows"]] == pytest.approx(
        list(SUMS.values()), abs=5e-5
    )
    assert data["rows"][0]["weights"] == pytest.approx(9.78, abs=5e-3)
    assert data["rows"][-1]["normalised"] == pytest.approx(-0.009035, abs=5e-7)
    assert data["velocity_unit_m_per_s"] == 1e-12
    assert max(data["ordered_velocity"]) == pytest.approx(0.364, abs=5e-4)
    for row in data["rows"]:
        assert len(row["as_printed_over_time"]) == len(data["time_s"]) == 4
        assert f"{row['as_printed']:.5g}" in said.out
        found = ensemble(weakly_struck(grains=60, tau=15.0), row["m"], 12, seed=1)
        mean = row["random_chains"]
        assert mean["mean_velocity"] == pytest.approx(found.velocity[-1] / 1e-12, rel=0, abs=1e-12)
        assert mean["mean_velocity"][mean["grain"] - 1] == mean["largest"]
        assert mean["standard_errors"][mean["grain"] - 1] == mean["standard_error"]
    assert picture.read_bytes().startswith(b"\x89PNG")


def test_dyson_with_invalid_options(saved: Path, capsys: pytest.CaptureFixture[str]):
    for options, key in (
        (["--m=0"], "m"),
        (["--m="], "m"),
        (["--m", "1", "--realisations", "1"], "realisations"),
        (["--m", "1", "--realisations", "many"], "--realisations"),
        (["--m", "1", "--seed=-1"], "seed"),
        ([], "arguments"),
        (["--m", "1", "--scene", "none.toml"], "scene"),
    ):
        assert main(["dyson", str(saved), *options]) == 2
        assert keys(capsys.readouterr()) == [key]


def test_unsuitable_runs_for_dyson_are_rejected(saved: Path, capsys: pytest.CaptureFixture[str]):
    chain = column(12)
    strike = Impulse(velocity=1e-9)
    some = scene_of(chain, strike, 1e-5, 3, grains=[1, 5])
    simulate(some, "modes").save(saved)
    assert main(["dyson", str(saved), "--m", "1"]) == 2
    assert keys(capsys.readouterr()) == ["grains"]
    vacuum = scene_of(column(5, gravity=0), strike, 1e-5, 3)
    simulate(vacuum, "native").save(saved)
    assert main(["dyson", str(saved), "--m", "1"]) == 2
    assert keys(capsys.readouterr()) == ["gravity"]
    none = str(saved.with_name("none.nc"))
    folder = str(saved.parent)
    assert main(["dyson", none, "--m", "1,x", "--json", folder, "-o", "p.txt"]) == 2
    assert set(keys(capsys.readouterr())) == {none, "m", folder, "p.txt"}


@pytest.mark.slow
def test_dyson_stops_at_ctrl_c(saved: Path):
    command = [*COMMAND, "dyson", saved, "--m", "1", "--realisations", "1000000"]
    with on_a_terminal(*command) as (process, read_until):
        read_until(" of 1000000 chains")
        process.send_signal(signal.SIGINT)
        assert process.wait(PATIENCE) == 130
