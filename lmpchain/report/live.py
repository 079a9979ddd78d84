"""Data of the live figure of one run, or of a grid of runs, as 16-bit integers."""

from __future__ import annotations

import base64
import hashlib
import json
import zlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple

import numpy as np
from markupsafe import Markup

from ..errors import InputError
from ..measure import energy
from ..measure.front import Front
from ..measure.recorded import leaves_rest
from ..measure.spectrum import travel_time
from ..trajectory.trajectory import MOVING, Trajectory, scale
from ..util.arrays import Array, as_slice
from ..util.plotting import loudest_rows
from ..util.templates import render


class ViewSizes(NamedTuple):
    """Sizes of the live figure.

    Attributes
    ----------
    times, grains : int
        Largest number of times and grains shown.
    margin : int
        Number of grains at rest that are shown on either side of the moving grains.
    levels : int
        Number of steps from 0 to the largest value of an array.
    """

    times: int = 240
    grains: int = 160
    margin: int = 4
    levels: int = np.iinfo(np.int16).max


VIEW = ViewSizes()
NAN_STEPS = np.iinfo(np.int16).min  # Replaces NaN, which integers cannot represent.


@dataclass(frozen=True)
class View:
    """Data of one run in the live figure, at T times and G grains.

    Attributes
    ----------
    time : (T,) array
        Times, s.
    grains : (G,) array
        Numbers of the grains, from the top.
    velocity, displacement : (T, G) arrays
        Motion of the grains, m/s and m.
    rest : (G - 1,) array
        Sum of the overlaps at rest of all contacts between each grain and the next grain shown, m.
    limit : float
        Velocity at which colours saturate, m/s.
    linear : (T, G) array, optional
        Velocity by linear theory, m/s.
    kinetic, total : (T,) arrays, optional
        Kinetic and total energy above rest, J.
    front, law : (G,) arrays, optional
        Arrival times of the front and of a long weak wave, s; NaN if none arrives.
    facts : mapping
        Texts beside the figure, by name.
    """

    time: Array
    grains: np.ndarray
    velocity: Array
    displacement: Array
    rest: Array
    limit: float
    linear: Array | None = None
    kinetic: Array | None = None
    total: Array | None = None
    front: Array | None = None
    law: Array | None = None
    facts: Mapping[str, str] = field(default_factory=dict)

    def thinned(self, times: int, grains: int) -> View:
        """Return a view with at most this number of times and grains, evenly spaced.

        If several grains are shown as one, the velocity is that of the grain that moves most.
        """
        rows = np.unique(np.linspace(0, self.time.size - 1, times).round().astype(int))
        first, loudest = loudest_rows(self.velocity[rows].T, grains)
        # The overlap between two remaining grains is the sum over all contacts between them.
        height = np.concatenate(([0.0], np.cumsum(self.rest)))
        return replace(
            self,
            time=self.time[rows],
            grains=self.grains[first],
            velocity=self.velocity[np.ix_(rows, loudest)],
            displacement=self.displacement[np.ix_(rows, first)],
            rest=np.diff(height[first]),
            linear=None if self.linear is None else self.linear[np.ix_(rows, loudest)],
            kinetic=_pick(self.kinetic, rows),
            total=_pick(self.total, rows),
            front=_pick(self.front, first),
            law=_pick(self.law, first),
        )


def _pick(values: Array | None, indices: np.ndarray) -> Array | None:
    return None if values is None else values[indices]


def crop(trajectory: Trajectory) -> Trajectory:
    """Return the grains that ever leave rest, and a few neighbours."""
    u = np.asarray(trajectory.displacement)
    v = np.asarray(trajectory.velocity)
    grains = trajectory.grains
    moving = grains[leaves_rest(u, v)]
    if not moving.size:
        return trajectory
    first = moving.min() - VIEW.margin
    last = moving.max() + VIEW.margin
    columns = as_slice(np.flatnonzero((grains >= first) & (grains <= last)))
    grains = grains[columns]
    # The scene lists the recorded grains, and must agree with the columns.
    scene = trajectory.scene.replace(grains=grains.tolist())
    return replace(
        trajectory, scene=scene, grains=grains, displacement=u[:, columns], velocity=v[:, columns]
    )


