"""Measured shocks, compared with theory and with the conservation of mass and momentum."""

from dataclasses import astuple, replace
from functools import cache
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from helpers.changed_recordings import until
from helpers.example_scenes import run

from lmpchain import Chain, Damping, Drive, Force, Impulse, InputError, Riemann, Trajectory
from lmpchain.measure import shock
from lmpchain.theory.shock import Medium, State

CHAIN = Chain(
    grains=300,
    material="steel",
    diameter=9.5e-3,
    gravity=0.0,
    top_load=10.0,
    top="wall",
    bottom="wall",
)
OVERLAP = float(CHAIN.contacts.overlap[1])
SOUND = float(np.sqrt(CHAIN.contacts.stiffness[1] / CHAIN.masses[1]))  # Grains/s.
GAS = Medium(1.5, float(CHAIN.contacts.constant[1]), float(CHAIN.masses[1]))
REST = State(0.0, OVERLAP)


@cache
def piston(velocity: float, grains: int = 300, viscosity: float = 0.0) -> Trajectory:
    """Simulate a piston until the shock is near grain N.

    The velocity of the piston is in units of sound speed times overlap.
    """
    damping = Damping(viscoelastic=viscosity / SOUND) if viscosity else None
    chain = CHAIN.replace(grains=grains, damping=damping)
    speed = velocity * OVERLAP * SOUND
    drive = Drive(shape="piston", velocity=speed, rise=10 / SOUND, grain=0)
    front = GAS.rankine_hugoniot(REST, speed)[1] if speed > 0 else SOUND
    return run(chain, drive, grains / front, 4 * grains + 1, 1e-6)


@cache
def measured(velocity: float, viscosity: float = 0.0) -> shock.Shock:
    """Return the measured wave of this piston."""
    return shock.find(piston(velocity, viscosity=viscosity))


@pytest.mark.parametrize("velocity", [0.5, 1.0])
def test_edges_of_a_dispersive_shock(velocity: float) -> None:
    """Plateau and edges agree with Whitham's theory within the age of the run."""
    found = measured(velocity)
    assert found.kind == "dispersive shock"
    assert found.behind.velocity == pytest.approx(velocity * OVERLAP * SOUND, rel=1e-4)
    assert found.behind.overlap == pytest.approx(found.simple.overlap, rel=3e-4)
    theory = found.predictions["whitham"]
    assert abs(found.leading.speed - theory.leading) < 2 * found.leading.error
    assert abs(found.trailing.speed - theory.trailing) < 3 * found.trailing.error
    assert found.leading.height == pytest.approx(theory.height, rel=0.1)
    # The crest is a solitary wave on the state ahead.
    assert found.leading.speed == pytest.approx(found.solitary, rel=2e-3)
    assert found.leading.error < 5e-3 * SOUND
    assert found.leading.height_error < 0.1 * found.leading.height
    assert found.trailing.error < 0.05 * SOUND
    assert found.behind_error.overlap < 1e-3 * (found.behind.overlap - OVERLAP)
    assert found.behind_error.velocity < 1e-3 * found.behind.velocity
    # A sudden piston would have begun halfway through the rise.
    assert found.start == pytest.approx(5 / SOUND, rel=1e-9)
    assert (found.source, found.downward) == (1, True)


@pytest.mark.parametrize(("velocity", "viscosity"), [(1.0, 0.0), (0.3, 0.3), (-0.4, 0.0)])
def test_results_do_not_depend_on_the_frame(velocity: float, viscosity: float) -> None:
    """A chain that moves as a whole has other velocities ahead and behind, and no other results."""
    t = piston(velocity, viscosity=viscosity)
    drift = 2 * OVERLAP * SOUND
    moved = replace(
        t, velocity=t.velocity + drift, displacement=t.displacement + drift * t.time[:, None]
    )
    still, found = measured(velocity, viscosity), shock.find(moved)
    for one, other in ((still.ahead, found.ahead), (still.behind, found.behind)):
        assert other.velocity - one.velocity == pytest.approx(drift, rel=1e-12)
        assert other.overlap == pytest.approx(one.overlap, rel=1e-9)
    for one, other in ((still.leading, found.leading), (still.trailing, found.trailing)):
        assert astuple(other) == pytest.approx(astuple(one), rel=1e-6, nan_ok=True)
    for key in ("thickness", "mass_speed", "momentum_speed", "solitary", "time", "start"):
        assert getattr(found, key) == pytest.approx(getattr(still, key), rel=1e-7, nan_ok=True)
    for key, edges in still.predictions.items():
        assert found.predictions[key] == pytest.approx(edges, rel=1e-7, nan_ok=True)
    jump = still.behind.velocity - still.ahead.velocity
    if velocity < 0:
        assert (still.kind, still.leading.velocity) == ("rarefaction", jump)
    else:
        assert still.leading.velocity > 0.9 * jump


