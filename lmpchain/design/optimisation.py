"""Bounded optimisation of a scene by exact gradients, from several starts."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence, Set
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from os import PathLike
from types import CodeType, FunctionType, MethodType, ModuleType
from typing import Any, NamedTuple

import numpy as np

from ..errors import InputError, RunFailed, check_tolerance, shown
from ..integrators.differentiation import method_for
from ..integrators.halving import SAFETY
from ..scene.scene import Scene
from ..util.arrays import Array, check_flags, numbers
from ..util.files import LARGEST_JSON, check_readable, make_folder, replacing
from ..util.plotting import COLOURS, Axes, chart, finish
from ..util.progress import ProgressBar
from ..util.tabular import NamedColumn, Tabular
from ..util.validation import check_whole
from . import parameters as params
from .gradients import RUNS, Answer, at_step, refine
from .objectives import Objective, check_objective
from .parameters import changed


def fingerprint(*values: Any) -> str:
    """Return a hash that differs if any of these values differs.

    The hash of a function depends on its code, on the objects of its own module that the code uses,
    on its default values, and on the variables that it uses from an enclosing function. It does not
    depend on the name and the location of the function.
    """
    digest = hashlib.sha256()
    for piece in _pieces(values, ()):
        # The length separates pieces, so that different lists give different hashes.
        digest.update(len(piece).to_bytes(8))
        digest.update(piece)
    return digest.hexdigest()


def _pieces(value: Any, around: tuple[int, ...]) -> Iterator[bytes]:
    """Yield the contents of a value in order; `around` are the objects that contain it."""
    kind = type(value)
    yield f"{kind.__module__}.{kind.__qualname__}".encode()
    # A function may refer to itself.
    if id(value) in around:
        return
    inside = (*around, id(value))
    if isinstance(value, np.ndarray) and not value.dtype.hasobject:
        yield f"{value.dtype.str} {value.shape}".encode()
        yield np.ascontiguousarray(value).tobytes()
        return
    if value is None or isinstance(value, str | bytes | int | float | complex | np.generic):
        yield repr(value).encode()
        return
    contents, in_order = _contents(value)
    packed = [b"".join(_pieces(content, inside)) for content in contents]
    yield str(len(packed)).encode()
    yield from packed if in_order else sorted(packed)


def _contents(value: Any) -> tuple[list[Any], bool]:
    """Return the contents of a container, function or object, and whether their order matters."""
    if isinstance(value, Mapping):
        return list(value.items()), False
    if isinstance(value, Set):
        return list(value), False
    if isinstance(value, Sequence | np.ndarray):
        return list(value), True
    if isinstance(value, partial):
        return [value.func, value.args, value.keywords], True
    if hasattr(value, "py_func"):
        # A function compiled by numba.
        return [value.py_func], True
    if isinstance(value, MethodType):
        return [value.__self__, value.__func__], True
    if isinstance(value, CodeType):
        return [value.co_code, value.co_consts, value.co_names], True
    if isinstance(value, FunctionType):
        return _of_function(value), True
    if isinstance(value, ModuleType):
        return [value.__name__], True
    if isinstance(value, type) or not hasattr(value, "__dict__"):
        # A class or a function written in C has no contents to read.
        return [getattr(value, "__module__", ""), getattr(value, "__qualname__", repr(value))], True
    return [vars(value)], True


def _of_function(function: FunctionType) -> list[Any]:
    outer = function.__globals__
    # Objects of other modules count by name, because they are part of a package.
    names = [name for name in function.__code__.co_names if name in outer]
    referred = {
        name: outer[name]
        if getattr(outer[name], "__module__", function.__module__) == function.__module__
        else getattr(outer[name], "__name__", name)
        for name in names
    }
    cells = [cell.cell_contents for cell in function.__closure__ or ()]
    return [function.__code__, function.__defaults__, function.__kwdefaults__, cells, referred]


Values = dict[str, Array]
Constraint = Callable[[Values], tuple[float, Mapping[str, Array]]]


@dataclass(frozen=True, eq=False)
class Optimum(Tabular):
    """The best scene of an optimisation, with the values of all its runs.

    Attributes
    ----------
    scene : Scene
        The best scene.
    value, error : float
        Value of the objective; estimated error of the value.
    values : dict
        Best parameters by name.
    history : list of arrays
        Values of all runs, one array per start.
    runs : int
        Number of runs with gradients.
    """

    scene: Scene
    value: float
    error: float
    values: Values
    history: list[Array]

    @property
    def runs(self) -> int:
        """Number of gradient runs."""
        return sum(map(len, self.history))

    def plot(self, ax: Axes | None = None) -> Axes:
        """Draw the best value so far over the number of runs, a line per start; return the axes."""
        ax = chart(ax, "runs", "best value")
        # The value is the extreme of all runs, apart from its error.
        lowest = min(values.min() for values in self.history)
        highest = max(values.max() for values in self.history)
        minimised = abs(self.value - lowest) <= abs(self.value - highest)
        for number, values in enumerate(self.history, 1):
            best = (np.minimum if minimised else np.maximum).accumulate(values)
            ax.plot(np.arange(1, best.size + 1), best, lw=1, label=f"start {number}")
        return finish(ax) if len(self.history) <= len(COLOURS) else ax

    def _columns(self) -> Iterator[NamedColumn]:
        runs = [np.arange(1, len(values) + 1) for values in self.history]
        starts = [np.full(len(values), k) for k, values in enumerate(self.history, 1)]
        yield NamedColumn("start", "", np.concatenate(starts))
        yield NamedColumn("run", "", np.concatenate(runs))
        yield NamedColumn("value", "", np.concatenate(self.history))


class Box:
    """Bounded parameters, scaled to numbers from 0 to 1."""

    def __init__(self, scene: Scene, names: Sequence[str], bounds: Mapping[str, tuple[Any, Any]]):
        if not isinstance(bounds, Mapping):
            message = f"must be two bounds for each parameter, by name (got {shown(bounds)})"
            raise InputError.at("bounds", message)
        faults = [
            ("bounds", f"give a lower and an upper bound of {name}")
            for name in names
            if not _is_pair(bounds.get(name))
        ]
        faults += [
            ("bounds", f"{shown(name)} is not one of the parameters")
            for name in bounds
            if name not in names
        ]
        if faults:
            raise InputError(faults)
        self.scene = scene
        self.names = names
        present = [params.values(scene, name) for name in names]
        self.sizes = np.cumsum([0, *(values.size for values in present)])

        def bound(side: int) -> Array:
            entries = []
            for name, values in zip(names, present, strict=True):
                given = numbers(bounds[name][side], "bounds")
                if given.shape not in ((), (1,), values.shape):
                    message = f"of {name} must be one number or {values.size} (got {given.size})"
                    raise InputError.at("bounds", message)
                entries.append(np.broadcast_to(given, values.shape))
            return np.concatenate(entries)

        low = bound(0)
        high = bound(1)
        if not (np.isfinite(low) & np.isfinite(high) & (low <= high)).all():
            raise InputError.at("bounds", "must be finite, and no lower bound above the upper one")
        self.low = low
        self.width = high - low
        self.free = high > low
        if not self.free.any():
            raise InputError.at("bounds", "leave no parameter free: use wider bounds")
        start = (np.concatenate(present) - low)[self.free] / self.width[self.free]
        self.start = np.clip(start, 0.0, 1.0)

    def values(self, at: Array) -> Values:
        """Return parameters by name."""
        entries = self.low.copy()
        entries[self.free] += at * self.width[self.free]
        return dict(zip(self.names, np.split(entries, self.sizes[1:-1]), strict=True))

    def slopes(self, by_name: Mapping[str, Array]) -> Array:
        """Return the gradient over the scaled numbers; parameters without a derivative get 0."""
        entries = np.concatenate(
            [
                np.broadcast_to(by_name.get(name, np.zeros(1)), (size,))
                for name, size in zip(self.names, np.diff(self.sizes), strict=True)
            ]
        )
        return (entries * self.width)[self.free]


def _is_pair(value: object) -> bool:
    # An array without axes has no length.
    sized = isinstance(value, Sequence) or (isinstance(value, np.ndarray) and value.ndim > 0)
    return sized and len(value) == 2  # type: ignore[arg-type]


class _Limit(NamedTuple):
    """A constraint and its scale, the largest change by one parameter across its bounds.

    Divided by its scale, a constraint in any unit has the same tolerance.
    """

    function: Constraint
    scale: float

    def value(self, values: Values) -> float:
        """Return the constraint over its scale."""
        return float(self.function(values)[0]) / self.scale

    def slopes(self, values: Values, box: Box) -> Array:
        """Return the gradient over the scaled numbers of the box."""
        return box.slopes(self.function(values)[1]) / self.scale


def _limit(constraint: Constraint, box: Box) -> _Limit:
    """Return a constraint with its scale; raise `InputError` if its derivatives are invalid."""
    answer: Any = constraint(box.values(box.start))
    if not _is_pair(answer) or np.ndim(answer[0]) or not isinstance(answer[1], Mapping):
        message = f"must return a number and its derivatives by name (got {shown(answer)})"
        raise InputError.at("constraints", message)
    value, slopes = answer
    sizes = dict(zip(box.names, np.diff(box.sizes).tolist(), strict=True))
    for name, slope in slopes.items():
        if name not in sizes:
            message = f"return a derivative by {shown(name)}, which is not one of the parameters"
            raise InputError.at("constraints", message)
        if np.shape(slope) not in ((), (1,), (sizes[name],)):
            message = f"must return {sizes[name]} derivatives by {name} (got {np.size(slope)})"
            raise InputError.at("constraints", message)
    sizes_of_change = float(np.abs(box.slopes(slopes)).max()), abs(float(value)), 1.0
    return _Limit(constraint, next(size for size in sizes_of_change if 0 < size < np.inf))


class Start(NamedTuple):
    """A finished start: its best value, the parameters there, and the values of all its runs.

    The sign of the value is that of a minimisation. Parameters are numbers from 0 to 1.
    """

    value: float
    at: Array
    history: Array


class _Exhausted(Exception):
    """Raised when a start has used all its runs."""


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
    folder: str | PathLike[str] | None = None,
    progress: bool = False,
) -> Optimum:
    """Return the scene that minimises or maximises an objective.

    SciPy's L-BFGS-B, or SLSQP with constraints, starts from the scene itself and from points of a
    Latin hypercube, and uses exact gradients of runs with rkn4. The starts run one after another:
    parallel starts would save little time, because the compiled loops take only a quarter of a
    gradient run with 100 grains.

    Parameters
    ----------
    scene : Scene
    objective : Objective
        Objective, such as `PeakForce(20)`.
    parameters : names
        Parameter names, as for `gradient`.
    bounds : mapping
        Lower and upper bound of each parameter by name, numbers or arrays. Entries with equal
        bounds do not change.
    constraints : sequence of functions, optional
        Functions of the parameters by name. Each returns a number that must be 0 or above, and the
        derivatives of this number by name. The number may be below 0 by a millionth of its largest
        change by one parameter across its bounds.
    maximise : bool
        Whether to maximise the objective.
    starts, runs, seed : int
        Number of starts; largest number of runs of each start; seed of the random starts.
    tolerance : float
        Largest relative error of the final value. The step of all runs is the one that this
        tolerance requires at the start.
    folder : path, optional
        Folder that stores every finished start. A call with the same task, including constraints
        and all other options, continues from there.
    progress : bool
        Whether to show a progress bar.

    Returns
    -------
    Optimum
        The best scene, with ``value``, ``values`` and ``history``.

    Raises
    ------
    InputError
        If parameters, bounds and constraints do not fit together, or if the folder belongs to
        another task.
    RunFailed
        If no start converges.

    Examples
    --------
    >>> from lmpchain import Chain, Impulse, Scene
    >>> from lmpchain.design import Momentum, gradient
    >>> chain = Chain(grains=4, diameter=1e-3)
    >>> scene = Scene(chain=chain, excitation=Impulse(velocity=1e-3), duration=5e-6, samples=2)
    >>> bounds = {"masses": (1e-6, 2e-6)}
    >>> best = optimise(scene, Momentum([2]), ["masses"], bounds, starts=1, maximise=True)
    >>> best.value > gradient(scene, Momentum([2]), ["masses"]).value
    True
    """
    from scipy.stats import qmc

    check_flags(maximise=maximise)
    check_tolerance(tolerance)
    for key, count, lowest in (("starts", starts, 1), ("runs", runs, 1), ("seed", seed, 0)):
        check_whole(key, count, lowest)
    names = params.check(scene, parameters)
    check_objective(objective)
    if not isinstance(constraints, Sequence) or not all(map(callable, constraints)):
        raise InputError.at(
            "constraints", f"must be a list of functions (got {shown(constraints)})"
        )
    box = Box(scene, names, bounds)
    limited = [_limit(constraint, box) for constraint in constraints]
    drawn = qmc.LatinHypercube(box.start.size, seed=seed).random(max(0, starts - 1))
    begins = np.vstack([box.start, drawn])[:starts]
    store = None
    finished = []
    if folder is not None:
        # Values of constraints at the starts also depend on the files that constraints read.
        limits = [constraint(box.values(at)) for constraint in constraints for at in begins]
        options = (maximise, starts, runs, seed, tolerance)
        subject = (scene.to_text(), objective, names, box.low, box.width, constraints, limits)
        store = _StartStore(folder, fingerprint(subject, options), box.start.size)
        finished = store.read()
    sign = -1.0 if maximise else 1.0
    first = _value(changed(scene, box.values(box.start)), objective, tolerance)
    descent = _Descent(box, objective, limited, sign, runs, min(RUNS.turn, first.turn))
    with ProgressBar(len(begins), "starts", done=len(finished), shown=progress) as bar:
        for begin in begins[len(finished) :]:
            finished.append(_descend(descent, begin))
            if store is not None:
                store.write(finished)
            bar.advance()
            bar.describe(f"starts, best {sign * min(start.value for start in finished):.6g}")
    best = min(finished, key=lambda start: start.value)
    if not np.isfinite(best.value):
        raise RunFailed("no start converged: use narrower bounds")
    values = box.values(best.at)
    optimum = changed(scene, values)
    value, error, _ = _value(optimum, objective, tolerance)
    return Optimum(optimum, value, error, values, [sign * start.history for start in finished])


class _Value(NamedTuple):
    """An objective, its error, and the phase of the fastest motion in the longest step, rad."""

    value: float
    error: float
    turn: float


def _value(scene: Scene, objective: Objective, tolerance: float) -> _Value:
    """Return an objective, its error, and the longest step for this relative tolerance."""
    method = method_for(scene, (), "rkn4")
    fastest = scene.highest_frequency

    def judge(answer: Answer, others: Sequence[Answer]) -> _Value:
        error = SAFETY * sum(abs(answer.value - other.value) for other in others)
        return _Value(answer.value, error, 2 * answer.run.step * fastest)

    return refine(
        lambda step, _: at_step(scene, objective, (), method, step),
        judge,
        lambda value: value.error / (tolerance * abs(value.value) or np.finfo(float).tiny),
        RUNS.turn / fastest,
        RUNS.halvings,
    )


class _Descent(NamedTuple):
    """An optimisation problem without its starting point.

    Attributes
    ----------
    box : Box
    objective : Objective
    limits : list of _Limit
    sign : float
        1 to minimise, -1 to maximise.
    runs : int
        Largest number of runs.
    turn : float
        Phase of the fastest motion in a step, rad.
    """

    box: Box
    objective: Objective
    limits: list[_Limit]
    sign: float
    runs: int
    turn: float

    def solve(self, at: Array) -> tuple[float, Array]:
        """Return the value to minimise and its derivatives; infinity if the run fails."""
        method = method_for(self.box.scene, self.box.names, "rkn4")
        try:
            scene = changed(self.box.scene, self.box.values(at))
            step = self.turn / scene.highest_frequency
            value, by_name, _ = at_step(scene, self.objective, self.box.names, method, step)
        except (RunFailed, InputError):
            return np.inf, np.zeros(at.size)
        return self.sign * value, self.sign * self.box.slopes(by_name)

    def allows(self, at: Array) -> bool:
        """Return whether a point satisfies all constraints within rounding."""
        values = self.box.values(at)
        return all(limit.value(values) >= -1e-6 for limit in self.limits)


def _descend(descent: _Descent, begin: Array) -> Start:
    """Minimise from one start; return the best value, its point, and the values of all runs."""
    from scipy.optimize import minimize

    box = descent.box
    history: list[float] = []
    best = Start(np.inf, begin, np.zeros(0))
    scale = 0.0

    def value(at: Array) -> tuple[float, Array]:
        nonlocal best, scale
        if len(history) == descent.runs:
            raise _Exhausted
        # SLSQP may violate its bounds by rounding.
        at = np.clip(at, 0.0, 1.0)
        result, slopes = descent.solve(at)
        history.append(result)
        # A failed run gets a value far above all others, which are of the order of 1.
        if not np.isfinite(result):
            return 1e3, slopes
        # Tolerances of the optimisers are absolute, so values are scaled by the first one.
        scale = scale or abs(result) or 1.0
        if result < best.value and descent.allows(at):
            best = Start(result, at.copy(), best.history)
        return result / scale, slopes / scale

    limits = [
        {
            "type": "ineq",
            "fun": lambda at, limit=limit: limit.value(box.values(at)),
            "jac": lambda at, limit=limit: limit.slopes(box.values(at), box),
        }
        for limit in descent.limits
    ]
    options: dict[str, Any] = {"maxiter": descent.runs}
    if not limits:
        options = {"maxfun": descent.runs, "ftol": 1e-10, "gtol": 1e-9}
    with suppress(_Exhausted):
        minimize(
            value,
            begin,
            jac=True,
            bounds=[(0.0, 1.0)] * begin.size,
            constraints=limits,
            method="SLSQP" if limits else "L-BFGS-B",
            options=options,
        )
    return best._replace(history=np.array(history))


class _StartStore:
    """The folder in which finished starts are stored."""

    def __init__(self, folder: str | PathLike[str], task: str, size: int):
        self.path = make_folder(folder) / "starts.json"
        self.task = task
        self._size = size

    def read(self) -> list[Start]:
        """Return the finished starts; raise `InputError` if they belong to a different task."""
        if not self.path.exists():
            return []
        try:
            check_readable(self.path, LARGEST_JSON)
            text = json.loads(self.path.read_text(encoding="utf-8"))
            task = text["task"]
            starts = [
                Start(
                    float(start["value"]),
                    np.array(start["at"], float),
                    np.array(start["history"], float),
                )
                for start in text["starts"]
            ]
            if not isinstance(task, str) or any(start.history.ndim != 1 for start in starts):
                raise ValueError("it contains no starts")
        except (OSError, ValueError, KeyError, TypeError, RecursionError) as error:
            raise InputError.at(
                "folder",
                f"{self.path} is damaged, or lmpchain did not write it: move it, or use another "
                "folder",
            ) from error
        if task != self.task or any(start.at.shape != (self._size,) for start in starts):
            message = f"{self.path} belongs to another task: use another folder, or remove it"
            raise InputError.at("folder", message)
        return starts

    def write(self, starts: list[Start]) -> None:
        """Write all finished starts."""
        rows = [
            {"value": value, "at": at.tolist(), "history": history.tolist()}
            for value, at, history in starts
        ]
        with replacing(self.path) as path:
            path.write_text(json.dumps({"task": self.task, "starts": rows}), encoding="utf-8")
