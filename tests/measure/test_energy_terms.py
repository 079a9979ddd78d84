"""Every term of the ledger, and every energy of a grain or contact, from independent formulas."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from helpers.changed_recordings import of_error
from helpers.example_scenes import run
from numpy.typing import NDArray

from lmpchain import (
    Chain,
    Drive,
    Force,
    Impulse,
    InputError,
    Law,
    Scene,
    Trajectory,
    engines,
    simulate,
)
from lmpchain.measure import energy
from lmpchain.measure.energy import EnergyLedger
from lmpchain.measure.motion import motion_of
from lmpchain.util.plotting import figure

Array = NDArray[np.float64]
UNEVEN = {"grains": 9, "diameter": np.linspace(1e-3, 1.4e-3, 9), "top_load": 2e-3}
SMOOTH = {"times": [0, 1e-5, 2e-5, 3e-5, 4e-5], "interpolation": "spline"}
PATH = 1e-9 * np.array([0, 1, 4, 7, 8])
GIVEN = {
    "a sine on grain 3": (Chain(**UNEVEN), Force(grain=3, amplitude=1e-3, frequency=1e5)),
    "half a sine on grain 1": (
        Chain(**UNEVEN, bottom="wall", exponent=2.0),
        Force(grain=1, shape="half-sine", amplitude=1e-3, duration=6e-5),
    ),
    "under a wall": (
        Chain(**UNEVEN, top="wall", bottom="wall"),
        Force(grain=2, amplitude=5e-4, frequency=8e4),
    ),
    "a wall that moves": (Chain(**UNEVEN, top="wall"), Drive(**SMOOTH, displacement=PATH, grain=0)),
    "grain 1 that moves": (Chain(**UNEVEN, bottom="wall"), Drive(**SMOOTH, displacement=PATH)),
    "a base that moves": (
        Chain(**UNEVEN, bottom="wall"),
        Drive(**SMOOTH, displacement=-PATH, end="bottom"),
    ),
    "on a ground": (
        Chain(**UNEVEN, ground=Law("k*u", k=1e5)),
        Force(grain=3, amplitude=1e-3, frequency=1e5),
    ),
}


def base_of(t: Trajectory) -> Array:
    """Return the displacement of a driven bottom wall, (T,) m; 0 for other ends."""
    excitation = t.scene.excitation
    return excitation.waveform.at(t.time, 0) if excitation.from_below else np.zeros(t.time.size)


def simulated(name: str, samples: int = 401) -> Trajectory:
    return run(*GIVEN[name], 4e-5, samples, engine=engines.Native(step=1e-8))


def overlaps(t: Trajectory) -> Array:
    """Return the overlaps of all contacts, with the walls, (T, N+1); 0 for missing contacts."""
    chain = t.scene.chain
    wall = t.scene.excitation.wall
    top = wall.at(t.time, 0) if wall else np.zeros(t.time.size)
    edged = np.column_stack((top, t.displacement, base_of(t)))
    return np.where(
        chain.contacts.exists, chain.contacts.overlap + edged[:, :-1] - edged[:, 1:], 0.0
    )


@pytest.mark.parametrize("name", GIVEN)
def test_every_term_and_the_energy_input(name: str):
    """The terms follow from the motion, and sum up to the input of force, driver and walls."""
    t = simulated(name)
    chain = t.scene.chain
    seen = energy.ledger(t)
    u = t.displacement
    v = t.velocity
    power = chain.exponent + 1
    elastic = chain.contacts.constant * np.maximum(overlaps(t), 0.0) ** power / power
    at_rest = chain.contacts.constant * chain.contacts.overlap**power / power
    contact = (elastic - np.where(chain.contacts.exists, at_rest, 0.0)).sum(1)
    wall = t.scene.excitation.wall
    moved = wall.at(t.time, 0) if wall else u[:, 0] * (chain.top == "free")
    assert np.array_equal(seen.time, t.time)
    assert seen.kinetic == pytest.approx(v**2 @ chain.masses / 2, rel=1e-13)
    assert seen.contact == pytest.approx(contact, rel=1e-9, abs=1e-12 * np.abs(contact).max())
    weight = 9.81 * (u @ chain.masses)
    assert seen.gravity == pytest.approx(-weight, rel=1e-9, abs=1e-13 * np.abs(weight).max())
    # A driver below carries the load and the weight.
    base = base_of(t)
    support = 2e-3 + 9.81 * chain.masses.sum()
    scale = 1e-13 * support * np.abs(base).max()
    assert seen.load == pytest.approx(-2e-3 * moved + support * base, rel=1e-13, abs=scale)
    spring = 1e5 if chain.ground else 0.0
    assert seen.ground == pytest.approx(spring * (u**2).sum(1) / 2, rel=1e-12)
    terms = seen.kinetic + seen.contact + seen.ground + seen.gravity + seen.load
    assert seen.total == pytest.approx(terms, rel=1e-9, abs=1e-9 * np.abs(seen.total).max())
    momentum = v @ chain.masses
    assert seen.momentum == pytest.approx(momentum, rel=1e-9, abs=1e-13 * np.abs(momentum).max())
    assert seen.drive[0] == seen.impulse[0] == 0
    change = seen.total - seen.total[0]
    assert np.abs(change).max() > 0.9 * np.abs(seen.total).max() > 0
    assert np.abs(seen.drive - change).max() < 1e-6 * np.abs(change).max()
    gained = seen.momentum - seen.momentum[0]
    assert np.abs(seen.impulse - gained).max() < 1e-6 * np.abs(gained).max()
    assert seen.drift == pytest.approx(change - seen.drive, abs=1e-12 * np.abs(change).max())
    assert seen.momentum_drift == pytest.approx(
        gained - seen.impulse, abs=1e-12 * np.abs(gained).max()
    )
    assert np.abs(seen.drift).max() <= 0.2 * seen.drive_error < 1e-4 * np.abs(change).max()
    assert (
        np.abs(seen.momentum_drift).max() <= 0.2 * seen.impulse_error < 1e-4 * np.abs(gained).max()
    )


KNOCK = {"times": [0, 3e-6, 1e-5], "displacement": [0, 1e-8, 0], "interpolation": "linear"}
HAMMERS = {
    "half a sine": Force(grain=2, shape="half-sine", amplitude=1e-2, duration=1e-5),
    "a triangle": Force(grain=2, times=[0, 3e-6, 1e-5], force=[0, 1e-2, 0], interpolation="linear"),
    "a burst": Force(grain=1, amplitude=1e-2, frequency=2e5, cycles=2),
    "a wall": Drive(**KNOCK, grain=0),
    "grain 1": Drive(**KNOCK),
    "grain 1 on a ground": Drive(**KNOCK),
    "a base": Drive(**KNOCK, end="bottom"),
    "the last grain": Drive(**KNOCK, end="bottom"),
}


@pytest.mark.parametrize("name", HAMMERS)
@pytest.mark.parametrize("within", [0.6, 1.5, 3.3, 8.5])
def test_the_work_of_a_hammer_is_right_for_few_samples(name: str, within: float):
    """The work of a hammer is accurate despite kinks between few samples.

    The work is compared with the energy gained. The samples alone suffice: where they do not show
    the kinks, the interpolation between them is of fourth order.
    """
    top = "wall" if name == "a wall" else "free"
    bottom = "wall" if name == "a base" else "fixed"
    ground = {"ground": Law("k*u", k=1e7)} if name == "grain 1 on a ground" else {}
    ends = {"top": top, "bottom": bottom} | ground
    chain = Chain(grains=60, diameter=5e-3, top_load=1.0, gravity=0.0, **ends)
    samples = 25
    t = run(chain, HAMMERS[name], (samples - 1) * 1e-5 / within, samples, 1e-9)
    alone = energy.ledger(of_error(t, np.inf))
    for seen in (energy.ledger(t), alone):
        assert np.abs(seen.drift).max() <= seen.drive_error + 1e-8 * seen.total.max()
        # Momenta cancel in a burst.
        rounding = 1e-8 * max(np.abs(seen.momentum).max(), 1e-2 * 1e-5)
        assert np.abs(seen.momentum_drift).max() <= seen.impulse_error + rounding
    assert not alone.balanced
    assert np.abs(alone.drift).max() < 2 / within**4 * alone.total.max()
    if not ground:  # The force of a ground has kinks that the samples must show.
        lost = np.abs(alone.momentum_drift).max()
        assert lost < 0.2 / within**4 * max(np.abs(alone.momentum).max(), 1e-2 * 1e-5)


def test_work_of_a_force_far_faster_than_the_samples():
    """The samples resolve the chain, but the force turns by 10 rad between two of them."""
    chain = Chain(**UNEVEN)
    edge = chain.band_edge
    force = Force(grain=3, amplitude=1e-3, frequency=10 * edge / (2 * np.pi))
    seen = energy.ledger(of_error(run(chain, force, 40 / edge, 41, 1e-10)))
    assert np.abs(seen.drift).max() < 5e-3 * seen.total.max()
    assert np.abs(seen.momentum_drift).max() < 1e-3 * np.abs(seen.momentum).max()


def corrected_trapezoid(step: float, value: Array, slope: Array) -> Array:
    """Return the running integral by the trapezoidal rule with its first correction."""
    parts = step * (value[1:] + value[:-1]) / 2 + step**2 / 12 * (slope[:-1] - slope[1:])
    return np.append(0.0, np.cumsum(parts))


def test_the_errors_are_the_shift_when_every_second_sample_is_used():
    """A force acts on grain 3; its work and the impulses are computed from 41 and 21 samples."""
    t = simulated("a sine on grain 3", 41)
    # The sample error is unknown, as in a foreign dump, so that no balance replaces the integral.
    t = of_error(t)
    chain = t.scene.chain
    seen = energy.ledger(t)
    omega = 2 * np.pi * 1e5
    force = 1e-3 * np.sin(omega * t.time)
    rate = 1e-3 * omega * np.cos(omega * t.time)
    inner = overlaps(t)[:, 1:-1]
    constant = chain.contact_constants
    rest = chain.equilibrium_overlap
    pull = constant * (np.maximum(inner, 0) ** 1.5 - rest**1.5)
    closing = t.velocity[:, :-1] - t.velocity[:, 1:]
    pull_rate = 1.5 * constant * np.sqrt(np.maximum(inner, 0)) * closing
    acceleration = (force + pull[:, 1] - pull[:, 2]) / chain.masses[2]
    power = force * t.velocity[:, 2]
    power_rate = rate * t.velocity[:, 2] + force * acceleration
    errors = []
    for value, slope in ((power, power_rate), (force, rate), (pull[:, -1], pull_rate[:, -1])):
        fine = corrected_trapezoid(t.time[1], value, slope)
        coarse = corrected_trapezoid(2 * t.time[1], value[::2], slope[::2])
        errors.append((fine, np.abs(fine[::2] - coarse).max()))
    (work, work_error), (_, push_error), (held, hold_error) = errors
    # The integral over every sample is more accurate than that of a cubic.
    assert seen.drive == pytest.approx(work, abs=0.1 * work_error)
    assert seen.drive_error == pytest.approx(work_error, rel=0.1)
    given = 1e-3 / omega * (1 - np.cos(omega * t.time)) - held
    assert seen.impulse == pytest.approx(given, rel=1e-9, abs=1e-9 * np.abs(given).max())
    assert seen.impulse_error == pytest.approx(push_error + hold_error, rel=0.1)


def swinging(**more: Any) -> EnergyLedger:
    """Return the ledger of 2 J oscillating between motion and a spring: K = 2 cos(t)^2."""
    time = np.linspace(0, 10, 2001)
    terms = ("contact", "ground", "gravity", "load", "drive", "dissipated", "momentum", "impulse")
    given = dict.fromkeys(terms, np.zeros(time.size))
    given |= {"time": time, "kinetic": 2 * np.cos(time) ** 2, "total": np.full(time.size, 2.0)}
    errors = dict.fromkeys(("drive_error", "impulse_error", "dissipated_error"), 0.0)
    return EnergyLedger(**given | errors | more)


def test_the_virial_ratio_of_a_part_of_the_time():
    """The mean of cos(t)^2 from a to b is 1/2 + [sin(2b) - sin(2a)] / (4 (b - a))."""
    for start, end in ((0.0, None), (1.3, None), (2.0, 3.1), (0.0, 0.4)):
        last = 10.0 if end is None else end
        exact = 0.5 + (np.sin(2 * last) - np.sin(2 * start)) / 4 / (last - start)
        assert swinging().virial_ratio(start, end) == pytest.approx(exact, rel=1e-9)
    assert np.isnan(swinging(total=np.zeros(2001)).virial_ratio())
    for ends in ((0.0, 10.1), (-0.1, 1.0), (3.0, 2.0), (np.nan, 1.0)):
        with pytest.raises(InputError, match=r"end: must be after start, both within 0 to 10 s"):
            swinging().virial_ratio(*ends)


def test_the_lines_of_the_picture():
    quiet = swinging()
    axes = quiet.plot()
    lines = [line.get_ydata() for line in axes.lines]
    assert len(lines) == 3
    assert np.array_equal(lines[0], quiet.total)
    assert np.array_equal(lines[1], quiet.kinetic)
    assert lines[2] == pytest.approx(2 * np.sin(quiet.time) ** 2, abs=1e-14)
    assert all(np.array_equal(line.get_xdata(), quiet.time) for line in axes.lines)
    assert axes.get_title("left") == "Drift: at most 0 of the largest total"
    driven = swinging(total=1.0 + 0.3 * quiet.time, drive=0.25 * quiet.time)
    axes = driven.plot(figure().subplots())
    assert axes.lines[3].get_ydata() == pytest.approx(1 + 0.25 * quiet.time, rel=1e-14)
    assert axes.get_title("left") == "Drift: at most 0.12 of the largest total"
    lossy = swinging(dissipated=0.2 * quiet.time).plot(figure().subplots())
    assert lossy.lines[3].get_label() == "dissipated"
    assert np.array_equal(lossy.lines[3].get_ydata(), 0.2 * quiet.time)
    assert axes.xaxis.get_major_formatter()(3e-6) == "3 µs"
    assert axes.yaxis.get_major_formatter()(2e-12) == "2 pJ"
    assert (axes.get_xlabel(), axes.get_ylabel()) == ("time", "energy above rest")
    labels = ["total", "kinetic", "potential", "given by strike and driver"]
    assert [text.get_text() for text in axes.get_legend().get_texts()] == labels
    still = swinging(total=np.zeros(2001), kinetic=np.zeros(2001)).plot(figure().subplots())
    assert still.get_title("left").startswith("Drift: at most 0 ")


@pytest.mark.parametrize(
    "ends",
    [{}, {"bottom": "wall"}, {"top": "wall", "bottom": "wall"}, {"ground": Law("k*u", k=1e5)}],
)
def test_energies_of_grains_and_contacts_by_their_formulas(ends: dict[str, Any]):
    """Each contact has E = K [o^(d+1) - eps^(d+1)] / (d+1) - F (o - eps)."""
    chain = Chain(**UNEVEN, **ends)
    scene = Scene(chain=chain, excitation=Impulse(velocity=3e-3, grain=4), duration=2e-5, samples=7)
    t = simulate(scene, engines.Native(step=1e-8))
    seen = energy.shares(t)
    rest = chain.contacts.overlap
    squeezed = overlaps(t)
    stored = chain.contacts.constant * (np.maximum(squeezed, 0) ** 2.5 - rest**2.5) / 2.5
    elastic = np.where(
        chain.contacts.exists, stored - chain.contacts.force * (squeezed - rest), 0.0
    )
    kinetic = chain.masses * t.velocity**2 / 2
    share = elastic.copy()
    share[:, 1:-1] /= 2
    scale = 1e-12 * scene.energy
    assert seen.contact.tolist() == np.flatnonzero(chain.contacts.exists).tolist()
    assert seen.grain.tolist() == list(range(1, 10))
    assert np.array_equal(seen.time, t.time)
    assert seen.kinetic == pytest.approx(kinetic, rel=1e-14)
    assert seen.elastic == pytest.approx(elastic[:, seen.contact], rel=1e-7, abs=1e4 * scale)
    of_grain = kinetic + share[:, :-1] + share[:, 1:]
    if chain.ground:
        of_grain += 1e5 * t.displacement**2 / 2
    assert seen.of_grain == pytest.approx(of_grain, rel=1e-7, abs=1e4 * scale)
    for first, last in ((1, 9), (3, 3), (4, 9)):
        assert seen.part(first, last) == pytest.approx(
            seen.of_grain[:, first - 1 : last].sum(1), rel=1e-13
        )
    for first, last in ((5, 4), (0, 3), (8, 10)):
        with pytest.raises(InputError, match=f"first to last .got {first} to {last}"):
            seen.part(first, last)


def test_grains_in_the_order_in_which_they_were_recorded():
    chain = Chain(**UNEVEN)
    scene = Scene(chain=chain, excitation=Impulse(velocity=3e-3, grain=4), duration=2e-5, samples=7)
    whole = energy.shares(simulate(scene, engines.Native(step=1e-8)))
    some = energy.shares(simulate(scene.replace(grains=[6, 3, 5, 4]), engines.Native(step=1e-8)))
    assert some.grain.tolist() == [6, 3, 5, 4]
    assert some.contact.tolist() == [3, 4, 5]
    assert np.array_equal(some.elastic, whole.elastic[:, 2:5])
    assert np.isnan(some.of_grain[:, :2]).all()
    assert some.of_grain[:, 2:] == pytest.approx(whole.of_grain[:, [4, 3]], rel=1e-13)
    assert some.part(4, 5) == pytest.approx(whole.part(4, 5), rel=1e-13)
    with pytest.raises(InputError, match="part: must be a range of recorded grains"):
        some.part(5, 7)


@pytest.mark.parametrize("spring", [0.0, 1e5])
def test_errors_of_the_motion_propagate_to_the_energies(spring: float):
    """Errors dv of speeds and du of displacements change the energies by exact formulas."""
    chain = Chain(**UNEVEN, bottom="wall")
    if spring:
        chain = chain.replace(ground=Law("k*u", k=spring))
    t = run(chain, Impulse(velocity=3e-3, grain=4), 2e-5, 41, 1e-6, engines.Native(step=1e-8))
    t = replace(t, error_estimate=replace(t.error_estimate, solver=1e-4, model=0.0))
    seen = energy.shares(t)
    between = motion_of(t)
    fast = between.known_error("velocity")
    off = between.known_error("displacement")
    assert fast > 1e-4 * np.abs(t.velocity).max()
    kinetic = chain.masses * ((np.abs(t.velocity) + fast) ** 2 - t.velocity**2) / 2
    assert seen.kinetic_error == pytest.approx(kinetic, rel=1e-9)
    closer = overlaps(t)[:, seen.contact] - chain.contacts.overlap[seen.contact]
    these = chain.contacts.of(seen.contact)
    change = np.abs([these.force_change(closer + side * 2 * off) for side in (-1, 1)]).max(0)
    assert seen.elastic_error == pytest.approx(2 * off * change, rel=1e-9)
    worst = np.abs(
        [these.energy(closer + side * 2 * off) - these.energy(closer) for side in (-1, 1)]
    ).max(0)
    assert (worst <= seen.elastic_error * (1 + 1e-9)).all()
    large = np.abs(closer) > 100 * off
    assert (seen.elastic_error[large] < 1.1 * worst[large]).all()
    beside = np.zeros((41, 10))
    beside[:, seen.contact] = seen.elastic_error
    beside[:, 1:-1] /= 2
    of_ground = off * spring * (np.abs(t.displacement) + off)
    assert seen.of_grain_error == pytest.approx(
        seen.kinetic_error + beside[:, :-1] + beside[:, 1:] + of_ground, rel=1e-12
    )
    again = energy.shares(between)
    assert np.array_equal(again.of_grain_error, seen.of_grain_error)


EVEN = {"grains": 9, "diameter": 1e-3, "gravity": 0.0}
SHAKEN = {"amplitude": 1e-8, "frequency": 1e5}
# The chain, the excitation, and the contact between the chain and an outer body.
DOUBTFUL: dict[str, tuple[Chain, Any, int | None]] = {
    "drag": (Chain(**EVEN, bottom="free", damping={"drag": 1e2}), Impulse(velocity=3e-3), None),
    "wall": (Chain(**EVEN, bottom="wall"), Impulse(velocity=3e-3, grain=8), 9),
    "viscous base": (
        Chain(**EVEN, bottom="wall", top_load=1e-2, damping={"viscoelastic": 1e-7}),
        Drive(end="bottom", **SHAKEN),
        9,
    ),
    "top wall": (Chain(**EVEN, bottom="free", top="wall"), Impulse(velocity=-3e-3, grain=2), 0),
    "force": (Chain(**EVEN, bottom="free"), Force(grain=2, amplitude=1e-3, frequency=1e5), None),
    "driven grain": (Chain(**EVEN, bottom="free"), Drive(**SHAKEN), 1),
    "driven grain on a ground": (
        Chain(**EVEN, bottom="free", ground=Law("k*u", k=1e3)),
        Drive(**SHAKEN),
        1,
    ),
    "driven wall": (Chain(**EVEN, bottom="free", top="wall"), Drive(grain=0, **SHAKEN), 0),
    "base": (Chain(**EVEN, bottom="wall"), Drive(end="bottom", **SHAKEN), 9),
}


@pytest.mark.parametrize("name", DOUBTFUL)
def test_errors_of_the_motion_propagate_to_work_and_impulse(name: str):
    """Errors of speeds and outer forces are integrated, unless the balance is more accurate."""
    chain, excitation, place = DOUBTFUL[name]
    t = run(chain, excitation, 1e-5, 161, 1e-6, engines.Native(step=1e-8))
    unknown, rough = (of_error(t, error) for error in (np.inf, 1e-4))
    fast, off = (motion_of(rough).known_error(field) for field in ("velocity", "displacement"))
    known, found = energy.ledger(unknown), energy.ledger(rough)
    impulse = drive = np.zeros(161)
    if name == "drag":
        impulse = impulse + fast * 1e2 * chain.masses.sum()
    if name == "force":
        drive = np.abs(excitation.waveform.at(t.time)) * fast
    if place is not None:
        bodies, speeds = np.zeros((2, 161, 11))
        bodies[:, 1:-1], speeds[:, 1:-1] = t.displacement, t.velocity
        speed = np.zeros(161)
        if isinstance(excitation, Drive):
            outer = 10 if excitation.from_below else place
            bodies[:, outer] = excitation.waveform.at(t.time)
            speed = speeds[:, outer] = excitation.waveform.at(t.time, 1)
        closer = bodies[:, place] - bodies[:, place + 1]
        closing = speeds[:, place] - speeds[:, place + 1]
        law = chain.contacts.of(place)
        viscous = 1e-7 if name == "viscous base" else 0.0

        def force(nearer: float, faster: float) -> Array:
            stiffness = law.stiffness_at(np.maximum(law.overlap + closer + nearer, 0.0))
            return law.force_change(closer + nearer) + viscous * stiffness * (closing + faster)

        ends = [force(2 * side * off, 2 * way * fast) for side in (-1, 1) for way in (-1, 1)]
        impulse = np.abs(np.array(ends) - force(0.0, 0.0)).max(0)
        if chain.ground:
            impulse = impulse + 1e3 * off
        drive = impulse * np.abs(speed)
    if chain.ground:
        impulse = impulse + 9 * 1e3 * off
    for term, rate in (("drive", drive), ("impulse", impulse)):
        error = getattr(found, f"{term}_error")
        integral = getattr(known, f"{term}_error") + np.trapezoid(rate, t.time)
        if term in found.balanced:
            assert 0 < error < integral
        else:
            assert error == pytest.approx(integral, rel=1e-9)


def test_errors_of_the_motion_propagate_to_losses():
    """Powers A F' s^2 of contacts and m gamma v^2 of grains change by at most their error."""
    viscous, drag = 1e-7, 1e2
    chain = Chain(**EVEN, top_load=1e-2, damping={"viscoelastic": viscous, "drag": drag})
    t = run(chain, Impulse(velocity=1e-4), 1e-5, 161, 1e-6, engines.Native(step=1e-8))
    unknown, rough = (of_error(t, error) for error in (np.inf, 1e-4))
    fast, off = (motion_of(rough).known_error(field) for field in ("velocity", "displacement"))
    constant = chain.contact_constants[0]
    overlap = chain.equilibrium_overlap - np.diff(t.displacement, axis=1)
    closing = -np.diff(t.velocity, axis=1)

    def power(nearer: float, faster: float) -> Array:
        stiffness = 1.5 * constant * np.sqrt(np.maximum(overlap + nearer, 0.0))
        return np.asarray(viscous * stiffness * (closing + faster) ** 2)

    changes = [
        np.abs(power(2 * one * off, 2 * other * fast) - power(0.0, 0.0))
        for one in (-1, 1)
        for other in (-1, 1)
    ]
    of_grains = drag * chain.masses[:-1] * fast * (2 * np.abs(t.velocity[:, :-1]) + fast)
    rate = np.max(changes, axis=0).sum(1) + of_grains.sum(1)
    more = energy.losses(rough).error - energy.losses(unknown).error
    assert more == pytest.approx(np.trapezoid(rate, t.time), rel=1e-6)
