"""Contact forces, quadrature and objectives, against closed forms and plain NumPy."""

from typing import Any

import numpy as np
import pytest
from helpers.example_scenes import scene_of

from lmpchain import Chain, Drive, Impulse, InputError, Profile, Scene, simulate
from lmpchain.design import (
    ArrivalTime,
    DriveWork,
    Energy,
    Function,
    KineticEnergy,
    Misfit,
    Momentum,
    PeakForce,
    Seen,
    gradient,
)
from lmpchain.design.gradients import at_step, looks_of
from lmpchain.design.objectives import contact_force, quadrature
from lmpchain.engines import Native
from lmpchain.integrators.methods import SPLITTINGS

METHOD = SPLITTINGS["kahan-li8"]
ONE = Chain(grains=2, diameter=1e-3)  # One grain moves, under its weight.
WEAK = 1e-13  # Strike velocity, m/s, for which the motion is linear to 1e-8.


def swinging(turns: float, samples: int) -> Scene:
    """Return a scene of an oscillator, v = WEAK cos(w t), over a number of periods."""
    omega = float(np.sqrt(ONE.linear_stiffness[0] / ONE.masses[0]))
    duration = 2 * np.pi * turns / omega
    return Scene(chain=ONE, excitation=Impulse(velocity=WEAK), duration=duration, samples=samples)


def value(scene: Scene, objective: Any, step: float = 2e-8) -> float:
    return at_step(scene, objective, ["masses"], METHOD, step)[0]


