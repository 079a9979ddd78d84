"""Shocks, dispersive shocks and rarefactions: edges, plateaus, and theoretical predictions."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar, Literal, NamedTuple

import numpy as np
from scipy import stats
from scipy.interpolate import CubicSpline

from ..errors import InputError
from ..scene.acting import Drive, Force
from ..scene.base import Excitation
from ..scene.excitation import Riemann
from ..scene.scene import Scene
from ..theory.shock import Edges, Medium, State
from ..theory.soliton import solve, struck
from ..trajectory.trajectory import Trajectory
from ..util.arrays import Array
from ..util.lazy import listed
from ..util.notebook import Shown
from ..util.plotting import (
    Axes,
    chart,
    choose_few,
    colour_bar,
    finish,
    prefixed,
)
from ..util.plotting import edges as cell_edges
from ..util.tabular import Tabular
from .crests import first_crests, first_passages

__dir__ = listed(__name__)

Kind = Literal["dispersive shock", "steady shock", "rarefaction"]
END_CONTACTS = 5  # Number of contacts at an end where a wave meets its reflection.
FEWEST = 24  # Smallest number of contacts that the leading edge must pass.
OSCILLATIONS = (0.1, 0.5)  # Half amplitudes over the jump.
FEWEST_OSCILLATIONS = 6  # Smallest number of extremes for fitting a parabola.
DRAWN_MOMENTS = 400  # Number of times stored for a picture.
EDGE_COLOURS = {"leading": "#D55E00", "trailing": "#0072B2"}  # Colours of edges.
# Authors of the theories in `predictions`, shown in legends.
AUTHORS = {
    "whitham": "Whitham",
    "toda": "Toda",
    "kdv": "Korteweg and de Vries",
    "burgers": "Burgers",
}
# The leading crest of a dispersive shock is at least this many jumps of the overlap high.
CREST = 1.05
# Conditions for a steady push. LASTING is the smallest final change of the overlap near the source,
# relative to its largest change. STEADY_PUSH is the largest relative change from the third quarter
# of the time to the fourth.
LASTING = 0.2
STEADY_PUSH = 0.1
STEADY = 0.95  # Fraction of the jump that the last contact of a steady shock must have reached.


@dataclass(frozen=True)
class Edge:
    """An edge of a wave.

    Attributes
    ----------
    speed : float
        Speed of the edge, grains/s; NaN if the wave has no such edge.
    error : float
        Uncertainty of the speed, grains/s: the scatter, and the change between the earlier and the
        later half of the measurements.
    height, height_error : float
        Overlap in the leading crest minus the overlap ahead, m, and the change of this height along
        the way; NaN for a separate trailing edge. Without a crest, the error is the variation of
        the plateau and the part of the jump that is still missing.
    velocity : float
        Velocity of grains in the leading crest minus the velocity ahead, m/s.
    """

    speed: float
    error: float
    height: float = np.nan
    height_error: float = np.nan
    velocity: float = np.nan


@dataclass(frozen=True, eq=False, repr=False)
class Shock(Shown, Tabular):
    """A shock or a rarefaction, with its theoretical predictions; see `lmpchain.theory.shock`.

    Velocities are positive in the direction of travel. Overlaps include the overlap at rest; open
    contacts have the overlap 0.

    Attributes
    ----------
    kind : str
        "dispersive shock" without damping, "steady shock" with damping, or "rarefaction".
    ahead, behind : State
        Velocity, m/s, and overlap, m, ahead of the wave, and their means in the plateau behind it.
    behind_error : State
        Variation of the plateau: twice the standard deviation of velocity and overlap.
    leading, trailing : Edge
        Edges of the wave; for a steady shock both are the place at half the jump.
    thickness : float
        Thickness in grains: the jump divided by the steepest slope of a steady shock, or the final
        distance between the edges of another wave; NaN without a trailing edge.
    mass_speed, momentum_speed : float
        Speeds of a jump between the plateaus that conserves mass, ``(v_b - v_a) / (R_b - R_a)``, or
        momentum, ``(F_b - F_a) / (m (v_b - v_a))``, grains/s. Both are equal for a steady shock.
    rankine_hugoniot : (State, float)
        State behind a steady shock with the measured velocity behind, and the speed of this shock,
        grains/s; NaN for a rarefaction.
    solitary : float
        Speed of the exact solitary wave with the velocity of the leading crest (`soliton.solve`),
        grains/s, which the leading edge of an old dispersive shock approaches; NaN for other waves
        and for the weakest.
    simple : State
        State behind a simple or dispersive wave with the measured velocity behind.
    predictions : dict
        Predicted `Edges` by theory: "whitham", "toda" and "kdv" for a dispersive shock, "continuum"
        for a rarefaction, and "burgers" for a steady shock. The height of "burgers" is the
        thickness for weak viscous damping, in grains.
    time : float
        Last time that was used, s.
    contact : (C,) array
        Numbers of the contacts.
    overlap : (C,) array
        Overlaps at `time`, m.
    moment : (H,) array
        About 400 times up to `time`, s.
    overlap_then : (H, C) array
        Overlaps at these times, m.
    """

    _units: ClassVar[Mapping[str, str]] = {"contact": "", "overlap": "m"}

    kind: Kind
    ahead: State
    behind: State
    behind_error: State
    leading: Edge
    trailing: Edge
    thickness: float
    mass_speed: float
    momentum_speed: float
    rankine_hugoniot: tuple[State, float]
    solitary: float
    simple: State
    predictions: dict[str, Edges]
    time: float
    contact: np.ndarray
    overlap: Array
    moment: Array
    overlap_then: Array
    _source: float
    _start: float
    _downward: bool

    @property
    def source(self) -> float:
        """Contact at which the wave began."""
        return self._source

    @property
    def start(self) -> float:
        """Time at which a sudden push would have begun, s."""
        return self._start

    @property
    def downward(self) -> bool:
        """Whether the wave travels downward."""
        return self._downward

    def plot(self, ax: Axes | None = None) -> Axes:
        """Draw the final overlaps, edges and plateaus, predicted edges dashed; return axes."""
        ax = chart(ax, "contact, from the top", "overlap [m]")
        ax.plot(self.contact, self.overlap, lw=1, color="0.3", label="overlap")
        for name, state, style in (("ahead", self.ahead, ":"), ("behind", self.behind, "-.")):
            ax.axhline(state.overlap, color="#009E73", lw=1, ls=style, label=f"plateau {name}")
        for name, edge in (("leading", self.leading), ("trailing", self.trailing)):
            colour = EDGE_COLOURS[name]
            if np.isfinite(edge.speed):
                label = f"{name} edge, {edge.speed:.5g} ± {float(f'{edge.error:.1g}'):g} grains/s"
                ax.axvline(self._place(edge.speed), color=colour, lw=1.2, label=label)
            for theory, speed in self._best_prediction(name):
                label = f"{name} edge, {theory}: {speed:.5g} grains/s"
                ax.axvline(self._place(speed), color=colour, lw=1.2, ls="--", label=label)
        title = f"{self.kind} after {prefixed(self.time, 's', 3)}"
        # A legend within the axes would cover the lines of the edges.
        return finish(ax, title, below=0.18)

    def plot_map(self, ax: Axes | None = None) -> Axes:
        """Draw overlaps over place and time, with plateaus and edges, predicted edges dashed."""
        ax = chart(ax, "contact, from the top", "time [s]")
        order = np.argsort(self.contact)
        cells = cell_edges(self.contact[order].astype(float)), cell_edges(self.moment)
        shown = ax.pcolormesh(*cells, self.overlap_then[:, order], cmap="cividis", rasterized=True)
        colour_bar(ax, shown, "overlap [m]")
        for name, edge in (("leading", self.leading), ("trailing", self.trailing)):
            lines = [(f"{name} edge", edge.speed)]
            lines += [
                (f"{name} edge, {theory}", speed) for theory, speed in self._best_prediction(name)
            ]
            for number, (label, speed) in enumerate(lines):
                if np.isfinite(speed):
                    way = self._source, self._place(speed)
                    text = f"{label}: {speed:.5g} grains/s"
                    colour = "w" if number else EDGE_COLOURS[name]
                    style = "--" if number else "-"
                    width = 1.2 if number else 3.0
                    ax.plot(way, (self._start, self.time), style, c=colour, lw=width, label=text)
        corners = (("behind", self.behind, 0.02, 0.95), ("ahead", self.ahead, 0.98, 0.05))
        for name, state, x, y in corners:
            share = x if self._downward else 1 - x
            ax.text(
                share,
                y,
                f"{name}: {state.velocity:.3g} m/s, {prefixed(state.overlap, 'm', 3)}",
                transform=ax.transAxes,
                ha="left" if share < 0.5 else "right",
                va="center",
                fontsize="small",
                bbox={"facecolor": "w", "alpha": 0.7, "lw": 0},
            )
        ax.set(xlim=cells[0][[0, -1]], ylim=(0.0, self.time))
        shade = {"frameon": True, "facecolor": "0.35", "labelcolor": "w"}
        return finish(ax, f"{self.kind}: overlaps over place and time", below=0.16, **shade)

    def _best_prediction(self, name: str) -> list[tuple[str, float]]:
        """Return the name and speed of the best prediction of an edge; None without a theory."""
        for theory, edges in self.predictions.items():
            if np.isfinite(speed := getattr(edges, name)):
                return [(AUTHORS.get(theory, theory), float(speed))]
        return []

    def _place(self, speed: float) -> float:
        """Return the contact that an edge of this speed reaches at the end."""
        way = speed * (self.time - self._start)
        return self._source + (way if self._downward else -way)


class TravellingWave(NamedTuple):
    """Motion of a wave towards larger numbers; the arrays of an upward wave are mirrored.

    Attributes
    ----------
    time : (T,) array
        Times up to the last useful time, s.
    velocity : (T, M) array
        Velocities of the grains, m/s.
    overlap : (T, M-1) array
        Overlaps of the contacts, m.
    source : int
        Contact at which the wave begins, counted from 0.
    start : float
        Time at which the wave begins, s.
    reached : int
        Contact that the front has reached at the end, counted from 0.
    """

    time: Array
    velocity: Array
    overlap: Array
    source: int
    start: float
    reached: int


class _Answer(NamedTuple):
    """The edges and thickness (in grains) of a wave of one kind, with theoretical predictions."""

    kind: Kind
    leading: Edge
    trailing: Edge
    thickness: float
    predictions: dict[str, Edges]


def find(trajectory: Trajectory, direction: Literal["down", "up"] = "down") -> Shock:
    """Measure the shock or rarefaction of a piston or a step, and compare it with theory.

    A step (`Riemann`) sends one wave down and one up. Samples are used until the front is near the
    end of the chain, or until waves from the ends may have reached the step; later samples are
    ignored. Open contacts have the overlap 0. If a rarefaction opens contacts, its trailing edge
    stays at the source, and the grains behind it fly freely.

    Parameters
    ----------
    trajectory : Trajectory
        Run with a piston (`Drive`), a step (`Riemann`) or another lasting push; all grains must be
        recorded.
    direction : "down" or "up"
        Direction in which the wave travels.

    Returns
    -------
    Shock

    Raises
    ------
    InputError
        If the chain is not uniform, has gravity or springs, or was not fully recorded. If the push
        is a pulse, or becomes steady only in the second half of the used time. If the wave has
        passed fewer than 24 contacts, or there are too few samples.

    Examples
    --------
    >>> import lmpchain
    >>> chain = lmpchain.Chain(grains=100, diameter=1e-3, gravity=0.0, top_load=1.0, top="wall")
    >>> piston = lmpchain.Drive(shape="piston", velocity=0.1, rise=1e-6, grain=0)
    >>> scene = lmpchain.Scene(chain=chain, excitation=piston, duration=1e-4, samples=601)
    >>> shock = find(lmpchain.simulate(scene, engine="native"))
    >>> shock.kind, bool(abs(shock.behind.velocity / 0.1 - 1) < 1e-3)
    ('dispersive shock', True)
    """
    if direction not in ("down", "up"):
        raise InputError.at("direction", 'must be "down" or "up"')
    chain = trajectory.scene.chain
    gas = medium_of(trajectory)
    wave = wave_of(trajectory, direction == "up", gas)
    ahead = State(float(wave.velocity[0, -2]), float(wave.overlap[0, -1]))
    behind, behind_error = _plateau(wave, gas, ahead)
    steady = (State(np.nan, np.nan), np.nan)
    if behind.overlap <= ahead.overlap:
        answer = _rarefaction_edges(wave, gas, ahead, behind, behind_error.overlap)
    else:
        steady = gas.rankine_hugoniot(ahead, behind.velocity)
        if chain.damped:
            answer = _steady_front(wave, ahead, behind, behind_error.overlap)
            thickness = _thickness(gas, ahead, steady[0], float(chain.contact_viscosity[1]))
            answer.predictions["burgers"] = Edges(steady[1], steady[1], thickness)
        else:
            answer = _dispersive_edges(wave, gas, ahead, behind)
    leading = answer.leading
    dispersive = answer.kind == "dispersive shock"
    jump = behind.velocity - ahead.velocity
    rise = gas.force(behind.overlap) - gas.force(ahead.overlap)
    rows = choose_few(wave.time.size, DRAWN_MOMENTS)
    contact = np.arange(1, wave.overlap.shape[1] + 1)[:: 1 if direction == "down" else -1]
    return Shock(
        kind=answer.kind,
        ahead=ahead,
        behind=behind,
        behind_error=behind_error,
        leading=leading,
        trailing=answer.trailing,
        thickness=answer.thickness,
        mass_speed=jump / (behind.overlap - ahead.overlap),
        momentum_speed=rise / (gas.mass * jump),
        rankine_hugoniot=steady,
        solitary=_solitary_speed(gas, ahead, leading.velocity) if dispersive else np.nan,
        simple=gas.behind(ahead, behind.velocity),
        predictions=answer.predictions,
        time=float(wave.time[-1]),
        contact=contact,
        overlap=wave.overlap[-1],
        moment=wave.time[rows],
        overlap_then=wave.overlap[rows],
        _source=float(contact[wave.source]),
        _start=wave.start,
        _downward=direction == "down",
    )


def medium_of(trajectory: Trajectory) -> Medium:
    """Return the chain as a gas.

    Parameters
    ----------
    trajectory : Trajectory

    Returns
    -------
    Medium

    Raises
    ------
    InputError
        If the chain is not uniform, has gravity or a ground, or was not fully recorded.
    """
    chain = trajectory.scene.chain
    chain.refuse_ground("a shock")
    exponent = chain.law.power_of("a shock")
    if chain.gravity or chain.loose_grains or exponent == 1:
        rule = "no gravity, an exponent above 1 and a load, if any, on grain 1"
        raise InputError.at("chain", f"measuring a shock requires {rule}")
    masses = chain.masses[: chain.movable]
    constants = chain.contact_constants
    if chain.grains < FEWEST or max(np.ptp(x) / x[0] for x in (masses, constants)) > 1e-9:
        raise InputError.at("chain", f"must be uniform, of {FEWEST} grains or more")
    recorded = trajectory.grains.size
    if recorded < chain.grains:
        raise InputError.at("grains", f"{recorded} of {chain.grains} were recorded: record all")
    return Medium(exponent, float(constants[0]), float(masses[0]))


def wave_of(trajectory: Trajectory, upward: bool, gas: Medium) -> TravellingWave:
    """Return the motion up to the time at which other waves disturb the wave of the source.

    Parameters
    ----------
    trajectory : Trajectory
    upward : bool
        Whether the wave travels upward; the arrays of an upward wave are mirrored.
    gas : Medium
        Chain as returned by `medium_of`.

    Returns
    -------
    TravellingWave

    Raises
    ------
    InputError
        If the wave is too short, or the push does not last.
    """
    scene = trajectory.scene
    time = trajectory.time
    displacement = np.asarray(trajectory.displacement)
    velocity = np.asarray(trajectory.velocity)
    rest = scene.chain.equilibrium_overlap
    closer = rest + displacement[:, :-1] - displacement[:, 1:]
    # An open contact transmits no force, regardless of its gap.
    overlap = np.maximum(closer, 0.0)
    source = _source(scene, upward)
    if upward:
        velocity = -velocity[:, ::-1]
        overlap = overlap[:, ::-1]
        closer = closer[:, ::-1]
    if closer[0, -1] < 0:
        raise InputError.at(
            "excitation", "opens the contacts ahead, but a wave does not cross gaps"
        )
    contacts = overlap.shape[1]
    still = scene.chain.bottom != "free" and not upward
    # Displacements add rounding errors to an overlap at rest.
    still |= abs(overlap[0, -1] - rest[0]) <= 1e-9 * overlap[0].max()
    still &= velocity[0, -2] == 0
    start, until = _span_before_echoes(scene.excitation, time, overlap, source, bool(still), gas)
    last = int(np.searchsorted(time, until))
    change = (overlap - overlap[0, -1])[:last]
    near = change[:, source + 1 : source + 3].mean(1)
    change = np.abs(change)
    # The crest of a shock exceeds half of all earlier overlaps near the source.
    highest = np.maximum.accumulate(np.abs(near))
    highest = np.maximum(highest, highest.max(initial=0.0) / 100)
    ended = np.flatnonzero((change[:, -END_CONTACTS:] > highest[:, None] / 2).any(1))
    last = int(ended[0]) if ended.size else len(change)
    way = "up" if upward else "down"
    shorter = "use a longer chain"
    if isinstance(scene.excitation, Riemann):
        shorter += ", with the step further from its ends"
    cure = "record longer" if last == time.size else shorter
    if last < FEWEST:
        few = f"{last} samples remain before waves from the ends arrive, fewer than {FEWEST}"
        raise InputError.at("samples", f"{few}: record more often, or {shorter}")
    _check_push(scene.excitation, time[:last], near[:last], way)
    change = change[:last]
    size = np.median(change[-(last // 4) :, source + 1 : source + 3])
    beyond = change[:, source:] > size / 2
    front = np.where(beyond.any(1), contacts - 1 - beyond[:, ::-1].argmax(1), source)
    reached = int(front[last - 1])
    if reached - source < FEWEST:
        passed = f"the wave has passed {reached - source} contacts"
        raise InputError.at("duration", f"{passed}, fewer than {FEWEST}: {cure}")
    return TravellingWave(time[:last], velocity[:last], overlap[:last], source, start, reached)


def _source(scene: Scene, upward: bool) -> int:
    """Return the contact at which the wave begins, counted from 0 in the direction of travel."""
    excitation = scene.excitation
    contacts = scene.chain.grains - 1
    if isinstance(excitation, Riemann):
        first = excitation.grain - 1
    elif isinstance(excitation, Force):
        # The contact on the far side of the grain.
        first = excitation.grain - 1 - upward
    elif isinstance(excitation, Drive) and upward != excitation.from_below:
        way, end = ("up", "bottom") if excitation.from_below else ("down", "top")
        raise InputError.at("direction", f'must be "{way}": the drive acts at the {end}')
    else:
        return 0
    source = contacts - 1 - first if upward else first
    if not 0 <= source < contacts - 1:
        raise InputError.at(
            "direction", "there are no grains on that side: choose the other direction"
        )
    return source


def _span_before_echoes(
    excitation: Excitation, time: Array, overlap: Array, source: int, still: bool, gas: Medium
) -> tuple[float, float]:
    """Return the start of the wave, and the time up to which no wave from an end reaches it, s.

    Overlaps are ordered in the direction of travel. If `still` is true, the chain ahead of the wave
    is at rest up to its end.
    """
    contacts = overlap.shape[1]
    start = 0.0
    until = np.inf
    if sound := gas.sound(float(overlap[0, -1])):
        # A shock arrives faster than sound, and a rarefaction at the speed of sound.
        until = (contacts - source) / sound
    if isinstance(excitation, Drive | Force):
        # A step of the same final speed or force would have begun at this time.
        now = min(until, time[-1])
        course = excitation.waveform
        if isinstance(excitation, Drive):
            done, rate = course.at(now), course.at(now, 1)
        else:
            done, rate = course.integral(now), course.at(now)
        start = float(now - done / rate) if rate else 0.0
        until += start
    if source:
        early = overlap[time * gas.sound(float(overlap[0].max())) <= source]
        # Waves from the ends are slower than sound at the largest overlap.
        if fastest := gas.sound(float(early.max())):
            way = source if still else min(source, (contacts - source) / 2)
            until = min(until, way / fastest)
    return start, until


def _check_push(excitation: Excitation, time: Array, near: Array, way: str) -> None:
    """Raise `InputError` unless the overlap near the source becomes steady."""
    if not near.any():
        raise InputError.at("excitation", f"sends no wave {way}")
    used = f"the {time[-1]:.3g} s of the run before waves from its ends matter"
    rise = excitation.rise if isinstance(excitation, Drive) else None
    if rise is not None and rise > time[-1] / 2:
        cure = "choose a shorter rise, or use a longer chain and record longer"
        raise InputError.at("excitation.rise", f"{rise:g} s is more than half of {used}: {cure}")
    quarter = len(time) // 4
    before = near[-2 * quarter : -quarter].mean()
    after = near[-quarter:].mean()
    left = abs(after) / np.abs(near).max()
    if left < LASTING or abs(after - before) > STEADY_PUSH * abs(after):
        cure = "use a step (Riemann), or a piston (Drive) or a force that soon stays constant"
        raise InputError.at("excitation", f"does not push steadily in {used}: {cure}")


def _plateau(wave: TravellingWave, gas: Medium, ahead: State) -> tuple[State, State]:
    """Return the mean velocity and overlap behind the wave, and two standard deviations."""
    late = slice(-(len(wave.time) // 5), None)
    sound = gas.sound(ahead.overlap)
    behind = float(np.median(wave.overlap[late, wave.source + 1 : wave.source + 4]))
    opened = behind == 0
    # Linear waves behind the trailing edge decay towards the source.
    slowest = max(2 * sound - gas.sound(behind), 0.0) if behind > ahead.overlap else sound
    slowest = min(slowest, gas.sound(behind))
    way = slowest * (wave.time[late][0] - wave.start)
    near = max(4, int(0.3 * max(way, 0.3 * (wave.reached - wave.source) * (slowest == 0))))
    inside = slice(wave.source + 1, wave.source + 1 + near)
    values = [x[late, inside] for x in (wave.velocity, wave.overlap)]
    mean, spread = ([float(f(x)) for x in values] for f in (np.mean, np.std))
    # Some contacts near the open ones are about to open.
    overlap = 0.0 if opened else mean[1]
    return State(mean[0], overlap), State(*(2 * x for x in spread))


def _edge_speed(time: Array, place: Array) -> tuple[float, float]:
    """Return the speed in the later half of the passages, and its error."""
    half = len(time) // 2
    late = stats.linregress(time[half:], place[half:])
    early = stats.linregress(time[:half], place[:half])
    return float(late.slope), float(2 * late.stderr + abs(late.slope - early.slope))


def _leading_crest(wave: TravellingWave, ahead: State, jump: float) -> Edge:
    """Return the leading solitary wave, tracked through the later two thirds of the way."""
    # The crest is a few contacts behind the front.
    first = wave.source + (wave.reached - wave.source) // 3
    contacts = np.arange(first, wave.reached - END_CONTACTS)
    passage, height = first_crests(wave.time, wave.overlap[:, contacts] - ahead.overlap)
    seen = np.isfinite(passage)
    heights = height[seen]
    half = len(heights) // 2
    # A slow push makes a ramp, which steepens into a shock only after a while.
    if half < len(contacts) // 4 or heights[half:].mean() < CREST * jump:
        cure = "let the push rise faster, or use a longer chain and record longer"
        raise InputError.at("excitation", f"the wave has no leading crest yet: {cure}")
    speed, error = _edge_speed(passage[seen], contacts[seen].astype(float))
    late = float(heights[half:].mean())
    drift = abs(late - float(heights[:half].mean()))
    last = contacts[-(len(contacts) // 3) :]
    _, velocities = first_crests(wave.time, wave.velocity[:, last] - ahead.velocity)
    return Edge(speed, error, late, drift, float(np.nanmean(velocities)))


def _trailing_edge(wave: TravellingWave, ahead: State, behind: State) -> Edge:
    """Extrapolate the oscillation amplitudes at several contacts to the trailing edge.

    The wave is self-similar: its amplitude depends on n / t only, and grows smoothly with n / t
    from the trailing edge on.
    """
    jump = behind.overlap - ahead.overlap
    ends = []
    total = wave.reached - wave.source
    # Distant contacts do not show the weak oscillations of a slow edge yet.
    contacts = np.unique(np.linspace(0.2 * total, 0.85 * total, 40).astype(int) + wave.source)
    # Without a load the wave train extends back to the source.
    for n in contacts if ahead.overlap > 0 else ():
        curve = CubicSpline(wave.time, wave.overlap[:, n])
        turns = curve.derivative().roots(extrapolate=False)
        share = np.abs(np.diff(curve(turns))) / (2 * jump)
        middle = (turns[1:] + turns[:-1]) / 2
        # The crests are used from the leading one on.
        first = int(share.argmax()) if share.size else 0
        used = np.flatnonzero((share > OSCILLATIONS[0]) & (share < OSCILLATIONS[1]))
        used = used[used >= first]
        if used.size >= FEWEST_OSCILLATIONS and np.ptp(share[used]) > np.ptp(OSCILLATIONS) / 2:
            speeds = (n - wave.source) / (middle[used] - wave.start)
            ends.append([np.polyfit(share[used], speeds, degree)[-1] for degree in (1, 2)])
    if len(ends) < 4:
        return Edge(np.nan, np.nan)
    half = len(ends) // 2
    straight = np.mean(ends, axis=0)[0]
    early = np.mean(ends[:half], axis=0)[1]
    late = float(np.mean(ends[half:], axis=0)[1])
    scatter = 2 * float(np.std(ends[half:], axis=0)[1])
    return Edge(late, float(abs(late - early) + abs(late - straight) + scatter))


def _solitary_speed(gas: Medium, ahead: State, velocity: float) -> float:
    """Return the speed of the solitary wave whose grains reach a velocity, grains/s."""
    if ahead.overlap == 0:
        # Units are those of mass and contact constant, and m/s.
        length = (gas.mass / gas.constant) ** (1 / (1 + gas.exponent))
        return solve(gas.exponent, velocity=velocity).speed / length
    sound = gas.sound(ahead.overlap)
    try:
        return struck(velocity / (ahead.overlap * sound), gas.exponent).speed * sound
    except InputError:
        # For such a weak wave only the KdV equation applies.
        return np.nan


def _rarefaction_edges(
    wave: TravellingWave, gas: Medium, ahead: State, behind: State, varies: float
) -> _Answer:
    """Return both edges, extrapolated from points between them where the sound speed is known.

    `varies` is the variation of the overlap behind, m.
    """
    sounds = [gas.sound(state.overlap) for state in (ahead, behind)]
    places = []
    times = np.linspace(len(wave.time) // 2, len(wave.time) - 1, 16).astype(int)
    for k in times:
        overlap = np.maximum(wave.overlap[k], 0.0)
        sound = gas.sound(1.0) * overlap ** ((gas.exponent - 1) / 2)
        share = (sound - sounds[1]) / (sounds[0] - sounds[1])
        # Ripples behind the trailing edge may exceed this fraction as well.
        behind_fan = np.flatnonzero(share[wave.source :] < 0.2)
        first = wave.source + (behind_fan[-1] + 1 if behind_fan.size else 0)
        inside = first + np.flatnonzero((share[first:] > 0.2) & (share[first:] < 0.8))
        if inside.size < 3:
            few = f"{inside.size} contacts show the slope of the rarefaction, fewer than 3"
            raise InputError.at("duration", f"{few}: record longer, in a longer chain")
        fit = stats.linregress(share[inside], inside)
        places.append((fit.intercept + fit.slope, fit.intercept))
    leading, trailing = (
        Edge(*_edge_speed(wave.time[times], place)) for place in np.transpose(places)
    )
    height = behind.overlap - ahead.overlap
    velocity = behind.velocity - ahead.velocity
    return _Answer(
        "rarefaction",
        Edge(leading.speed, leading.error, height, varies, velocity),
        trailing,
        (leading.speed - trailing.speed) * float(wave.time[-1] - wave.start),
        {"continuum": gas.rarefaction(ahead, behind.overlap)},
    )


def _dispersive_edges(wave: TravellingWave, gas: Medium, ahead: State, behind: State) -> _Answer:
    """Return the leading crest, the trailing edge, and the theories of both."""
    leading = _leading_crest(wave, ahead, behind.overlap - ahead.overlap)
    trailing = _trailing_edge(wave, ahead, behind)
    theories = {"whitham": gas.dispersive, "toda": gas.toda, "kdv": gas.kdv}
    return _Answer(
        "dispersive shock",
        leading,
        trailing,
        (leading.speed - trailing.speed) * float(wave.time[-1] - wave.start),
        {name: law(ahead, behind.overlap) for name, law in theories.items()},
    )


def _thickness(gas: Medium, ahead: State, behind: State, viscosity: float) -> float:
    """Return the thickness of a weak viscous shock; NaN without a load or without viscosity."""
    if ahead.overlap > 0 and viscosity > 0:
        return gas.thickness(ahead, behind.overlap, viscosity)
    return np.nan


def _steady_front(wave: TravellingWave, ahead: State, behind: State, varies: float) -> _Answer:
    """Return the edge at half the jump, and the thickness in grains.

    `varies` is the variation of the overlap behind, m.
    """
    jump = behind.overlap - ahead.overlap
    total = wave.reached - wave.source
    # The last contact that the whole front has passed.
    passed = wave.overlap[-1, wave.source :] > ahead.overlap + STEADY * jump
    last = wave.source + int(np.flatnonzero(passed)[-1]) if passed.any() else wave.source
    contacts = np.arange(wave.source + total // 2, last)
    if contacts.size < FEWEST:
        cure = "record longer, in a longer chain"
        few = f"{contacts.size} contacts show the whole front, fewer than {FEWEST}"
        raise InputError.at("duration", f"{few}: {cure}")
    half = ahead.overlap + jump / 2
    # The signals are 0 at half the jump.
    signals = (wave.overlap[:, contacts] - half) / jump
    speed, error = _edge_speed(first_passages(wave.time, signals), contacts.astype(float))
    height = float(wave.overlap[:, contacts[-1]].max()) - ahead.overlap
    # The spline is a function of the sample number, for which it is well conditioned.
    samples = np.arange(wave.time.size)
    interval = wave.time[1] - wave.time[0]
    curve = CubicSpline(samples, signals[:, -1])
    steepest = float(curve.derivative()(np.linspace(0, samples[-1], 8 * samples.size)).max())
    velocity = float((wave.velocity[:, contacts[-1]] - ahead.velocity).max())
    # The whole jump has not reached the last contact yet.
    edge = Edge(speed, error, height, abs(jump - height) + varies, velocity)
    return _Answer("steady shock", edge, edge, speed * interval / steepest, {})