def test_a_force_on_a_grain_sends_a_shock_and_a_rarefaction() -> None:
    """Behind both waves the grains move together, and the forces differ by the applied force."""
    push = Force(grain=60, times=[0, 10 / SOUND, 1.0], force=[0, 5, 5], interpolation="linear")
    t = long_run(CHAIN.replace(grains=120), push, 100)
    down, up = (shock.find(t, direction) for direction in ("down", "up"))
    assert (down.kind, down.source, down.downward) == ("dispersive shock", 60, True)
    assert (up.kind, up.source, up.downward) == ("rarefaction", 59, False)
    assert down.behind.velocity == pytest.approx(-up.behind.velocity, rel=1e-3)
    given = GAS.force(down.behind.overlap) - GAS.force(up.behind.overlap)
    assert given == pytest.approx(5, rel=1e-3)
    for found in (down, up):
        assert found.start == pytest.approx(5 / SOUND, rel=1e-9)


def test_a_piston_from_below_sends_the_mirror_image() -> None:
    """A piston that moves upward at the bottom gives the same results as one at the top."""
    chain = CHAIN.replace(grains=120)
    motion = {"shape": "piston", "rise": 10 / SOUND}
    bottom = long_run(chain, Drive(velocity=-0.07, end="bottom", **motion), 110)
    top = long_run(chain, Drive(velocity=0.07, grain=0, **motion), 110)
    up, down = shock.find(bottom, "up"), shock.find(top)
    assert (up.source, up.downward, down.source) == (119, False, 1)
    assert up.contact.tolist() == down.contact.tolist()[::-1]
    assert up.overlap == pytest.approx(down.overlap, rel=1e-7)
    for one, other in ((up.leading, down.leading), (up.trailing, down.trailing)):
        assert astuple(one) == pytest.approx(astuple(other), rel=1e-6, nan_ok=True)
    with pytest.raises(InputError, match='direction: must be "up": the drive acts at the bottom'):
        shock.find(bottom)


@pytest.mark.parametrize(
    ("share", "message"),
    [
        (0.2, r"duration: \d+ contacts show the whole front, fewer than 24: record longer"),
        (0.1, "duration: the wave has passed 23 contacts, fewer than 24: record longer$"),
    ],
)
def test_a_young_steady_shock_is_rejected(share: float, message: str) -> None:
    """A front that has not passed enough contacts as a whole has no speed yet."""
    whole = piston(0.3, viscosity=0.3)
    with pytest.raises(InputError, match=message):
        shock.find(until(whole, share * whole.time[-1]))


def test_the_weakest_shocks_have_edges() -> None:
    """Below the slowest computed solitary wave, the speed of the crest is NaN."""
    found = shock.find(piston(1e-5))
    assert np.isnan(found.solitary)
    assert found.leading.speed == pytest.approx(SOUND, rel=0.01)


def test_piston_in_a_sonic_vacuum() -> None:
    """The leading wave is the exact solitary wave, with twice the velocity of the piston."""
    chain = CHAIN.replace(grains=200, top_load=0.0)
    drive = Drive(shape="piston", velocity=0.05, rise=1e-4, grain=0)
    found = shock.find(run(chain, drive, 3e-3, 901, 1e-5))
    assert found.leading.velocity == pytest.approx(2 * 0.05, rel=0.01)
    assert found.leading.speed == pytest.approx(found.solitary, rel=1e-3)
    assert found.behind.overlap == pytest.approx(found.rankine_hugoniot[0].overlap, rel=0.01)
    assert np.isnan(found.trailing.speed)


def test_steady_shock_of_a_damped_chain() -> None:
    """The speed agrees with Rankine and Hugoniot, and the thickness roughly with Burgers."""
    found = measured(0.3, 0.3)
    theory, speed = found.rankine_hugoniot
    assert found.kind == "steady shock"
    assert found.leading.speed == pytest.approx(speed, rel=5e-4)
    assert found.behind.overlap == pytest.approx(theory.overlap, rel=1e-4)
    assert found.thickness == pytest.approx(found.predictions["burgers"].height, rel=0.25)
    # Mass and momentum are both conserved, and the front is the same on both edges.
    assert found.mass_speed == pytest.approx(speed, rel=5e-4)
    assert found.momentum_speed == pytest.approx(speed, rel=5e-4)
    assert found.trailing == found.leading


