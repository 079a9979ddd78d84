"""The parts of the model error of linear theory, for motions of which each part is known."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from helpers.example_chains import column
from helpers.example_scenes import scene_of, stirred, struck
from helpers.independent_integrators import distance
from scipy.integrate import cumulative_trapezoid

from lmpchain import Chain, Drive, Force, Impulse, Law, Packet, Scene, simulate
from lmpchain.engines import Chebyshev, Modes
from lmpchain.engines.linear import engine as linear
from lmpchain.engines.linear import model_error
from lmpchain.engines.linear.model_error import PhaseError
from lmpchain.integrators.kernels.phase_error import Evaluations, PhaseSums

pytestmark = pytest.mark.filterwarnings("ignore:Eq. ", "ignore:chain.damping")
UNLIKE: dict[str, Any] = {
    "grains": 5,
    "gravity": 40.0,
    "top_load": 1e-2,
    "exponent": 1.8,
    "masses": np.array([1.0, 2.0, 1.5, 3.0, 0.7]) * 1e-6,
}
HZ = column(**UNLIKE, bottom="wall").band_edge / (2 * np.pi)
MOTIONS: dict[str, tuple[dict[str, Any], Any]] = {
    "strike": ({}, Impulse(velocity=3e-6, grain=2)),
    "fixed": ({"bottom": "fixed"}, Impulse(velocity=-3e-6)),
    "viscous": (
        {"damping": {"viscoelastic": 0.4 / (2 * np.pi * HZ)}},
        Impulse(velocity=3e-6, grain=5),
    ),
    "on springs": ({"ground": Law("s*u", s=5e3)}, Impulse(velocity=3e-6, grain=2)),
    "force": ({}, Force(grain=3, amplitude=1e-6, frequency=1.5 * HZ)),
    "drive": ({}, Drive(amplitude=1e-12, frequency=2.5 * HZ)),
    "wall": ({"top": "wall"}, Drive(grain=0, amplitude=1e-12, frequency=0.4 * HZ)),
    "opening": ({}, Impulse(velocity=0.5, grain=3)),
}


@pytest.mark.parametrize("kind", MOTIONS)
def test_sums_along_the_solution_are_those_of_the_motion(kind: str) -> None:
    """Strains, accelerations and shifts are computed anew from positions and velocities."""
    changes, excitation = MOTIONS[kind]
    chain = column(**UNLIKE | {"bottom": "wall"} | changes)
    scene = scene_of(chain, excitation, 20 / chain.band_edge, 4001)
    t = simulate(scene, "modes", 0.99, on_miss="warn")
    u, v, time = t.displacement, t.velocity, t.time
    phase = PhaseError(scene)
    reach = np.tile((0, 5), (time.size, 1))
    # The error counts at every third time only.
    recorded = np.arange(time.size) % 3 == 0
    for part in (slice(0, 1500), slice(1500, None)):
        phase.add(Evaluations(time[part], recorded[part], u[part], v[part], reach[part]))
    sums = phase.sums

    contacts = chain.contacts
    omega = 2 * np.pi * getattr(excitation, "frequency", 0.0)
    top = 1e-12 * np.sin(omega * time) if kind == "wall" else 0 * time
    closer = -np.diff(np.column_stack((top, u, 0 * time)), axis=1)
    pressed = contacts.pressed
    strains = closer[:, pressed] / contacts.overlap[pressed]
    strain = np.take_along_axis(strains, np.abs(strains).argmax(1)[:, None], 1)[:, 0]
    speed = np.abs(v).max(1)
    # Held grains do not react, and the linear force does not include damping.
    force = np.where(pressed, contacts.stiffness * closer, 0.0)
    acceleration = -np.diff(force, axis=1) / chain.masses
    if kind == "on springs":
        acceleration -= 5e3 * u / chain.masses
    if kind == "force":
        acceleration[:, 2] += 1e-6 * np.sin(omega * time) / chain.masses[2]
    if kind == "drive":
        acceleration[:, 0] = -(omega**2) * u[:, 0]
    if kind == "fixed":
        acceleration[:, 4] = 0.0
    excess = 0.8 * np.hypot(1, 0.4 if kind == "viscous" else 0.0)
    shift = cumulative_trapezoid(excess / 4 * strain, time, initial=0)
    largest = np.abs(acceleration).max(1)
    expected = {
        "time": time[-1],
        "strain": strain[-1],
        "shift": shift[-1],
        "squared_strain": np.trapezoid(strain**2, time),
        "largest_strain": np.abs(strain).max(),
        "displacement": np.abs(u).max(),
        "velocity": speed.max(),
        "acceleration": largest.max(),
        "displacement_error": (np.abs(shift) * speed)[recorded].max(),
        "velocity_error": (np.abs(shift) * largest)[recorded].max(),
    }
    found = {name: getattr(sums, name) for name in expected}
    assert found == pytest.approx(expected, rel=1e-5)
    if kind not in ("viscous", "on springs"):
        slope = np.gradient(v, time, axis=0, edge_order=2)
        assert np.abs(slope).max() == pytest.approx(sums.acceleration, rel=1e-3)
    # In linear theory the spring of an open contact is stretched and pulls.
    stretched = np.where(pressed, np.minimum(closer + contacts.overlap, 0.0), 0.0)
    pull = np.abs(np.diff(contacts.stiffness * stretched, axis=1) / chain.masses).max(1)
    assert sums.pulled == pytest.approx(np.trapezoid(pull, time), rel=1e-5, abs=0)
    if kind == "opening":
        first = stretched[np.flatnonzero(stretched.any(1))[0]]
        assert sums.opened == np.flatnonzero(first)[0]
        assert phase.remark == f"not linear here: contact {sums.opened:.0f} opens"
    else:
        assert (sums.pulled, phase.remark) == (0.0, "")


def after(scene: Scene, **sums: float) -> PhaseError:
    """Return the phase error of a solution with given sums; the others are 0."""
    given = dict.fromkeys(PhaseSums._fields, 0.0) | {"opened": np.nan} | sums
    return PhaseError(scene, np.array([given[name] for name in PhaseSums._fields]))


def after_oscillating(scene: Scene, omega: float, turns: float, strain: float) -> PhaseError:
    """Return the phase error after an oscillation of one amplitude, over this phase in radians."""
    time = turns / omega
    return after(
        scene,
        time=time,
        velocity=1.0,
        acceleration=omega,
        largest_strain=strain,
        squared_strain=strain**2 * time / 2,
    )


LOAD: dict[str, Any] = {"gravity": 0.0, "top_load": 1e-2}
LONG = column(30, **LOAD)
EDGE = LONG.band_edge
STRIKE = struck(LONG, 1e-9, 100 / EDGE, 11)
TONE = STRIKE.replace(excitation=Force(grain=1, amplitude=1e-9, frequency=0.3 * EDGE / 2 / np.pi))
UNIT = {"displacement": 1.0, "velocity": 1.0}


def test_strains_of_an_oscillation_add_up_as_a_random_walk() -> None:
    """The walk has one step for each radian, from the first oscillation on."""
    for exponent, turns, strays in ((1.5, 50.0, 6.0), (2.5, 50.0, 3 * 6.0), (1.5, 0.02, 0.022)):
        scene = STRIKE.replace(chain=column(30, **LOAD, exponent=exponent))
        error = after_oscillating(scene, 0.4 * scene.chain.band_edge, turns, 1e-3)
        x = 0.15 * 0.5 * 1e-3 * strays
        assert error.strayed == pytest.approx(x, rel=1e-9)
        assert error.error == pytest.approx(x / (1 + x), rel=1e-9)
        assert error.at_most == pytest.approx(4 * x / (1 + x), rel=1e-9)


def test_no_wave_is_faster_than_the_chain() -> None:
    """Rounding may let accelerations of a still chain seem fast."""
    error, still = (
        after(STRIKE, time=1.0, velocity=1.0, acceleration=a * EDGE, squared_strain=1e-6)
        for a in (7.0, 1.0)
    )
    assert error.strayed == still.strayed > 0
    assert after(STRIKE, time=1.0, acceleration=EDGE, squared_strain=1e-6).strayed == 0.0


def test_hardening_contacts_shift_the_frequency_by_the_squared_strain() -> None:
    """The relative change of the mean stiffness of k (o + o^3 / L^2) is (r / L)^2."""
    law = Law("k*(o + o**3/L**2)", k=1e5, L=1e-6)
    chain = Chain(grains=20, diameter=1e-2, gravity=0.0, law=law, top="wall", bottom="wall")
    (length,) = set(chain.contacts.length.tolist())
    scene = struck(chain, 1e-9, 60 * chain.time_scale, 31)
    omega = 0.7 * chain.band_edge
    for turns, strain in ((30.0, 1e-2), (30.0, 2e-2), (60.0, 1e-2)):
        error = after_oscillating(scene, omega, turns, strain)
        assert error.detuned == pytest.approx((strain * length / 1e-6) ** 2 * turns / 4, rel=1e-6)
        assert error.scattered == error.detuned / (1 + error.detuned)
    assert after(scene, time=1.0, velocity=1.0, acceleration=omega).detuned == 0.0
    weak = scene.replace(excitation=Impulse(velocity=1e-4))
    radians = weak.linear_frequency * weak.duration
    change = (weak.linear_strain * length / 1e-6) ** 2
    assert model_error.expected_error(weak) == pytest.approx(change * radians / 2, rel=1e-6)
    # A viscous force is larger by |1 + i A omega|.
    damped = weak.replace(chain=chain.replace(damping={"viscoelastic": 2 / chain.band_edge}))
    factor = np.sqrt(5) * (damped.linear_strain / weak.linear_strain) ** 2
    ratio = model_error.expected_error(damped) / model_error.expected_error(weak)
    assert ratio == pytest.approx(factor, rel=1e-6)


@pytest.mark.parametrize("kind", ["short", "spread", "to the end", "separates", "forced", "few"])
def test_a_train_of_waves_steepens_as_long_as_it_travels(kind: str) -> None:
    chain = column(12, **LOAD) if kind == "few" else LONG
    hop = float(np.sqrt(chain.masses[0] / chain.linear_stiffness[0]))
    ratio = 0.9 if kind == "separates" else 0.2
    omega = ratio * chain.band_edge
    excitation: Any = Packet(frequency=omega / 2 / np.pi, width=2.0, grain=15, amplitude=1e-15)
    if kind in ("forced", "few"):
        excitation = Force(grain=1, amplitude=1e-9, frequency=omega / 2 / np.pi)
    scene = scene_of(chain, excitation, 1e-4, 11)
    strain = 1e-4
    time = {"short": 0.5 / omega, "spread": 10 * hop}.get(kind, 1e3 * hop)
    # The squared strain is that of a train that is at its largest all the time, or a quarter.
    spread = 4 if kind == "spread" else 1
    error = after(
        scene,
        time=time,
        velocity=1.0,
        acceleration=omega,
        largest_strain=strain,
        squared_strain=strain**2 * time / spread,
    )
    # The second harmonic falls behind at this rate until both packets are apart.
    apart = (1 + 2 * ratio * 2.0) / (omega * (1 - np.sqrt(1 - ratio**2)))
    lasts = {"short": time, "spread": time / 2, "separates": apart}.get(kind, 29 * hop)
    assert (apart < 29 * hop) == (kind == "separates")
    begun = min(1.0, omega * time)
    expected = 0.35 * 0.5 * strain * (begun + omega * lasts) * (kind != "few")
    assert error.steepens == pytest.approx(expected, rel=1e-9)
    assert error.estimate == pytest.approx(max(expected, error.scattered), rel=1e-12)
    assert error.at_most == pytest.approx(max(expected, 4 * error.scattered), rel=1e-12)


@pytest.mark.parametrize("field", ["displacement", "velocity"])
def test_forced_scenes_have_the_upper_bound_of_small_errors(field: str) -> None:
    """The error saturates, a bound is four times as large, and none is above a half."""
    for shift, bound, forced in (
        (1e-3, 4e-3 / 1.001, 4e-3 / 1.001),
        (5e-3, 0.02 / 1.005, 0.01),
        (0.02, 0.08 / 1.02, 0.02 / 1.02),
        (0.2, 1.0, 0.2 / 1.2),
    ):
        sums = {"displacement": 3.0, "velocity": 5.0}
        sums[f"{field}_error"] = shift * sums[field]
        strike, tone = (after(scene, **sums) for scene in (STRIKE, TONE))
        assert strike.shifted == pytest.approx(shift, rel=1e-12)
        assert strike.error == strike.estimate == pytest.approx(shift / (1 + shift), rel=1e-12)
        assert strike.at_most == tone.at_most == pytest.approx(bound, rel=1e-12)
        assert tone.error == pytest.approx(forced, rel=1e-12)
        assert strike.scale.tolist() == [3.0, 5.0]
    assert after(STRIKE).scale.tolist() == [np.inf, np.inf]


def test_contacts_that_open_or_may_open_add_to_the_error() -> None:
    pulled = after(STRIKE, velocity=2.0, velocity_error=0.02, pulled=0.6, opened=7.0)
    assert pulled.error == pytest.approx(0.01 / 1.01 + 0.3, rel=1e-12)
    assert after(STRIKE, velocity=2.0, pulled=4.0, opened=7.0).error == 1.0
    assert pulled.at_most == 1.0
    assert pulled.remark == "not linear here: contact 7 opens"
    wild = STRIKE.replace(
        excitation=Impulse(velocity=1.01e-9 / STRIKE.linear_strain), duration=1e7 / EDGE
    )
    unknown = after(wild, **UNIT)
    assert (unknown.error, unknown.at_most) == (1.0, 1.0)
    assert unknown.remark.startswith("contacts may open: the run is too long")
    calm = after(STRIKE.replace(duration=1e7 / EDGE), **UNIT)
    assert (calm.error, calm.at_most, calm.remark) == (0.0, 0.0, "")


def test_resonance_of_few_grains_is_relative_to_the_motion() -> None:
    scene = struck(column(4, **LOAD), 1e-6, 1e-3, 3)
    length, speed = model_error.Resonance(scene).motion(3e-5)
    assert length > 0
    for sums in ({"displacement": 100 * length}, {"velocity": 100 * speed}):
        error = after(scene, time=3e-5, **sums)
        assert error.resonant == pytest.approx(0.01, rel=1e-12)
        assert error.error == pytest.approx(0.01 / 1.01, rel=1e-12)


@pytest.mark.parametrize(
    ("strength", "phase", "opens"),
    # A contact counts as open below 0.01 of its overlap. A motion that turns within 0.3 rad after
    # the last evaluation is followed to its extreme.
    [(1.2, np.arcsin(0.985 / 1.2), False), (1.2, np.arcsin(0.995 / 1.2), True),
     (1.02, np.pi / 2 - 0.28, True), (1.02, np.pi / 2 - 0.31, False)],
)  # fmt: skip
def test_openings_are_seen_between_evaluations(strength: float, phase: float, opens: bool) -> None:
    chain = column(2, **LOAD, exponent=1.0, bottom="fixed")
    omega = chain.band_edge
    speed = -strength * omega * chain.equilibrium_overlap[0]
    scene = struck(chain, float(speed), float(phase / omega), 3)
    assert model_error.may_open(scene)
    assert bool(Modes().look(scene).remark) == opens


@pytest.mark.parametrize("detune", [None, 0.37, 1 + 1e-6, 1.3])
@pytest.mark.parametrize(("top", "exponent"), [("free", 1.5), ("wall", 2.3)])
def test_all_pairs_of_waves_are_in_resonance(
    top: str, exponent: float, detune: float | None
) -> None:
    """All pairs of free waves, and of the steady wave of a drive, force all modes.

    A contact of stiffness k and overlap D has the force k s + k (delta - 1) s^2 / (2 D), s how much
    closer it is.
    """
    chain = column(4, gravity=5.0, top_load=1e-3, exponent=exponent, bottom="wall",
                   top=top if detune is None else "free",
                   masses=np.array([2.0, 1.0, 3.0, 1.5]) * 1e-6)  # fmt: skip
    first = 0 if detune is None else 1
    k = chain.contacts.stiffness[first:]
    mass = chain.masses[first:]
    matrix = np.diag(k[:-1] + k[1:]) - np.diag(k[1:-1], 1) - np.diag(k[1:-1], -1)
    squares, vectors = np.linalg.eigh(matrix / np.sqrt(np.outer(mass, mass)))
    w = np.sqrt(squares)
    shape = vectors / np.sqrt(mass)[:, None]
    squeezed = -np.diff(shape, axis=0, prepend=0.0, append=0.0)
    frequencies = w
    if detune is None:
        scene = scene_of(chain, stirred(chain, 1e-7, 1e-12), 40 / w[0], 9)
        u, v = (shape.T @ (mass * x) for x in scene.initial())
        waves = (squeezed * np.hypot(u, v / w)).T
    else:
        omega = detune * w[1]
        scene = scene_of(chain, Drive(amplitude=1e-12, frequency=omega / 2 / np.pi), 40 / w[0], 9)
        # Each mode solves q'' + w^2 q = f sin(omega t) from rest; the duration limits resonance.
        apart = w**2 - omega**2
        limit = w / scene.duration
        steady = k[0] * 1e-12 * shape[0] / np.where(np.abs(apart) < limit, -limit, apart)
        moved = squeezed @ steady + 1e-12 * np.array([1.0, 0, 0, 0])
        waves = np.array([*(squeezed * np.abs(steady * omega / w)).T, moved])
        frequencies = np.append(w, omega)
    overlap = np.where(chain.contacts.pressed, chain.contacts.overlap, np.inf)[first:]
    curvature = (exponent - 1) * k / overlap
    for time in (0.5 / w[0], 30 / w[0]):
        squared = np.zeros(w.size)
        for a, one in zip(frequencies, waves, strict=True):
            for b, other in zip(frequencies, waves, strict=True):
                force = np.abs((curvature * one * other) @ squeezed) / 2
                for beat in (a + b, abs(a - b)):
                    off = np.maximum(np.abs(beat - w), 1e-300)
                    squared += 2 * (force / 2 * np.minimum(time, 2 / off) / (2 * w)) ** 2
        expected = np.sqrt([(shape**2 @ squared).max(), (shape**2 @ (squared * w**2)).max()])
        found = model_error.Resonance(scene).motion(float(time))
        np.testing.assert_allclose(found, expected, rtol=1e-6, atol=0)


def test_few_grains_have_more_evaluations() -> None:
    """Two in a radian, but at least 64, and at most 1024 divided by the number of grains."""
    for grains, radians, even in ((4, 10.0, 64), (4, 100.0, 200), (4, 1e4, 256), (200, 1e4, 64)):
        chain = column(grains, **LOAD)
        scene = struck(chain, 1e-12, (radians - 1e-6) / chain.band_edge, 2)
        early = int(np.log(radians / 0.5) / np.log(1.25)) + 1
        assert model_error.evaluations(scene) == even + early
        assert model_error.evaluation_times(scene).size == even + early
    # A run of less than half a radian has no early times.
    brief = scene.replace(duration=0.3 / chain.band_edge)
    assert model_error.evaluations(brief) == 64


WAVES: dict[str, tuple[str, Any]] = {
    "strike": ("free", Impulse(velocity=1e-9, grain=20)),
    "top": ("free", Impulse(velocity=1e-9)),
    "drive": ("free", Drive(amplitude=1e-15, frequency=0.2 * EDGE / 2 / np.pi)),
    "wall": ("wall", Drive(grain=0, amplitude=1e-15, frequency=0.2 * EDGE / 2 / np.pi)),
}


@pytest.mark.parametrize("kind", WAVES)
def test_linear_engines_have_equal_sums_and_continue_from_a_state(
    kind: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A propagator computes the reached grains only, below a moving wall that is one more body."""
    top, excitation = WAVES[kind]
    scene = scene_of(column(60, **LOAD, top=top), excitation, 30 / EDGE, 41)
    modes, series = (engine.look(scene) for engine in (Modes(), Chebyshev()))
    for name in PhaseSums._fields:
        one, other = getattr(modes.sums, name), getattr(series.sums, name)
        assert other == pytest.approx(one, rel=1e-7, abs=0, nan_ok=True), name
    monkeypatch.setattr(linear, "BLOCK", 4)
    monkeypatch.setattr(linear, "SMALL_BLOCK", 4)
    for engine in (Modes(), Chebyshev()):
        proposal = engine.propose(scene, 1e-6)
        run = engine.start([scene], proposal)
        velocity = [block.velocity for block in run.blocks()]
        broken = engine.start([scene], proposal)
        blocks = broken.blocks()
        begun = [next(blocks).velocity, next(blocks).velocity]
        rest = engine.start([scene], proposal, broken.state())
        again = [*begun, *(block.velocity for block in rest.blocks())]
        assert len(again) > 5
        assert all(np.array_equal(*pair) for pair in zip(velocity, again, strict=True))
        assert rest.errors()[0][:6] == run.errors()[0][:6]


@pytest.mark.parametrize("engine", ["modes", "chebyshev"])
def test_opposite_waves_of_a_strike_inside_a_chain_do_not_hide_their_shifts(engine: str) -> None:
    """Rounding decides which of the two strains is larger; estimates were 2.4 times too low."""
    chain = column(400, **LOAD)
    strike = Impulse(velocity=1e-2 * chain.length_scale / chain.time_scale, grain=200)
    scene = scene_of(chain, strike, 180 * chain.time_scale, 21)
    t = simulate(scene, engine, 0.99)
    error = distance(t, simulate(scene, "native", 1e-6))
    assert error / 1.5 < t.error_estimate.model < 1.5 * error