@pytest.mark.parametrize("size", range(2, 14))
def test_sums_with_corrected_ends_integrate_polynomials(size: int):
    """With k corrections at each end the degree is at least 2k + 1; up to 5 corrections fit."""
    corrections = min(5, (size - 1) // 2)
    x = np.arange(size) / (size - 1)
    weight = quadrature(size) / (size - 1)
    np.testing.assert_allclose(weight, weight[::-1], rtol=1e-14)
    for degree in range(2 * (corrections // 2) + 2):
        assert weight @ x**degree == pytest.approx(1 / (degree + 1), rel=1e-13)


@pytest.mark.parametrize(("contact", "viscosity"), [(0, 0.0), (2, 0.0), (2, 3e-7), (4, 3e-7)])
def test_the_force_of_a_contact_and_its_derivatives_are_those_of_hertz(
    rng: np.random.Generator, contact: int, viscosity: float
):
    """The derivatives of closed and open contacts agree with differences.

    They are by overlap, rate, force at rest, constant and viscosity.
    """
    chain = Chain(
        grains=4,
        diameter=1e-3,
        top="wall",
        bottom="wall",
        top_load=0.02,
        exponent=1.7,
        damping={"viscoelastic": viscosity},
    )
    scene = Scene(chain=chain, excitation=Impulse(velocity=1e-3), duration=1e-5, samples=6)
    eps = chain.contacts.overlap.max()
    grains = np.array([1, 2, 3, 4])
    u = 0.4 * eps * rng.normal(size=(6, 4))
    u[5] = eps * np.array([9.0, 6.0, 9.0, -9.0])  # Open.
    v = 1e6 * rng.permutation(u)
    force = contact_force(Seen(scene, scene.time, grains, u, v), contact)
    closer, closing = (-np.diff(y, axis=1, prepend=0.0, append=0.0)[:, contact] for y in (u, v))
    constant = chain.contacts.constant[contact]
    carried = chain.contacts.force[contact]

    def hertz(r: float = 0.0, k: float = 0.0, f: float = 0.0, rate: float = 0.0, a: float = 0.0):
        overlap = ((carried + f) / (constant + k)) ** (1 / 1.7) + closer + r
        overlap = np.maximum(overlap, 0.0)
        viscous = (viscosity + a) * 1.7 * overlap**0.7 * (closing + rate)
        return (constant + k) * (overlap**1.7 + viscous)

    assert force.grains == [n for n in (contact, contact + 1) if 1 <= n <= 4]
    np.testing.assert_allclose(force.value, hertz(), rtol=1e-12)
    assert force.value[5] == 0 != force.value[0]
    for slope, key, step in (
        (force.by_closer, "r", 1e-6 * eps),
        (force.by_closing, "rate", 1e-6 * np.abs(closing).max()),
        (force.by_constant, "k", 1e-6 * constant),
        (force.by_force, "f", 1e-6 * carried),
        (force.by_viscosity, "a", 1e-13),
    ):
        difference = (hertz(**{key: step}) - hertz(**{key: -step})) / (2 * step)
        np.testing.assert_allclose(slope, difference, rtol=1e-7, atol=1e-9 * np.abs(slope).max())


def test_a_smooth_peak_is_the_mean_of_the_force_with_its_powers_as_weights():
    """Quadrature of a run of another integrator gives the mean, also for open contacts."""
    chain = Chain(grains=5, diameter=1e-3, top_load=0.02, bottom="wall")
    scene = Scene(chain=chain, excitation=Impulse(velocity=5e-3), duration=1e-5, samples=401)
    run = simulate(scene, engine=Native(integrator="dop853"), tolerance=1e-10)
    for contact, sharpness in ((1, 100.0), (5, 20.0), (2, 3.0)):
        closer = -np.diff(run.displacement, axis=1, append=0.0)[:, contact - 1]
        law = chain.contacts
        force = law.constant[contact] * np.maximum(law.overlap[contact] + closer, 0.0) ** 1.5
        weight = np.full(401, 1.0)
        weight[1:-1:2], weight[2:-1:2] = 4.0, 2.0  # Simpson's rule.
        relative = force / force.max()
        mean = force.max() * (weight @ relative ** (sharpness + 1)) / (weight @ relative**sharpness)
        objective = PeakForce(contact) if sharpness == 100 else PeakForce(contact, sharpness)
        assert value(scene, objective, 1e-8) == pytest.approx(mean, rel=2e-6)
    loose = Chain(grains=2, diameter=1e-3, gravity=0.0)
    apart = Profile(displacement=[0.0, 1e-6], velocity=[1e-3, 0.0])  # Apart for 1 ms.
    vacuum = Scene(chain=loose.replace(bottom="free"), excitation=apart, duration=1e-5, samples=3)
    still, slopes, _ = at_step(vacuum, PeakForce(1), ["masses"], METHOD, 1e-6)
    assert (still, np.abs(slopes["masses"]).max()) == (0.0, 0.0)


def test_invalid_contacts_and_sharpness_are_rejected():
    chain = Chain(grains=5, diameter=1e-3, top_load=0.02)
    scene = Scene(chain=chain, excitation=Impulse(velocity=1e-4), duration=1e-6, samples=3)
    walls = scene.replace(chain=chain.replace(top="wall", bottom="wall"))
    for where, contact, numbers in (
        (scene, 0, "1 to 4"), (scene, 5, "1 to 4"), (walls, -1, "0 to 5"), (walls, 6, "0 to 5"),
    ):  # fmt: skip
        with pytest.raises(
            InputError, match=rf"^contact: must be one of {numbers} \(got {contact}\)"
        ):
            gradient(where, PeakForce(contact), ["masses"])
    assert PeakForce(1).grains(scene) == [1, 2]
    assert (PeakForce(0).grains(walls), PeakForce(5).grains(walls)) == ([1], [5])
    for sharpness in (0.0, -1.0):
        with pytest.raises(InputError, match=r"^sharpness: must be above 0"):
            gradient(scene, PeakForce(1, sharpness), ["masses"])
    assert PeakForce(1, 0.1).grains(scene) == [1, 2]


def test_invalid_groups_and_times_are_rejected():
    scene = swinging(1.0, 9)
    for objective in (Momentum([]), Momentum([0]), Momentum([1, 3]), ArrivalTime(3, 1e-3)):
        with pytest.raises(InputError, match=r"^grains: must be some of 1 to 2 \(got \["):
            objective.grains(scene)
    assert Momentum([1, 2]).grains(scene) == [1, 2]
    for time in (-1e-9, 1.001 * scene.duration):
        for kind in (Momentum, KineticEnergy, Energy):
            with pytest.raises(InputError, match=r"^time: must be from 0 to "):
                kind([1], time).grains(scene)
    for time in (0.0, scene.duration):
        assert Momentum([1], time).grains(scene) == [1]
    with pytest.raises(InputError, match=r"^field: must be "):
        Misfit([1], np.zeros((9, 1)), "force").grains(scene)
    for shape in ((9, 2), (8, 1), (9,)):
        with pytest.raises(
            InputError, match=r"^values: must be of shape \(9, 1\), samples and grains, not"
        ):
            Misfit([1], np.zeros(shape)).grains(scene)
    assert Misfit([1], np.zeros((9, 1)), "displacement").grains(scene) == [1]


def test_energy_depends_on_the_neighbours_of_a_group():
    chain = Chain(grains=7, diameter=1e-3, top="wall")
    scene = Scene(chain=chain, excitation=Impulse(velocity=1e-4), duration=1e-6, samples=3)
    for group, grains in (
        ([3], [2, 3, 4]),
        ([1], [1, 2]),
        ([7], [6, 7]),
        ([2, 5], [1, 2, 3, 4, 5, 6]),
    ):
        assert Energy(group).grains(scene) == grains


@pytest.mark.parametrize("at", [0.0, 0.26, 0.34, None])
def test_an_oscillator_has_its_energy_and_momentum_at_the_nearest_sample(at: float | None):
    """The values are m v0 cos(w t) and m v0^2 / 2 cos^2(w t), and the total energy is constant."""
    scene = swinging(1.3, 9)
    m = ONE.masses[0]
    time = None if at is None else at * scene.duration
    sample = -1 if at is None else round(8 * at)
    cosine = np.cos(2 * np.pi * 1.3 * np.arange(9) / 8)[sample]
    assert value(scene, Momentum([1], time)) == pytest.approx(m * WEAK * cosine, rel=1e-6)
    kinetic = m * (WEAK * cosine) ** 2 / 2
    assert value(scene, KineticEnergy([1], time)) == pytest.approx(kinetic, rel=1e-6)
    assert value(scene, Energy([1, 2], time)) == pytest.approx(m * WEAK**2 / 2, rel=1e-6)
    # Grain 2 has half of the energy of the contact.
    half = m * WEAK**2 / 2 * (1 - cosine**2) / 2
    assert value(scene, Energy([2], time)) == pytest.approx(half, rel=1e-6, abs=1e-12 * m * WEAK**2)


@pytest.mark.parametrize("share", [0.5, -0.5, -0.99])
def test_an_oscillator_arrives_when_its_cosine_does(share: float):
    """The arrival is at w t = arccos(share); a positive threshold is reached at once."""
    scene = swinging(0.9, 4)
    if share > 0:
        with pytest.raises(
            InputError, match=r"^velocity: grain 1 has that velocity at t = 0: use another"
        ):
            value(scene, ArrivalTime(1, share * WEAK))
        return
    arrival = scene.duration * np.arccos(share) / (2 * np.pi * 0.9)
    time, slopes, _ = at_step(scene, ArrivalTime(1, share * WEAK), ["velocity"], METHOD, 1e-8)
    assert time == pytest.approx(arrival, rel=2e-4)
    with pytest.raises(
        InputError, match=r"^velocity: grain 1 is never faster than 1e-13 m/s: use another"
    ):
        value(scene, ArrivalTime(1, -1.001 * WEAK))
    # From cos(w t) = c / v0 follows dt/dv0 = c / (v0^2 w sin(w t)).
    omega = 2 * np.pi * 0.9 / scene.duration
    rate = share / (WEAK * omega * np.sqrt(1 - share**2))
    assert slopes["velocity"][0] == pytest.approx(rate, rel=0.02)


def test_an_arrival_near_an_end_is_found_from_the_nearest_four_times():
    for turns, share, reach in ((0.26, -0.06, 1e-5), (0.9, -0.99, 1e-3)):
        scene = swinging(turns, 3)
        arrival = scene.duration * np.arccos(share) / (2 * np.pi * turns)
        assert value(scene, ArrivalTime(1, share * WEAK)) == pytest.approx(arrival, rel=reach)
    # A grain that is displaced upwards starts from rest.
    scene = swinging(0.9, 2)
    omega = 2 * np.pi * 0.9 / scene.duration
    scene = scene.replace(excitation=Profile(displacement=[-WEAK / omega, 0.0]))
    early = value(scene, ArrivalTime(1, 0.07 * WEAK))
    assert early == pytest.approx(np.arcsin(0.07) / omega, rel=1e-3)
    driven = scene_of(ONE, Profile(velocity=[-WEAK, 0.0]), swinging(0.9, 2).duration, 2)
    time = value(driven, ArrivalTime(1, 0.02 * WEAK))
    assert time == pytest.approx(driven.duration * np.arccos(-0.02) / (2 * np.pi * 0.9), rel=1e-4)


def test_a_misfit_is_half_the_sum_of_squares():
    scene = swinging(1.3, 9)
    scale = 0.2 * WEAK
    cosine = np.cos(2 * np.pi * 1.3 * np.arange(9) / 8)
    traces = WEAK * np.linspace(0, 1, 9)[:, None]
    expected = (((WEAK * cosine - traces[:, 0]) / scale) ** 2).sum() / 2
    assert value(scene, Misfit([1], traces, scale=scale)) == pytest.approx(expected, rel=1e-6)
    assert value(scene, Misfit([1], traces)) == pytest.approx(expected * scale**2, rel=1e-6)
    omega = 2 * np.pi * 1.3 / scene.duration
    lengths = ((WEAK / omega * np.sin(2 * np.pi * 1.3 * np.arange(9) / 8)) ** 2).sum() / 2
    assert value(scene, Misfit([1], 0 * traces, "displacement")) == pytest.approx(lengths, rel=1e-6)


@pytest.mark.parametrize("group", [[3, 1], [2, 2]])
def test_the_columns_of_traces_and_functions_have_the_order_of_the_group(group: list[int]):
    """A misfit is the sum of those of its traces, and a function of v is a momentum over mass."""
    scene = scene_of(Chain(grains=4, diameter=1e-3), Impulse(velocity=1e-4), 1e-5, 6)
    traces = 1e-4 * np.array([np.sin(np.arange(6)), np.cos(np.arange(6))]).T

    def found(objective: Any) -> tuple[float, np.ndarray]:
        value, slopes, _ = at_step(scene, objective, ["contact_constants"], METHOD, 1e-7)
        return value, slopes["contact_constants"]

    for field, scale in (("velocity", 1.0), ("displacement", 1e-6)):
        values = scale * traces
        whole = found(Misfit(group, values, field))
        parts = [found(Misfit([n], values[:, [k]], field)) for k, n in enumerate(group)]
        assert whole[0] == pytest.approx(parts[0][0] + parts[1][0], rel=1e-12)
        assert whole[1] == pytest.approx(parts[0][1] + parts[1][1], rel=1e-9)

    def speeds(
        time: np.ndarray, u: np.ndarray, v: np.ndarray
    ) -> tuple[float, np.ndarray, np.ndarray]:
        slope = np.zeros(v.shape)
        slope[-1] = 1.0, 5.0
        return float(v[-1, 0] + 5 * v[-1, 1]), np.zeros(u.shape), slope

    value, slope = found(Function(speeds, group))
    mass = scene.chain.masses[0]
    parts = [found(Momentum([n])) for n in group]
    assert value == pytest.approx((parts[0][0] + 5 * parts[1][0]) / mass, rel=1e-12)
    assert slope == pytest.approx((parts[0][1] + 5 * parts[1][1]) / mass, rel=1e-9)


NONE = np.zeros((9, 1))


@pytest.mark.parametrize(
    ("objective", "message"),
    [
        (PeakForce(1.0), r"contact: must be one of 1 to 1 \(got 1\.0\)"),
        (PeakForce("1"), r"contact: must be one of 1 to 1 \(got '1'\)"),
        (PeakForce(True), r"contact: must be one of 1 to 1 \(got True\)"),
        (PeakForce(1, np.inf), r"sharpness: must be a finite number \(got inf\)"),
        (PeakForce(1, "2"), "sharpness: must be numbers, not text"),
        (Momentum([1], "0"), "time: must be numbers, not text"),
        (Momentum([1], [0.0]), r"time: must be a finite number \(got \[0\.0\]\)"),
        (Momentum(3), r"grains: must be some of 1 to 2 \(got \[3\]\)"),
        (ArrivalTime(1, np.nan), r"velocity: must be a finite number \(got nan\)"),
        (Misfit([1], NONE + np.nan), "values: must be finite"),
        (Misfit([1], NONE, scale=0.0), r"scale: must be above 0 \(got 0\.0\)"),
        (Misfit([1], NONE, scale=-1.0), "scale: must be above 0"),
        (Function(3.0, [1]), r"objective: must contain a function \(got 3\.0\)"),
        (Function(lambda *_: 3.0, [1]), r"objective: .* two arrays of shape \(9, 1\)"),
        (Function(lambda *_: (3.0, NONE[0], NONE), [1]), "objective: its function must return"),
        (Function(lambda *_: (np.nan, NONE, NONE), [1]), "objective: has no finite value or deriv"),
        (Function(lambda *_: (1.0, NONE, NONE + np.inf), [1]), "objective: has no finite value"),
    ],
)
def test_objectives_without_a_meaning_are_rejected(objective: Any, message: str):
    with pytest.raises(InputError, match=f"^{message}"):
        gradient(swinging(1.0, 9), objective, ["masses"], step=1e-7)
    assert Momentum(2).grains(swinging(1.0, 9)) == Momentum([2.0]).grains(swinging(1.0, 9)) == [2]


@pytest.mark.parametrize("top", ["free", "wall"])
def test_the_work_of_a_drive_is_that_of_its_force(top: str):
    """A sine motion of grain 1 against a moving grain, by quadrature of another integrator."""
    chain = Chain(grains=3, diameter=1e-3, top_load=0.02, top=top)
    amplitude = 0.3 * chain.length_scale
    frequency = 2e4
    drive = Drive(amplitude=amplitude, frequency=frequency)
    scene = Scene(chain=chain, excitation=drive, duration=3.3e-5, samples=1001)
    run = simulate(scene, engine=Native(integrator="dop853"), tolerance=1e-10)
    u = run.displacement
    v = run.velocity[:, 0]
    law = chain.contacts
    force = law.constant[1] * (law.overlap[1] + u[:, 0] - u[:, 1]) ** 1.5 - law.force[1]
    if top == "wall":
        force -= law.constant[0] * (law.overlap[0] - u[:, 0]) ** 1.5 - law.force[0]
    weight = np.ones(1001)
    weight[1:-1:2] = 4.0
    weight[2:-1:2] = 2.0
    work = (weight * force * v).sum() * scene.duration / 3000
    kinetic = chain.masses[0] * (v[-1] ** 2 - v[0] ** 2) / 2
    assert value(scene.replace(samples=5), DriveWork(), 1e-8) == pytest.approx(
        work + kinetic, rel=1e-7
    )


def test_a_function_receives_only_the_samples():
    scene = swinging(1.0, 5)
    counts = []

    def first(
        time: np.ndarray, u: np.ndarray, v: np.ndarray
    ) -> tuple[float, np.ndarray, np.ndarray]:
        counts.append((time.size, u.shape, v.shape))
        slope = np.zeros(v.shape)
        slope[2, 1] = 3.0
        return 3.0 * v[2, 1] + 1.0, np.zeros(u.shape), slope

    assert value(scene, Function(first, [1, 2])) == 1.0  # Grain 2 is fixed.
    assert counts == [(5, (5, 2), (5, 2))]
    assert value(scene, Function(first, [1, 2], dense=True)) == 1.0
    assert counts[1][0] > 5


@pytest.mark.parametrize("turns", [0.01, 1.0, 7.7])
def test_dense_objectives_look_at_every_quarter_of_a_radian_of_the_fastest_motion(turns: float):
    scene = swinging(turns, 4)
    angle = scene.highest_frequency * scene.duration / 3
    for finer in (1, 4):
        more = looks_of(scene, PeakForce(1), finer) / 3
        assert more == round(more)
        assert more % finer == 0
        least = max(1, angle / 0.25)
        assert least <= more / finer < max(least + 1, 1.1)
        assert looks_of(scene, Momentum([1]), finer) == 3
    assert looks_of(scene, PeakForce(1)) == looks_of(scene, PeakForce(1), 1)


def test_the_error_of_gradients_is_some_ten_times_the_true_one_where_the_order_holds():
    """The estimate from steps h, 2h and 1.5h of Verlet is 2.5 (3 + 1.25) = 10.6 times the error."""
    chain = Chain(grains=6, diameter=1e-3, top_load=0.05)
    scene = Scene(chain=chain, excitation=Impulse(velocity=1e-6), duration=1e-5, samples=2)
    names = ["masses", "contact_constants"]
    step = 2.5e-9
    rough = gradient(scene, Momentum([2]), names, integrator="verlet", step=step)
    true = gradient(scene, Momentum([2]), names, 1e-10, integrator="rkn6")
    assert rough.step_s == pytest.approx(step, rel=1e-2)
    for name in names:
        off = np.abs(rough[name] - true[name]).max()
        assert rough.errors[name] / off == pytest.approx(10.6, rel=0.1)
        assert rough.error >= rough.errors[name] / np.abs(rough[name]).max() * (1 - 1e-12)
    assert rough.value_error / abs(rough.value - true.value) == pytest.approx(10.6, rel=0.1)
