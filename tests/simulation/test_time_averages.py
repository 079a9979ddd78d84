"""Time averages against ensembles in closed form, and refusals."""

import dataclasses
import math
import warnings

import numpy as np
import pytest
from scipy.stats import t

import lmpchain
from lmpchain import Chain, Displacement, Drive, Impulse, InputError, Law, Profile, Scene, averages
from lmpchain.engines.cost_model import TooLong, budget
from lmpchain.simulation import time_averages
from lmpchain.simulation.observables import observable
from lmpchain.simulation.time_averages import Averages


def vacuum(grains: int, exponent: float = 1.5, **others) -> Chain:
    """Return steel beads of 6 mm that touch each other and two walls."""
    ends = {"top": "wall", "bottom": "wall"}
    size = {"grains": grains, "material": "steel", "diameter": 6e-3}
    return Chain(**size, gravity=0, exponent=exponent, **ends, **others)


def warm(chain: Chain, seed: int = 1) -> Scene:
    """Return a scene with a total velocity of 1 m/s, distributed at random."""
    speeds = np.random.default_rng(seed).normal(size=chain.grains)
    speeds[chain.movable :] = 0.0
    still = np.zeros(chain.grains)
    start = Profile(displacement=still, velocity=speeds / np.linalg.norm(speeds))
    return Scene(chain=chain, excitation=start, duration=0.1)


def beta(grains: int, exponent: float) -> tuple[float, float]:
    """Return the mean and variance of K / E in the microcanonical ensemble.

    The volume of phase space below an energy is that of a product: momenta give E^(N/2), and
    displacements, of whose potential a factor s on all makes s^(delta+1), give E^(N/(delta+1)).
    Hence K / E follows Beta's distribution with these two exponents.
    """
    a = grains / 2
    b = grains / (exponent + 1)
    return a / (a + b), a * b / ((a + b) ** 2 * (a + b + 1))


@pytest.mark.parametrize(("grains", "exponent"), [(38, 1.5), (30, 2.5)])
def test_kinetic_energy_of_beads_between_walls_is_microcanonical(grains: int, exponent: float):
    """The mean is exact for any motion (virial theorem), the variance only in equilibrium."""
    scene = warm(vacuum(grains, exponent))
    mean, variance = beta(grains, exponent)
    found = averages(scene, ["kinetic_energy"], time=0.3, tolerance=1e-3)
    assert found.mean["kinetic_energy"] / scene.energy == pytest.approx(mean, rel=1e-3)
    assert found.variance["kinetic_energy"] / scene.energy**2 == pytest.approx(variance, rel=0.03)
    low, high = found.variance_interval["kinetic_energy"]
    # One interval in twenty does not cover the truth, so intervals 1.5 times as wide are compared.
    assert low / 1.01 < variance * scene.energy**2 < high * 1.01
    assert found.energy_error <= 1e-3


@pytest.mark.soak
def test_variance_of_the_kinetic_energy_of_38_beads_to_a_thousandth():
    chain = vacuum(38)
    scene = Scene(chain=chain, excitation=Impulse(velocity=1.0), duration=0.1)
    mean, variance = beta(38, 1.5)
    found = averages(scene, ["kinetic_energy"], time=100.0, tolerance=6e-4, copies=2)
    assert found.mean["kinetic_energy"] / scene.energy == pytest.approx(mean, rel=1e-3)
    assert found.variance["kinetic_energy"] / scene.energy**2 == pytest.approx(variance, rel=1e-3)


@pytest.mark.soak
def test_94_to_96_percent_of_1000_intervals_of_chains_cover():
    """The quantity is the kinetic energy of one bead of 24, whose mean is 5/9 of E / 24."""
    chain = vacuum(24)
    name = "kinetic_energy:3"
    covered = 0
    for seed in range(1000):
        scene = warm(chain, seed)
        low, high = averages(scene, [name], time=0.1, tolerance=6e-4).interval[name]
        covered += low < 5 / 9 * scene.energy / 24 < high
    # The standard deviation of the coverage of a thousand intervals is 0.7 %.
    assert 0.93 <= covered / 1000 <= 0.97


