"""The chain that does best: bounded optimisation by exact gradients, from several starts."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from hashlib import sha256
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ..errors import InputError, RunFailed, shown
from ..integrators.splittings import SPLITTINGS
from ..scene.scene import Scene
from ..util.arrays import Array
from ..util.files import replacing
from ..util.progress import ProgressBar
from . import parameters as params
from .changes import changed
from .gradients import HALVINGS, SAFETY, at_step, halved
from .objectives import Objective

if TYPE_CHECKING:
    from matplotlib.axes import Axes

TURN = 1.0  # of the fastest motion in a step of rkn4 at most, rad
HARDLY = 1e-9  # a relative gain that is none

Values = dict[str, Array]
Constraint = Callable[[Values], tuple[float, Mapping[str, Array]]]


@dataclass(frozen=True, eq=False)
class Optimum:
    """The best scene that was found, and how.

    Attributes
    ----------
    scene : Scene
    value, error : float
        Of the objective, and the estimated error of the value.
    values : dict
        Parameters by name.
    history : list of arrays
        The value of every run, one array a start.
    runs : int
        How many runs with gradients there were.
    """

    scene: Scene
    value: float
    error: float
    values: Values
    history: list[Array]

    @property
    def runs(self) -> int:
        """How many runs with gradients there were."""
        return sum(map(len, self.history))

    def plot(self, ax: Axes | None = None) -> Axes:
        """Draw the best value so far over the runs, a line a start; returns the axes."""
        from ..util.plotting import COLOURS, axes_in_units, legend

        ax = axes_in_units(ax, "", "")
        less = self.value <= min(part.min() for part in self.history) + HARDLY * abs(self.value)
        for number, part in enumerate(self.history, 1):
            best = (np.minimum if less else np.maximum).accumulate(part)
            ax.plot(np.arange(1, best.size + 1), best, lw=1, label=f"start {number}")
        ax.set_xlabel("runs")
        ax.set_ylabel("best value")
        if len(self.history) <= len(COLOURS):
            legend(ax)
        return ax


class _Box:
    """Parameters that may change, as numbers from 0 to 1 between their bounds."""

    def __init__(self, scene: Scene, names: Sequence[str], bounds: Mapping[str, tuple[Any, Any]]):
        faults = [
            ("bounds", f"give a lower and an upper one of {name}")
            for name in names
            if name not in bounds
        ]
        faults += [
            ("bounds", f"{shown(name)} is none of the parameters")
            for name in bounds
            if name not in names
        ]
        if faults:
            raise InputError(faults)
        self.scene, self.names = scene, names
        own = [params.values(scene, name) for name in names]
        self.sizes = np.cumsum([0, *(part.size for part in own)])
        low, high = (
            np.concatenate([np.broadcast_to(np.asarray(bounds[name][side], float), part.shape)
                            for name, part in zip(names, own, strict=True)])
            for side in (0, 1)
        )  # fmt: skip
        if not (np.isfinite(low) & np.isfinite(high) & (low <= high)).all():
            raise InputError([("bounds", "must be finite, the lower one not above the upper one")])
        self.low, self.width, self.free = low, high - low, high > low
        if not self.free.any():
            raise InputError([("bounds", "leave nothing free")])
        self.start = np.clip(
            (np.concatenate(own) - low)[self.free] / self.width[self.free], 0.0, 1.0
        )

    def values(self, at: Array) -> Values:
        """Return parameters by name."""
        whole = self.low.copy()
        whole[self.free] += at * self.width[self.free]
        return {
            name: whole[a:b]
            for name, a, b in zip(self.names, self.sizes, self.sizes[1:], strict=False)
        }

    def gathered(self, by_name: Mapping[str, Array]) -> Array:
        """Return derivatives by the numbers from 0 to 1; what is not named has none."""
        sizes = np.diff(self.sizes)
        parts = [
            np.broadcast_to(by_name.get(name, np.zeros(1)), (size,))
            for name, size in zip(self.names, sizes, strict=True)
        ]
        return (np.concatenate(parts) * self.width)[self.free]


class _Enough(Exception):
    """A start has had its runs."""


def optimise(
    scene: Scene,
    objective: Objective,
    parameters: Iterable[str],
    bounds: Mapping[str, tuple[Any, Any]],
    constraints: Sequence[Constraint] = (),
    *,
    maximise: bool = False,
    starts: int = 8,
    runs: int = 200,
    seed: int = 0,
    tolerance: float = 1e-5,
    folder: str | Path | None = None,
    progress: bool = False,
) -> Optimum:
    """Return the scene that makes an objective least, or largest.

    SciPy's L-BFGS-B, or SLSQP where there are constraints, goes down from the scene itself and from points of a Latin
    hypercube, by exact gradients of runs with rkn4. One start comes after another: the compiled loops take a quarter of
    a run with gradients of 100 grains, so that a batch of starts, or a thread for each, would gain little.

    Parameters
    ----------
    scene : Scene
    objective : Objective
        Such as `PeakForce(20)`.
    parameters : names
        As of `gradient`.
    bounds : mapping
        By name a lower and an upper bound, numbers or arrays; what has equal bounds stays there.
    constraints : sequence of functions, optional
        Each takes parameters by name and returns a number that must be 0 or above, and its derivatives by name.
    maximise : bool
    starts, runs, seed : int
        How many starts, the most runs of each, and what the starts are drawn with.
    tolerance : float
        Relative, of the value that is given in the end. Steps on the way are those that it needs at the start.
    folder : path, optional
        Where every finished start is kept; a call with the same task goes on from there.
    progress : bool
        Whether to show a progress bar.

    Returns
    -------
    Optimum
        With ``scene``, ``value``, ``values`` and ``history``.

    Raises
    ------
    InputError
        If parameters and bounds do not fit, or the folder is of another task.
    RunFailed
        If no start comes to an answer.

    Examples
    --------
    >>> from lmpchain import Chain, Impulse, Scene
    >>> from lmpchain.design import Momentum, gradient
    >>> chain = Chain(grains=4, diameter=1e-3)
    >>> scene = Scene(chain=chain, excitation=Impulse(velocity=1e-3), duration=5e-6, samples=2)
    >>> found = optimise(scene, Momentum([2]), ["masses"], {"masses": (1e-6, 2e-6)}, starts=1, maximise=True)
    >>> found.value > gradient(scene, Momentum([2]), ["masses"]).value
    True
    """
    from scipy.stats import qmc

    names = params.check(scene, parameters)
    box = _Box(scene, names, bounds)
    begins = np.vstack(
        [box.start, qmc.LatinHypercube(box.start.size, seed=seed).random(max(0, starts - 1))]
    )[:starts]
    with np.printoptions(threshold=sys.maxsize, floatmode="unique"):
        numbers = box.low.tolist(), box.width.tolist(), maximise, starts, runs, seed
        task = repr((scene.to_text(), type(objective).__name__, vars(objective), names, numbers))
    store = None if folder is None else _Store(Path(folder), sha256(task.encode()).hexdigest())
    found: list[tuple[float, Array, Array]] = [] if store is None else store.finished()
    sign = -1.0 if maximise else 1.0
    turn = min(TURN, _value(changed(scene, box.values(box.start)), objective, tolerance)[2])
    with ProgressBar(len(begins), "starts", done=len(found), shown=progress) as bar:
        for begin in begins[len(found) :]:
            found.append(_descend(box, objective, constraints, begin, sign, runs, turn))
            if store is not None:
                store.keep(found)
            bar.advance()
            bar.describe(f"starts, best {sign * min(part[0] for part in found):.6g}")
    least, at, _ = min(found, key=lambda part: part[0])
    if not np.isfinite(least):
        raise RunFailed("no start came to an answer: use narrower bounds")
    best = box.values(at)
    there = changed(scene, best)
    value, error, _ = _value(there, objective, tolerance)
    return Optimum(there, value, error, best, [sign * part[2] for part in found])


def _value(scene: Scene, objective: Objective, tolerance: float) -> tuple[float, float, float]:
    """Return an objective, its error from other steps, and the turn of the longest one that is enough."""
    method, fastest = SPLITTINGS["rkn4"], scene.highest_frequency
    value, error, step = halved(
        lambda step, _: at_step(scene, objective, (), method, step),
        TURN / fastest,
        HALVINGS,
        lambda now, others: (
            now[0],
            SAFETY * sum(abs(now[0] - other[0]) for other in others),
            now[2].step,
        ),
        lambda found: found[1] <= tolerance * abs(found[0]),
    )
    return value, error, 2 * step * fastest


def _descend(
    box: _Box,
    objective: Objective,
    constraints: Sequence[Constraint],
    begin: Array,
    sign: float,
    runs: int,
    turn: float,
) -> tuple[float, Array, Array]:
    """Return the least value, where it is, and the values of all runs, of one start."""
    from scipy.optimize import minimize

    method = SPLITTINGS["rkn4"]
    history: list[float] = []
    best = np.inf, begin
    scale = 0.0

    def value(at: Array) -> tuple[float, Array]:
        nonlocal best, scale
        if len(history) == runs:
            raise _Enough
        at = np.clip(at, 0.0, 1.0)
        try:
            scene = changed(box.scene, box.values(at))
            found, by_name, _ = at_step(
                scene, objective, box.names, method, turn / scene.highest_frequency
            )
        except (RunFailed, InputError):
            history.append(np.inf)
            return 1e3, np.zeros(at.size)
        history.append(sign * found)
        scale = scale or abs(found) or 1.0
        if sign * found < best[0] and all(
            limit(box.values(at))[0] >= -1e-6 for limit in constraints
        ):
            best = sign * found, at.copy()
        return sign * found / scale, sign * box.gathered(by_name) / scale

    limits = [
        {
            "type": "ineq",
            "fun": lambda at, limit=limit: limit(box.values(at))[0],
            "jac": lambda at, limit=limit: box.gathered(limit(box.values(at))[1]),
        }
        for limit in constraints
    ]
    options: dict[str, Any] = (
        {"maxiter": runs} if limits else {"maxfun": runs, "ftol": 1e-10, "gtol": 1e-9}
    )
    with suppress(_Enough):
        minimize(
            value, begin, jac=True, bounds=[(0.0, 1.0)] * begin.size, constraints=limits,
            method="SLSQP" if limits else "L-BFGS-B", options=options,
        )  # fmt: skip
    return best[0], best[1], np.array(history)


class _Store:
    """The folder where finished starts are kept."""

    def __init__(self, folder: Path, task: str):
        self.path, self.task = folder / "starts.json", task
        folder.mkdir(parents=True, exist_ok=True)

    def finished(self) -> list[tuple[float, Array, Array]]:
        """Return the starts that are finished; raises `InputError` if they are of another task."""
        if not self.path.exists():
            return []
        try:
            kept = json.loads(self.path.read_text(encoding="utf-8"))
            same = kept["task"] == self.task
            found = [
                (float(one["value"]), np.array(one["at"]), np.array(one["history"]))
                for one in kept["starts"]
            ]
        except (ValueError, KeyError, TypeError) as error:
            raise InputError([("folder", f"{self.path} is damaged: remove it")]) from error
        if not same:
            raise InputError(
                [("folder", f"{self.path} is of another task: use another folder, or remove it")]
            )
        return found

    def keep(self, found: list[tuple[float, Array, Array]]) -> None:
        """Write all that is finished."""
        starts = [
            {"value": value, "at": at.tolist(), "history": history.tolist()}
            for value, at, history in found
        ]
        with replacing(self.path) as path:
            path.write_text(json.dumps({"task": self.task, "starts": starts}), encoding="utf-8")