def extent(trajectory: Trajectory) -> tuple[int, int]:
    """Return the first and last grain to show: the moving grains, and a few neighbours."""
    largest = np.abs(trajectory.velocity).max(0)
    first = int(trajectory.grains.min())
    last = int(trajectory.grains.max())
    moving = trajectory.grains[largest > MOVING * largest.max(initial=0.0)]
    if not moving.size:
        return first, last
    return max(int(moving.min()) - VIEW.margin, first), min(int(moving.max()) + VIEW.margin, last)


def view(
    trajectory: Trajectory,
    between: tuple[int, int],
    *,
    linear: Trajectory | None = None,
    front: Front | None = None,
    facts: Mapping[str, str] | None = None,
) -> View:
    """Return the data of the live figure for the grains between two grains.

    Parameters
    ----------
    trajectory : Trajectory
    between : pair of int
        First and last grain.
    linear : Trajectory, optional
        Run of the same scene by linear theory, with these grains or more.
    front : Front, optional
        Front of the wave.
    facts : mapping, optional
        Texts beside the figure, by name.

    Returns
    -------
    View
    """
    columns = _columns(trajectory, between)
    grains = trajectory.grains[columns]
    # JSON integers cannot represent NaN.
    velocity: Array = np.nan_to_num(np.asarray(trajectory.velocity)[:, columns])
    overlap = np.concatenate(([0.0], np.cumsum(trajectory.scene.chain.equilibrium_overlap)))
    kinetic, total = _energies(trajectory)
    return View(
        time=trajectory.time,
        grains=grains,
        velocity=velocity,
        displacement=np.nan_to_num(np.asarray(trajectory.displacement)[:, columns]),
        rest=np.diff(overlap[grains - 1]),
        limit=scale(velocity),
        linear=None if linear is None else linear.velocity[:, _columns(linear, between)],
        kinetic=kinetic,
        total=total,
        front=None if front is None else _arrivals(front, grains),
        law=_law(trajectory, grains),
        facts=facts or {},
    )


def _columns(trajectory: Trajectory, between: tuple[int, int]) -> np.ndarray:
    """Return the columns of the grains between two, from the top."""
    order = np.argsort(trajectory.grains)
    numbers = trajectory.grains[order]
    return order[(numbers >= between[0]) & (numbers <= between[1])]


def _energies(trajectory: Trajectory) -> tuple[Array | None, Array | None]:
    """Return the kinetic and total energy above rest, (T,) J, if all grains were recorded."""
    try:
        ledger = energy.ledger(trajectory)
    except InputError:
        return None, None
    return ledger.kinetic, ledger.total


def _arrivals(front: Front, grains: np.ndarray) -> Array:
    times = dict(zip(front.grain.tolist(), front.time.tolist(), strict=True))
    return np.array([times.get(grain, np.nan) for grain in grains.tolist()])


def _law(trajectory: Trajectory, grains: np.ndarray) -> Array | None:
    """Return the arrival times of a long weak wave at grains, s; None without such a wave."""
    chain = trajectory.scene.chain
    source = getattr(trajectory.scene.excitation, "grain", None)
    if not chain.linearisable or chain.ground is not None or source is None:
        return None
    return travel_time(chain, max(1, source))[grains - 1]


class Slider(NamedTuple):
    """A slider: its key and unit, its values, their scale, and its initial position."""

    key: str
    unit: str
    values: list[float]
    log: bool
    start: int