def test_temperature_and_equipartition():
    scene = warm(vacuum(20))
    names = ["temperature", "kinetic_energy", "potential_energy", "equipartition", "velocity:7"]
    found = averages(scene, names, time=0.3, tolerance=1e-3)
    mean = found.mean
    assert mean["temperature"] == pytest.approx(mean["kinetic_energy"] / 10, rel=1e-12)
    whole = mean["kinetic_energy"] + mean["potential_energy"]
    assert whole == pytest.approx(scene.energy, rel=2 * found.energy_error)
    # The value is 1 if velocities of one kinetic energy are equally likely.
    assert mean["equipartition"] == pytest.approx(1.0, abs=0.05)
    # The mean velocity between walls is zero.
    low, high = found.interval["velocity:7"]
    assert low < 0 < high
    assert found.variance["velocity:7"] == pytest.approx(
        mean["temperature"] / scene.chain.masses[6], rel=0.1
    )


def test_a_linear_chain_has_the_averages_of_its_mode(monkeypatch: pytest.MonkeyPatch):
    """A single mode: half the energy is kinetic, with the variance E^2 / 8 of its cosine.

    The means of the 256 time intervals are those of its samples, whatever the blocks are.
    """
    chain = Chain(grains=12, diameter=1e-3, gravity=0, top_load=1.0, top="wall", bottom="wall")
    modes = lmpchain.theory.modes.eigenmodes(chain)
    shape = modes.shape[:, 2] / np.sqrt(chain.masses)
    start = Profile(displacement=1e-13 * shape / abs(shape).max(), velocity=np.zeros(12))
    scene = Scene(chain=chain, excitation=start, duration=1e-3)
    change = chain.linear_stiffness[2] * (start.displacement[2] - start.displacement[3])
    period = 2 * np.pi / modes.frequency[2]
    with warnings.catch_warnings():
        # A motion without chaos has infinite correlations.
        warnings.simplefilter("ignore")
        found = averages(scene, ["kinetic_energy"], time=1280.3 * period, tolerance=1e-6)
        short = []
        for numbers in (12 * 5, 2**17):
            monkeypatch.setattr(time_averages, "BLOCK_NUMBERS", numbers)
            names = ["kinetic_energy", "displacement:3", "force:3"]
            short.append(averages(scene, names, time=64.3 * period, tolerance=1e-9))
    for average in short:
        times = average.warm_up + (average.time - average.warm_up) * np.arange(1, 2049) / 2048
        phase = modes.frequency[2] * times
        assert average.warm_up == pytest.approx(0.2 * 64.3 * period, rel=0.01)
        for name, exact in (
            ("kinetic_energy", scene.energy * np.sin(phase) ** 2),
            ("displacement:3", start.displacement[2] * np.cos(phase)),
            # The force varies by a millionth of its mean.
            ("force:3", chain.contacts.force[3] + change * np.cos(phase)),
        ):
            (means,) = average.stretch_mean[name]
            atol = 1e-6 * np.abs(exact).max()
            np.testing.assert_allclose(means, exact.reshape(256, 8).mean(1), rtol=0, atol=atol)
            assert average.mean[name] == pytest.approx(exact.mean(), rel=0, abs=atol)
            error = average.correlation_time[name] * 2 / (average.time - average.warm_up)
            exact_variance = exact.var() / (1 - error) if average.batches[name] else exact.var()
            assert average.variance[name] == pytest.approx(exact_variance, rel=1e-5)
    assert found.integrator == "rkn6"
    assert found.mean["kinetic_energy"] == pytest.approx(scene.energy / 2, rel=1e-3)
    assert found.variance["kinetic_energy"] == pytest.approx(scene.energy**2 / 8, rel=2e-3)