def given_wave(
    chain: Chain, drive: Drive, time: np.ndarray, nearer: np.ndarray, velocity: np.ndarray
) -> Any:
    """Return a run with these changes of overlaps, (T, N-1); times are those of sound per grain."""
    return SimpleNamespace(
        scene=SimpleNamespace(chain=chain, excitation=drive),
        time=time / SOUND,
        displacement=np.pad(nearer[:, ::-1].cumsum(1)[:, ::-1], ((0, 0), (0, 1))),
        velocity=velocity,
        grains=np.arange(1, chain.grains + 1),
    )


def test_speed_and_error_of_a_front_that_slows_down() -> None:
    """The speed is that of the later half of the passages, and the error contains its change."""
    width, jump, slowing = 1.5, 0.2 * OVERLAP, 1e-3
    chain = CHAIN.replace(grains=120, damping=Damping(viscoelastic=0.3 / SOUND))
    drive = Drive(shape="piston", velocity=0.3 * OVERLAP * SOUND, rise=1e-9 / SOUND, grain=0)
    time = np.linspace(0, 70, 701)
    place = 1.5 * time - slowing * time**2 - 10
    pace = 1.5 - 2 * slowing * time
    numbers = np.arange(1, 120)
    shape = np.tanh((place[:, None] - numbers) / width)
    nearer = jump * (1 + shape) / 2
    closing = SOUND * jump * (1 - shape**2) / 2 / width * pace[:, None]
    v = np.pad(closing[:, ::-1].cumsum(1)[:, ::-1], ((0, 0), (0, 1)))
    found = shock.find(given_wave(chain, drive, time, nearer, v))
    # Contacts from half of the way to the last that has 95 % of the jump.
    last = np.floor(place[-1] - width * np.arctanh(0.9))
    passed = np.arange(np.floor(place[-1] - 1) // 2 + 1, last)
    passage = (1.5 - np.sqrt(1.5**2 - 4 * slowing * (passed + 10))) / 2 / slowing
    half = passed.size // 2
    early, late = (
        np.polyfit(passage[part], passed[part], 1, cov=True)
        for part in (slice(half), slice(half, None))
    )
    speed = SOUND * late[0][0]
    error = SOUND * (2 * np.sqrt(late[1][0, 0]) + early[0][0] - late[0][0])
    assert found.leading.speed == pytest.approx(speed, rel=1e-6)
    assert found.leading.error == pytest.approx(error, rel=1e-4)
    height = jump * (1 + np.tanh((place[-1] - passed[-1]) / width)) / 2
    assert found.leading.height == pytest.approx(height, rel=1e-6)
    spread = found.behind_error.overlap
    assert found.leading.height_error == pytest.approx(jump - height + spread, rel=1e-4)
    assert found.leading.velocity == pytest.approx(v[:, int(passed[-1]) - 1].max(), rel=1e-9)
    local = np.interp(passage[-1], time, pace)
    assert found.thickness == pytest.approx(2 * width * late[0][0] / local, rel=1e-3)
    assert found.mass_speed == pytest.approx(found.behind.velocity / jump, rel=1e-4)


@pytest.mark.parametrize("direction", ["down", "up"])
def test_a_rarefaction_agrees_with_the_method_of_characteristics(direction: str) -> None:
    """A step to lower compression widens at the two speeds of sound, in both directions."""
    less = -0.5 * OVERLAP / 9.5e-3
    down = direction == "down"
    strain = (less, 0) if down else (0, less)
    grain = 250 if down else 150
    chain = CHAIN.replace(grains=400, top="free")
    step = Riemann(velocity=(0, 0), strain=strain, grain=grain)
    found = shock.find(run(chain, step, 150 / SOUND, 601, 1e-5), direction)
    assert found.kind == "rarefaction"
    sides = State(0, OVERLAP), State(0, OVERLAP / 2)
    between = GAS.between(*sides)
    assert found.behind.overlap == pytest.approx(between.overlap, rel=2e-3)
    away = abs(found.leading.height - (between.overlap - OVERLAP))
    assert away < found.leading.height_error < 0.02 * OVERLAP
    theory = found.predictions["continuum"]
    for edge, speed in ((found.leading, theory.leading), (found.trailing, theory.trailing)):
        assert abs(edge.speed - speed) < 2 * edge.error
        assert edge.speed == pytest.approx(speed, rel=0.03)


@pytest.mark.parametrize(
    ("velocity", "strain", "direction", "contacts"),
    [
        ((0.07, 0), (0, 0), "down", 60),
        ((0.07, 0), (0, 0), "up", 30),
        ((0, -0.07), (0, 0), "up", 60),
        ((0, 0), (2e-5, 0), "down", 60),
        ((0, 0), (0, 2e-5), "up", 60),
    ],
)
def test_a_step_is_used_until_waves_from_the_ends_may_arrive(
    velocity: tuple[float, float], strain: tuple[float, float], direction: str, contacts: int
) -> None:
    """A wave from the end behind the step, 60 contacts away, is no faster than the fastest sound.

    If the chain ahead does not rest, a wave from the end ahead meets the wave halfway.
    """
    step = Riemann(velocity=velocity, strain=strain, grain=60)
    found = shock.find(long_run(CHAIN.replace(grains=120, top="free"), step, 100), direction)
    fastest = GAS.sound(float(found.overlap_then.max()))
    assert 0.93 * contacts < found.time * fastest <= contacts


def test_halves_that_collide_send_two_shocks_of_a_piston() -> None:
    """Both waves have the edges of a piston of half the velocity, after half the time upward."""
    step = Riemann(velocity=(0.14, 0), strain=(0, 0), grain=150)
    t = long_run(CHAIN.replace(top="free"), step, 150)
    for direction in ("down", "up"):
        found = shock.find(t, direction)
        given = found.behind.velocity - found.ahead.velocity
        assert given == pytest.approx(0.07, rel=1e-3)
        theory = found.predictions["whitham"]
        assert abs(found.leading.speed - theory.leading) < 2 * found.leading.error < 0.02 * SOUND
        assert abs(found.trailing.speed - theory.trailing) < found.trailing.error < 0.65 * SOUND
        apart = (found.leading.speed - found.trailing.speed) * (found.time - found.start)
        assert found.thickness == pytest.approx(apart, rel=1e-9)


def long_run(
    chain: Chain, excitation: Drive | Riemann | Force | Impulse, duration: float
) -> Trajectory:
    """Simulate a scene for a number of sound times from grain to grain, with 4 samples each.

    In a sonic vacuum the times are those of the loaded chain.
    """
    return run(chain, excitation, duration / SOUND, 4 * int(duration) + 1, 1e-4)


@pytest.mark.parametrize(
    ("step", "direction"), [(None, "down"), (-0.118, "down"), (-0.118, "up"), (-0.2, "down")]
)
def test_rarefaction_that_opens_contacts(step: float | None, direction: str) -> None:
    """The trailing edge stays at the step, and grains fly at -4/5 c o.

    Ahead of them v - 4/5 c o is the same everywhere. A withdrawal, or a step by more than twice
    that velocity, 0.1171 m/s, opens contacts on both sides. The last contact that is open travels
    as t^(5/7), slower and slower: grain n opens with a relative velocity of n^-3 that is left of
    the first times, where that of the fan is n^4 / t^5.
    """
    escape = 0.8 * SOUND * OVERLAP
    if step is None:
        pull = Drive(shape="piston", velocity=-0.1, rise=10 / SOUND, grain=0)
        trajectory = long_run(CHAIN, pull, 300)
    else:
        pull = Riemann(velocity=(step, 0), strain=(0, 0), grain=200)
        trajectory = long_run(CHAIN.replace(grains=400, top="free"), pull, 150)
    found = shock.find(trajectory, direction)
    assert found.kind == "rarefaction"
    assert abs(found.trailing.speed) < 2 * found.trailing.error < 0.015 * SOUND
    assert abs(found.leading.speed - SOUND) < 2 * found.leading.error < 0.015 * SOUND
    assert found.behind.overlap == 0
    assert found.leading.height == -OVERLAP
    assert found.ahead.velocity - found.behind.velocity == pytest.approx(escape, rel=8e-3)
    assert found.ahead.velocity - found.simple.velocity == pytest.approx(escape, rel=1e-9)
    assert found.predictions["continuum"] == pytest.approx((SOUND, 0.0, -OVERLAP))
    assert (found.overlap >= 0).all()


@pytest.mark.parametrize("case", ["vacuum", "damped", "rarefaction", "opened", "step"])
def test_a_long_recording_gives_the_same_result(case: str) -> None:
    """Edges do not depend on samples after waves from the ends have arrived."""
    chain = CHAIN.replace(grains=120)
    velocity = {"rarefaction": -0.03, "opened": -0.1, "damped": 0.03}.get(case, 0.07)
    push = Drive(shape="piston", velocity=velocity, rise=10 / SOUND, grain=0)
    if case == "vacuum":
        chain = chain.replace(top_load=0.0)
    elif case == "damped":
        chain = chain.replace(damping=Damping(viscoelastic=0.3 / SOUND))
    elif case == "step":
        chain = chain.replace(top="free")
        push = Riemann(velocity=(0.07, 0), strain=(0, 0), grain=60)
    long = long_run(chain, push, 600 if case != "vacuum" else 320)
    found = shock.find(long)
    short = until(long, found.time)
    again = shock.find(short)
    assert short.time.size < 0.7 * long.time.size
    for edge in ("leading", "trailing"):
        one, other = (getattr(wave, edge) for wave in (found, again))
        assert other.speed == pytest.approx(one.speed, rel=1e-9, nan_ok=True)
    # A returning wave would have changed the plateau by as much as the jump.
    jump = found.behind.overlap - found.ahead.overlap
    assert found.behind.overlap == pytest.approx(found.simple.overlap, abs=0.02 * abs(jump))


@pytest.mark.parametrize(
    ("excitation", "message"),
    [
        (Drive(shape="piston", velocity=0.07, rise=1.0, grain=0), "excitation.rise: 1 s is more"),
        (Drive(shape="piston", velocity=0.07, rise=3e-3, grain=0), "excitation.rise: 0.003 s is"),
        (Drive(shape="piston", velocity=0.07, rise=1.2e-3, grain=0), "let the push rise faster"),
        (Impulse(velocity=0.1), "does not push steadily"),
        (Drive(amplitude=1e-6, frequency=2e3, cycles=3, grain=0), "does not push steadily"),
        (Drive(amplitude=1e-6, frequency=2e3, grain=0), "does not push steadily"),
        (Force(shape="half-sine", amplitude=10.0, duration=3e-4), "does not push steadily"),
        (Force(times=[0, 0.01], force=[0, 100], interpolation="linear"), "does not push steadily"),
        (Riemann(velocity=(0, 0), strain=(0, 0), grain=75), "sends no wave"),
        (Riemann(velocity=(0, 0), strain=(0, -2e-4), grain=75), "opens the contacts ahead"),
        (Riemann(velocity=(0.1, 0), strain=(0, 0), grain=20), "step further from its ends"),
        (Riemann(velocity=(0.1, 0), strain=(0, 0), grain=149), "direction: there are no grains"),
    ],
)
def test_a_transient_push_is_rejected_with_its_reason(excitation: Drive, message: str) -> None:
    """A pulse, or a rise as long as the run, is rejected with its reason."""
    with pytest.raises(InputError, match=message) as caught:
        shock.find(long_run(CHAIN.replace(grains=150, top="wall"), excitation, 150))
    assert not str(caught.value).endswith(": record longer")


def test_a_direction_without_a_wave_is_rejected() -> None:
    """A piston at the top sends no wave up, however long the record is."""
    with pytest.raises(InputError, match='direction: must be "down"'):
        shock.find(piston(1.0), "up")


def test_a_column_is_rejected() -> None:
    t = run(CHAIN.replace(grains=30, gravity=9.81), Impulse(velocity=1e-3), 1e-4)
    with pytest.raises(InputError, match="chain: measuring a shock requires no gravity"):
        shock.find(t)


def test_picture_names_edges_and_plateaus() -> None:
    """Every line of the picture has a name, and the axes have units."""
    found = measured(1.0)
    ax = found.plot()
    assert (ax.get_xlabel(), ax.get_ylabel()) == ("contact, from the top", "overlap")
    lines = {line.get_label(): line for line in ax.lines}
    assert np.array_equal(lines["overlap"].get_xydata().T, [found.contact, found.overlap])
    assert lines["plateau ahead"].get_ydata() == [found.ahead.overlap] * 2
    assert lines["plateau behind"].get_ydata() == [found.behind.overlap] * 2
    theory = found.predictions["whitham"]
    for name in ("leading", "trailing"):
        edge = getattr(found, name)
        speeds = {
            f"{edge.speed:.5g} ± {float(f'{edge.error:.1g}'):g}": edge.speed,
            f"Whitham: {getattr(theory, name):.5g}": getattr(theory, name),
        }
        for words, speed in speeds.items():
            (place,) = (
                line.get_xdata()[0]
                for label, line in lines.items()
                if label.startswith(f"{name} edge") and label.endswith(f"{words} grains/s")
            )
            assert place == pytest.approx(1 + speed * (found.time - found.start), rel=1e-9)


@pytest.mark.parametrize("direction", ["down", "up"])
def test_map_has_the_same_edges_and_names_the_plateaus(direction: str) -> None:
    """Lines run from the source of the wave to the final position of an edge."""
    step = Riemann(
        velocity=(0, 0), strain=(2e-5, 0) if direction == "down" else (0, 2e-5), grain=150
    )
    chain = CHAIN.replace(top="free")
    found = shock.find(run(chain, step, 110 / SOUND, 441, 1e-5), direction)
    ax = found.plot_map()
    line = ax.get_lines()[0]
    assert line.get_label() == f"leading edge: {found.leading.speed:.5g} grains/s"
    assert line.get_xydata()[0].tolist() == [150, 0]
    assert (found.source, found.start) == (150, 0)
    slope = np.diff(line.get_xdata()) / np.diff(line.get_ydata())
    assert slope == pytest.approx((1 if direction == "down" else -1) * found.leading.speed)
    words = [text.get_text() for text in ax.texts]
    assert [word.split(":")[0] for word in words] == ["behind", "ahead"]
    # The wave moves away from the state behind it.
    left = [text.get_position()[0] < 0.5 for text in ax.texts]
    assert left == [direction == "down", direction == "up"]
    assert ax.get_xlim() == (found.contact.min() - 0.5, found.contact.max() + 0.5)
    assert ax.get_ylim() == (0.0, found.time)


def test_edges_of_a_given_dispersive_wave() -> None:
    """Half amplitudes s at n / t = 1 + 0.3 s + 0.1 s^2 - 6 / n have edges at 1 - 6 / n and 1.4."""
    size, wavenumber, jump = 300, 2.0, 0.2 * OVERLAP
    time = np.linspace(0, 200, 4001)
    n = np.arange(size - 1)
    past = np.maximum(n / np.maximum(time, 1e-9)[:, None] + 6 / (n + 1) - 1, 0.0)
    share = np.minimum(np.sqrt(2.25 + 10 * past) - 1.5, 1 + 1e-4 * n)
    behind = 1.4 * time[:, None] - n
    nearer = jump * np.where(behind > 0, 1 - share * np.cos(wavenumber * behind), 0.0)
    drive = Drive(shape="piston", velocity=jump * SOUND, rise=1e-9 / SOUND, grain=0)
    v = np.pad(SOUND * nearer, ((0, 0), (0, 1)))
    found = shock.find(given_wave(CHAIN, drive, time, nearer, v))
    assert found.leading.speed == pytest.approx(1.4 * SOUND, rel=5e-4)
    assert found.leading.error < 1e-3 * SOUND
    reached = int(np.flatnonzero(nearer[-1] > jump / 2)[-1])
    crests = jump * (2 + 1e-4 * np.arange(reached // 3, reached - 5))
    half = crests.size // 2
    late = crests[half:].mean()
    assert found.leading.height == pytest.approx(late, rel=1e-4)
    change = late - crests[:half].mean()
    assert found.leading.height_error == pytest.approx(change, rel=0.05)
    last = crests[-(crests.size // 3) :].mean()
    assert found.leading.velocity == pytest.approx(SOUND * last, rel=1e-4)
    # The contacts at which most half amplitudes from 0.1 to 0.5 have passed.
    contacts = np.unique(np.linspace(0.2 * reached, 0.85 * reached, 40).astype(int))
    ends = 1 - 6 / (1 + contacts[share[-1, contacts] < 0.3])
    half = ends.size // 2
    late, early = ends[half:].mean(), ends[:half].mean()
    assert found.trailing.speed == pytest.approx(SOUND * late, abs=5e-4 * SOUND)
    # A line instead of the parabola ends lower by 0.1 (0.3^2 - 0.4^2 / 12).
    straight = ends.mean() - 0.1 * (0.3**2 - 0.4**2 / 12)
    error = late - early + late - straight + 2 * ends[half:].std()
    assert found.trailing.error == pytest.approx(SOUND * error, rel=0.05)
    assert found.behind.overlap - OVERLAP == pytest.approx(jump, rel=1e-3)
    apart = (found.leading.speed - found.trailing.speed) * found.time
    assert found.thickness == pytest.approx(apart, rel=1e-6)