def figure_numbers(
    views: Sequence[View | str], axes: Sequence[Slider] = (), levels: int = VIEW.levels
) -> dict[str, Any]:
    """Return the numbers for the script of the figure.

    Parameters
    ----------
    views : sequence of View or str
        View of each point on the grid of the axes, the last axis fastest, or a text with the reason
        why there is no view.
    axes : sequence of Slider
        Sliders of the figure.
    levels : int
        Number of steps from 0 to the largest value of an array.

    Returns
    -------
    dict
        Numbers for JSON. Arrays are stored in `data` as multiples of a unit; equal arrays are
        stored once.
    """
    store = _ViewStore(levels)
    runs = [{"reason": v} if isinstance(v, str) else store.record(v) for v in views]
    return {
        "axes": [axis._asdict() for axis in axes],
        "lists": store.lists,
        "runs": runs,
        "data": store.packed(),
    }


class _ViewStore:
    """Arrays of many views, each as differences from row to row in 16 bits, and lists."""

    def __init__(self, levels: int):
        self.levels = levels
        self.lists: list[list[float]] = []
        self._length = 0
        self._arrays: list[np.ndarray] = []
        self._places: dict[bytes, int] = {}
        self._numbers: dict[str, int] = {}

    def record(self, view: View) -> dict[str, Any]:
        """Add the arrays of a view; return where they are."""
        duration = float(view.time[-1])
        return {
            "time": self._add_list([float(f"{t:.9g}") for t in view.time]),
            "grains": self._add_list(view.grains.tolist()),
            "limit": float(f"{view.limit:.6g}"),
            "velocity": self._add(view.velocity),
            "displacement": self._add(view.displacement),
            "rest": self._add(view.rest[None]),
            "linear": self._add(view.linear),
            "kinetic": self._add(None if view.kinetic is None else view.kinetic[:, None]),
            "total": self._add(None if view.total is None else view.total[:, None]),
            "front": self._add(None if view.front is None else view.front[None], duration),
            "law": self._add(None if view.law is None else view.law[None]),
            "facts": list(view.facts.items()),
        }

    def _add_list(self, values: list[float]) -> int:
        text = json.dumps(values)
        if text not in self._numbers:
            self._numbers[text] = len(self.lists)
            self.lists.append(values)
        return self._numbers[text]

    def _add(self, values: Array | None, largest: float = 0.0) -> list[float] | None:
        """Return where an array begins, and the unit of its integers; None for no array."""
        if values is None:
            return None
        largest = largest or float(np.nanmax(np.abs(values), initial=0.0)) or 1.0
        unit = largest / self.levels
        steps = np.where(np.isnan(values), NAN_STEPS, np.round(np.nan_to_num(values) / unit))
        # Differences between neighbouring times are small and compress well; they wrap like int16.
        whole = steps.astype(np.int64)
        changes = np.diff(whole, axis=0, prepend=0).astype("<i8").astype("<u2").ravel()
        digest = hashlib.sha256(changes.tobytes()).digest()
        if digest not in self._places:
            self._places[digest] = self._length
            self._arrays.append(changes)
            self._length += changes.size
        return [self._places[digest], unit]

    def packed(self) -> str:
        """Return all arrays as text: low bytes first, then high bytes, compressed."""
        joined = np.concatenate(self._arrays) if self._arrays else np.zeros(0, "<u2")
        planes = joined.astype("<u2").view(np.uint8).reshape(-1, 2).T
        return base64.b64encode(zlib.compress(planes.tobytes(), 9)).decode("ascii")


def render_live(template: str, numbers: dict[str, Any], **values: Any) -> str:
    """Render the template of a page with a live figure.

    Parameters
    ----------
    template : str
        Name of a template of the package.
    numbers : dict
        Numbers of the figure, from `live.figure_numbers`.
    **values
        Other values that the template uses.

    Returns
    -------
    str
    """
    script = render("live.js")
    # The security policy contains the hash of the script, so that no other script runs.
    digest = base64.b64encode(hashlib.sha256(script.encode()).digest()).decode("ascii")
    return render(template, live=numbers, script=Markup(script), digest=digest, **values)