@pytest.mark.parametrize("number", [0, 1, 4, 5])
def test_forces_agree_with_those_of_measure(rng: np.random.Generator, number: int):
    chain = Chain(grains=5, diameter=1e-3, top="wall", bottom="wall")
    displacement, velocity = 1e-9 * rng.normal(size=(2, 3, 5))
    force = observable(chain, f"force:{number}").measure(displacement, velocity)
    closer = chain.contacts.closer(displacement)[:, number]
    change = chain.contacts.of(number).force_change(closer)
    np.testing.assert_allclose(force, chain.contacts.force[number] + change, rtol=1e-9)


@pytest.mark.parametrize("number", [1, 4])
def test_quantities_of_a_grain_are_those_of_its_number(rng: np.random.Generator, number: int):
    chain = Chain(grains=5, diameter=1e-3)  # The last grain is held.
    displacement, velocity = rng.normal(size=(2, 3, 5))
    energy = chain.masses[number - 1] * velocity[:, number - 1] ** 2 / 2
    for name, expected in (
        ("displacement", displacement[:, number - 1]),
        ("velocity", velocity[:, number - 1]),
        ("kinetic_energy", energy),
    ):
        found = observable(chain, f"{name}:{number}").measure(displacement, velocity)
        np.testing.assert_allclose(found, expected, rtol=1e-14)


def test_equipartition_is_largest_if_one_grain_has_all_energy():
    chain = Chain(grains=5, diameter=1e-3)
    velocity = np.array([[0.0, 2.0, 0.0, 0.0, 0.0], [1.0, 1.0, 1.0, 1.0, 0.0], [0.0] * 5])
    found = observable(chain, "equipartition").measure(np.zeros((3, 5)), velocity)
    # Four grains move.
    np.testing.assert_allclose(found, [2.0, 0.5, 1.0], rtol=1e-14)


def test_copies_agree_with_a_single_run():
    scene = warm(vacuum(10))
    one, four = (
        averages(scene, ["force:5"], time=time, tolerance=1e-3, copies=copies)
        for time, copies in ((0.4, 1), (0.1, 4))
    )
    assert four.copies == 4
    assert four.batches["force:5"] == 4 * one.batches["force:5"]
    assert four.stretch_mean["force:5"].shape == (4, 256)
    apart = abs(one.mean["force:5"] - four.mean["force:5"])
    widths = [a.interval["force:5"][1] - a.mean["force:5"] for a in (one, four)]
    assert apart < 2 * sum(widths)


def test_copies_that_stay_together_are_rejected():
    chain = Chain(grains=5, diameter=1e-3)
    scene = Scene(chain=chain, excitation=Displacement(displacement=1e-14), duration=1e-3)
    with pytest.raises(InputError, match=r"copies: are still close to each other after 0\.0002 s"):
        averages(scene, ["kinetic_energy"], copies=2)
    # Without a warm-up nothing separates them, chaotic or not.
    for warm_up in (0.0, 1e-12):
        with pytest.raises(InputError, match=r"copies: are still close .* after 0 s"):
            averages(warm(vacuum(10)), ["kinetic_energy"], copies=2, warm_up=warm_up)
        assert averages(warm(vacuum(10)), ["velocity:3"], time=0.02, warm_up=warm_up).warm_up == 0


def test_a_short_time_has_no_interval_and_states_the_remedy():
    scene = warm(vacuum(20))
    with pytest.warns(UserWarning, match=r"too short for an interval of equipartition.*try time="):
        found = averages(scene, ["equipartition"], time=1e-4, tolerance=1e-2)
    assert found.interval["equipartition"] == (-math.inf, math.inf)
    assert found.variance_interval["equipartition"] == (0.0, math.inf)
    assert math.isnan(found.correlation_time["equipartition"])
    assert found.to_json()["quantities"]["equipartition"]["interval"] == [None, None]
    assert "unknown" in found.table()


def test_a_constant_has_no_variance():
    """All energy of a single grain is always its own."""
    alone = Scene(chain=vacuum(1), excitation=Impulse(velocity=1.0), duration=0.01)
    found = averages(alone, ["equipartition"], time=0.01, tolerance=1e-4)
    assert (found.mean["equipartition"], found.variance["equipartition"]) == (1.0, 0.0)
    assert found.variance_interval["equipartition"] == (0.0, 0.0)
    low, high = found.interval["equipartition"]
    assert (low + high, high - low) == pytest.approx((2.0, 4 * found.energy_error), rel=1e-9)


def test_an_interval_of_the_fewest_batches_is_marked():
    scene = warm(vacuum(10), 1)
    with pytest.warns(UserWarning, match=r"has only 4 independent batches; .*: try time="):
        averages(scene, ["kinetic_energy:3"], time=5e-4, tolerance=6e-4)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        averages(scene, ["kinetic_energy:3"], time=2e-2, tolerance=6e-4)


def test_the_step_depends_on_the_tolerance():
    scene = warm(vacuum(8))
    loose, tight = (
        averages(scene, ["kinetic_energy"], time=0.02, tolerance=tolerance)
        for tolerance in (1e-2, 1e-5)
    )
    assert tight.step < loose.step
    assert tight.energy_error <= 1e-5 < loose.energy_error <= 1e-2


def test_long_averages_are_announced_by_their_steps() -> None:
    chain = Chain(grains=12, diameter=1e-3, gravity=0, top_load=1.0, top="wall", bottom="wall")
    scene = Scene(chain=chain, excitation=Impulse(velocity=1e-6), duration=2e-3)
    asked: dict = {"quantities": ["velocity:3"], "tolerance": 1e-6}
    with warnings.catch_warnings():
        # A motion without chaos has infinite correlations.
        warnings.simplefilter("ignore")
        found = averages(scene, **asked)
    expected_s = []
    for copies in (1, 3):
        with budget(1e-9), pytest.raises(TooLong) as announced:
            averages(scene, **asked, copies=copies)
        steps = copies * round(found.time / found.step)
        text, _, time = str(announced.value).partition(" would take about ")
        assert text == f"the average over {steps} steps of rkn6"
        expected_s.append(float(time.removesuffix(" s")))
    assert expected_s[1] / expected_s[0] == pytest.approx(3, rel=0.1)


def test_an_unreachable_tolerance_names_the_call(monkeypatch):
    patience = time_averages.Averaging(attempts=1)
    hopeful = time_averages.EnergyErrors(wobble=1e-6, walk=0.0)
    monkeypatch.setattr(time_averages, "AVERAGING", patience)
    monkeypatch.setattr(time_averages, "ENERGY_ERRORS", hopeful)
    with pytest.raises(lmpchain.ToleranceNotMet, match=r"ask lmpchain\.averages for a larger"):
        averages(warm(vacuum(8)), ["kinetic_energy"], time=0.02, tolerance=1e-7)


def test_results_are_tables_and_pictures() -> None:
    """A result with round numbers, and an interval that is unknown."""
    names = ("force:3", "velocity:2", "equipartition")

    def named(*values: object) -> dict:
        return dict(zip(names, values, strict=True))

    unknown = (-math.inf, math.inf)
    means = np.linspace(1.0, 3.0, 512).reshape(2, 256)
    found = Averages(
        scene=SCENE,
        time=1.25,
        warm_up=0.25,
        copies=2,
        unit=named("N", "m/s", ""),
        mean=named(2.0, -0.5, 1.0),
        variance=named(4.0, 0.01, 0.0625),
        interval=named((1.875, 2.125), unknown, (0.75, 1.25)),
        variance_interval=named((3.0, 5.0), (0.0, math.inf), (0.05, 0.08)),
        correlation_time=named(1e-3, math.nan, 2e-2),
        batches=named(32, 0, 8),
        energy_error=2e-5,
        integrator="verlet",
        step=1e-6,
        middle=0.25 + (np.arange(256) + 0.5) / 256,
        stretch_mean=named(means, -means, means),
    )
    assert repr(found) == (
        "Averages(force:3 = 2 ± 0.1 N, velocity:2 = -0.5 ± unknown m/s, 1 more; over 1 s)"
    )
    assert [" ".join(line.split()) for line in found.table().splitlines()] == [
        "averages over 1 s of 2 copies, after a warm-up of 0.25 s that is left out",
        "quantity mean, 95 % variance, 95 % corr. time batches",
        "force:3 2 ± 1.2e-01 N 4 (3 to 5) N2 0.001 s 32",
        "velocity:2 -0.5 ± unknown m/s 0.01 (unknown) (m/s)2 too long 0",
        "equipartition 1 ± 2.5e-01 0.0625 (0.05 to 0.08) 0.02 s 8",
        "verlet, step 1e-06 s: intervals include the energy error of 2.0e-05",
    ]
    assert "copies" not in dataclasses.replace(found, copies=1).table()
    data = found.to_json()
    quantities = data.pop("quantities")
    assert data == {
        "time_s": 1.25,
        "warm_up_s": 0.25,
        "copies": 2,
        "integrator": "verlet",
        "step_s": 1e-6,
        "energy_error": 2e-5,
    }
    assert quantities["velocity:2"] == {
        "unit": "m/s",
        "mean": -0.5,
        "interval": [None, None],
        "variance": 0.01,
        "variance_interval": [0.0, None],
        "correlation_time_s": None,
        "batches": 0,
    }
    assert quantities["force:3"]["correlation_time_s"] == 1e-3
    frame = found.to_dataframe().set_index("quantity")
    assert list(frame.index) == list(names)
    assert list(frame.loc["force:3"]) == ["N", 2.0, 1.875, 2.125, 4.0, 3.0, 5.0, 1e-3, 32]

    axes = found.plot()
    assert axes.get_ylabel() == "force:3"
    assert axes.get_xlim() == (0.0, 1.25)
    one, other, so_far = (line.get_xydata() for line in axes.lines)
    # A point is the mean of eight stretches.
    times = 0.25 + (np.arange(32) + 0.5) / 32
    np.testing.assert_allclose(one[:, 0], times)
    for row, drawn in enumerate((one, other)):
        np.testing.assert_allclose(drawn[:, 1], means[row].reshape(32, 8).mean(1))
    np.testing.assert_allclose(so_far[[0, -1], 1], [means[:, 0].mean(), 2.0])
    band, left_out = (patch.get_bbox() for patch in axes.patches)
    assert (band.y0, band.y1) == (1.875, 2.125)
    assert (left_out.x0, left_out.x1) == (0.0, 0.25)
    assert axes.get_title("left") + axes.get_title() == "force:3: 2 N"
    # An unknown interval has no band.
    wide = dataclasses.replace(found, interval=named(unknown, unknown, unknown))
    axes = wide.plot(of="equipartition")
    assert axes.get_title("left") + axes.get_title() == "equipartition: 1"
    assert [patch.get_bbox().x1 for patch in axes.patches] == [0.25]
    with pytest.raises(InputError, match="of: must be one of"):
        found.plot(of="force:4")


def test_intervals_include_the_energy_error() -> None:
    """A mean shifts by twice the energy error times its distance from rest, as documented."""
    names = ["kinetic_energy", "velocity:3"]
    found = averages(warm(vacuum(8)), names, time=0.02, tolerance=1e-2, warm_up=0.008)
    assert found.warm_up == pytest.approx(0.008, rel=0.01)
    assert found.time == pytest.approx(0.02, rel=0.01)
    lasting = found.time - found.warm_up
    np.testing.assert_allclose(np.diff(found.middle), lasting / 256, rtol=1e-9)
    assert found.middle[0] == pytest.approx(found.warm_up + lasting / 512, rel=1e-9)
    for name in names:
        mean, variance = found.mean[name], found.variance[name]
        assert mean == pytest.approx(found.stretch_mean[name].mean(), rel=1e-12)
        half_width = found.interval[name][1] - mean
        assert mean - found.interval[name][0] == pytest.approx(half_width, rel=1e-9)
        shift = 2 * found.energy_error * max(abs(mean), math.sqrt(variance))
        assert shift > 0.02 * half_width
        # Two numbers are fitted, the mean and the effect of the energy on the stretches.
        error = (half_width - shift) / t.ppf(0.975, found.batches[name] - 2)
        time = found.correlation_time[name]
        assert 2 * variance * time == pytest.approx(lasting * error**2, rel=1e-6)
        low, high = found.variance_interval[name]
        assert low * high == pytest.approx(variance**2, rel=1e-9)
        assert math.log(high / variance) > 2 * found.energy_error


SCENE = Scene(chain=vacuum(8), excitation=Impulse(velocity=1.0), duration=0.01)
COLUMN = Chain(grains=8, diameter=1e-3)


@pytest.mark.parametrize(
    ("scene", "options", "fault"),
    [
        (SCENE, {"quantities": []}, "quantities: must be names"),
        (SCENE, {"quantities": ""}, "quantities: must be"),
        (SCENE, {"quantities": None}, "quantities: must be names"),
        (SCENE, {"quantities": ["force"]}, "quantities: must be kinetic_energy"),
        (SCENE, {"quantities": ["force:9"]}, "quantities: the contacts are numbered 0 to 8"),
        (SCENE, {"quantities": ["velocity:9"]}, "quantities: the grains that move are numbered"),
        (SCENE, {"quantities": ["velocity:0"]}, "quantities: the grains that move are numbered"),
        (SCENE, {"quantities": ["velocity:1", "velocity:1"]}, "quantities: must be names, each"),
        (SCENE, {"quantities": [3]}, "quantities: must be names"),
        (SCENE, {"time": -1.0}, "time: must be a time above 0 s"),
        (SCENE, {"warm_up": 0.02}, "warm_up: must be shorter"),
        (SCENE, {"warm_up": -1e-3}, "warm_up: must be a time above 0 s"),
        (SCENE, {"copies": 0}, "copies: must be a whole number from 1"),
        (SCENE, {"copies": True}, "copies: must be a whole number from 1"),
        (SCENE, {"tolerance": 1e-12}, "tolerance: must be at least 1e-10"),
        (SCENE, {"tolerance": 2.0}, "tolerance: must be between 0 and 1"),
        ("scene.toml", {}, "scene: must be a Scene"),
        (
            SCENE.replace(chain=SCENE.chain.replace(damping={"drag": 1.0})),
            {},
            "chain.damping: averages require a motion that never ends",
        ),
        (
            SCENE.replace(chain=SCENE.chain.replace(ground=Law("k*sin(u/L)", k=1.0, L=1e-6))),
            {},
            "chain.ground: averages support only springs to the ground",
        ),
        (
            SCENE.replace(chain=SCENE.chain.replace(bottom="free")),
            {},
            "chain.top: grains would fly away",
        ),
        (
            SCENE.replace(chain=SCENE.chain.replace(top="free")),
            {},
            "chain.top: grains would fly away",
        ),
        (
            SCENE.replace(chain=COLUMN, excitation=Drive(amplitude=1e-9, frequency=1e4)),
            {},
            "excitation: must do no work after t = 0",
        ),
        (SCENE.replace(excitation=Impulse(velocity=0.0)), {}, "excitation: moves nothing"),
    ],
)
def test_bad_input_is_one_line(scene, options: dict, fault: str):
    with pytest.raises(InputError, match=f"^{fault}"):
        averages(scene, **{"quantities": ["kinetic_energy"]} | options)


def test_a_run_at_a_given_step_beyond_predictability_warns():
    chain = Chain(grains=12, material="glass", diameter=1e-3)
    scene = Scene(chain=chain, excitation=Impulse(velocity=0.05), duration=5e-3, samples=51)
    with pytest.warns(UserWarning, match=r"whatever the step is: use averages.*lmpchain\.averages"):
        lmpchain.simulate(scene, engine="native", step=1e-7)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        lmpchain.simulate(scene.replace(duration=1e-4), engine="native", step=1e-7)
