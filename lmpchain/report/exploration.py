"""A page with a slider for each key of a scene, based on precomputed runs."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from itertools import pairwise
from os import PathLike
from typing import Any, NamedTuple

import numpy as np

from ..errors import InputError, LmpchainError, shown, unknown_key
from ..measure.front import Front
from ..scene.scene import Scene
from ..simulation.api import simulate
from ..simulation.many import simulate_many
from ..sweeps.file import Sweep, read_sweep
from ..sweeps.tasks import announce_work
from ..trajectory.trajectory import Trajectory
from ..util.arrays import plain
from ..util.files import check_not_foreign, expanded, write_aside
from ..util.progress import ProgressBar
from ..util.provenance import command
from ..util.remarks import warnings_aside
from . import live
from .live import Slider, View, render_live
from .verdicts import facts, front_below, linear_theory, short_power, unit_of_key

SOURCE_KEYS = ("scene", "over", "engine", "tolerance")


class PageLimits(NamedTuple):
    """Limits of a page.

    Attributes
    ----------
    size : int
        Largest size of the page, bytes.
    runs : int
        Largest number of runs; with this many, each run is shown at about forty times and grains.
    views : tuple of (int, int)
        Numbers of times and grains shown of a run, in descending order; the first pair that fits
        into the page is used.
    samples : int
        Largest number of samples of a run, which resolve its front.
    batch : int
        Largest number of samples x grains in memory at a time.
    """

    size: int = 2_000_000
    runs: int = 1000
    views: tuple[tuple[int, int], ...] = (
        (121, 120),
        (97, 96),
        (81, 80),
        (61, 60),
        (49, 48),
        (41, 40),
    )
    samples: int = 1201
    batch: int = 2**21


PAGE = PageLimits()
# Resolution of the values if there are many runs; a screen shows no more, and they compress well.
LEVELS = 2047


def explore(
    source: Mapping[str, Any],
    path: str | PathLike[str],
    *,
    progress: bool = False,
    overwrite: bool = False,
) -> None:
    """Write a self-contained page on which a slider per key selects runs of a scene.

    The page shows the motion of the chosen run, its strike number, its estimated error, its front
    and the error of linear theory. It contains only the computed runs, so that a value between two
    runs shows the nearest one. Its size is at most 2 MB, and it loads nothing from elsewhere.

    Parameters
    ----------
    source : mapping
        `scene` is a `Scene`, its tables, or the path of a scene file. `over` maps keys of a scene
        file, such as "excitation.velocity" or "chain.damping.viscoelastic", to the ascending values
        of their sliders in SI units. `engine` (by default native) and `tolerance` (by default 1e-6)
        are those of `sweep`.
    path : path
        HTML file to write, atomically.
    progress : bool
        Whether to show a progress bar.
    overwrite : bool
        Whether to replace a file that lmpchain did not write.

    Raises
    ------
    InputError
        If a key is unknown, values are not numbers or give no valid scene, or the runs do not fit
        into the page; the error lists every fault.

    Examples
    --------
    >>> from tempfile import TemporaryDirectory
    >>> import lmpchain
    >>> scene = lmpchain.Scene(
    ...     chain=lmpchain.Chain(grains=20, diameter=1e-3),
    ...     excitation=lmpchain.Impulse(velocity=1e-4),
    ...     duration=40e-6,
    ... )
    >>> over = {"excitation.velocity": [1e-5, 1e-3, 1e-1]}
    >>> with TemporaryDirectory() as folder:
    ...     lmpchain.explore({"scene": scene, "over": over}, f"{folder}/page.html")
    """
    check_not_foreign(expanded(path), overwrite)
    plan, axes = _read_plan(source)
    grid = _make_grid(plan)
    views: list[View | str] = []
    work = announce_work(plan, grid.scenes, plan.count)
    with work, ProgressBar(plan.count, "explore", " runs", shown=progress) as bar:
        for first in range(0, plan.count, grid.batch):
            for run in _run_scenes(plan, grid.scenes[first : first + grid.batch]):
                views.append(run if isinstance(run, str) else _view(run, grid.between, plan))
                bar.advance()
    page = _fit(views, axes, plan, grid)
    with write_aside(path, overwrite) as aside:
        aside.write_text(page, encoding="utf-8")


def _read_plan(source: Mapping[str, Any]) -> tuple[Sweep, list[Slider]]:
    """Return the sweep and the sliders of a page; raise `InputError` with all faults."""
    if not isinstance(source, Mapping):
        raise InputError.at("source", 'must be a mapping, such as {"scene": scene, "over": {...}}')
    faults = [
        (str(key), unknown_key(str(key), SOURCE_KEYS)) for key in source if key not in SOURCE_KEYS
    ]
    values: dict[str, list[float]] = {}
    try:
        values = _read_values(source.get("over", {}))
    except InputError as error:
        faults += error.faults
    if faults:
        raise InputError(faults)
    # A single run is a grid of one point, along a key that every scene has.
    table = {"scene": source.get("scene"), "grid": values or {"recording.samples": [PAGE.samples]}}
    options = {key: source[key] for key in ("engine", "tolerance") if key in source}
    try:
        plan = read_sweep(table | options)
    except InputError as error:
        raise InputError(
            (key.removeprefix("grid."), message) for key, message in error.faults
        ) from None
    with warnings_aside():
        # The remarks of the runs are shown on the page.
        list(plan.trials())
    kind = plan.tables.get("excitation", {}).get("kind", "")
    # The scene supplies values that its tables omit.
    scene = source["scene"] if isinstance(source.get("scene"), Scene) else plan.tables
    return plan, [_axis(key, sweep, scene, kind) for key, sweep in values.items()]


def _read_values(over: Any) -> dict[str, list[float]]:
    """Return the values of each slider; raise `InputError` with all faults."""
    if not isinstance(over, Mapping):
        raise InputError.at("over", 'must be a mapping, such as {"excitation.velocity": [...]}')
    faults = []
    values = {}
    for key, sweep in over.items():
        try:
            values[str(key)] = _check_values(sweep)
        except InputError as error:
            faults += error.under(str(key))
    runs = math.prod(map(len, values.values()))
    if runs > PAGE.runs:
        faults.append(("over", f"has {runs} runs, but a page of 2 MB contains at most {PAGE.runs}"))
    if faults:
        raise InputError(faults)
    return values


def _check_values(sweep: Any) -> list[float]:
    """Return the values of a slider; raise `InputError` if they are invalid."""
    numbers = isinstance(sweep, Sequence | np.ndarray) and not isinstance(sweep, str | bytes)
    values = [plain(value) for value in sweep] if numbers else []
    # True is a number in Python, but not a value of a slider.
    numbers = all(type(x) in (int, float) and math.isfinite(x) for x in values)
    if not values or not numbers or any(a >= b for a, b in pairwise(values)):
        raise InputError.at(
            "", f"must be a list of numbers in ascending order (got {shown(sweep)})"
        )
    return values


def _axis(key: str, values: list[float], scene: Any, kind: str) -> Slider:
    """Return the slider of a key; values with constant ratios give a logarithmic slider."""
    name = key.rpartition(".")[2]
    unit = unit_of_key(name, kind)
    log = values[0] > 0 and len(values) > 2
    if log:
        ratios = np.diff(np.log(values))
        log = bool(np.ptp(ratios) < 1e-6 * ratios.max()) or values[-1] > 100 * values[0]
    # A slider starts at the value of the scene, or in the middle.
    own: Any = scene
    for word in key.split("."):
        own = own.get(word) if isinstance(own, Mapping) else getattr(own, word, None)
    start = len(values) // 2
    if isinstance(own, int | float) and (own > 0 or not log):
        size = np.log if log else np.positive
        start = int(np.abs(size(values) - size(own)).argmin())
    return Slider(key, unit, values, log, start)


class _Grid(NamedTuple):
    """The scenes of a page, the grains that it shows, and the batch size."""

    scenes: list[Scene]
    between: tuple[int, int]
    batch: int


def _make_grid(plan: Sweep) -> _Grid:
    with warnings_aside():
        scenes = [plan.scene(plan.place(number)) for number in range(plan.count)]
    turn = max(scene.total_phase for scene in scenes)
    # The samples are close enough to resolve the front, up to the limit of the page.
    samples = min(max(*(s.samples for s in scenes), math.ceil(turn) + 1), PAGE.samples)
    with warnings_aside():
        scenes = [scene.ungathered.replace(samples=samples, grains="all") for scene in scenes]
    size = samples * max(scene.chain.grains for scene in scenes)
    return _Grid(scenes, _find_extent(plan, scenes), max(1, PAGE.batch // size))


def _find_extent(plan: Sweep, scenes: Sequence[Scene]) -> tuple[int, int]:
    """Return the first and last grain to show, equal for all runs so that they can be compared.

    These grains move in at least one of the runs at the ends of the sliders.
    """
    ends = np.array(np.meshgrid(*([0, length - 1] for length in plan.shape))).reshape(
        len(plan.shape), -1
    )
    corners = np.unique(np.ravel_multi_index(tuple(ends), plan.shape))
    runs = [
        run for n in corners for run in _run_scenes(plan, [scenes[n]]) if not isinstance(run, str)
    ]
    reached = [live.extent(run) for run in runs] or [(1, scenes[0].chain.grains)]
    return min(first for first, _ in reached), max(last for _, last in reached)


def _run_scenes(plan: Sweep, scenes: Sequence[Scene]) -> Iterator[Trajectory | str]:
    """Yield the run of each scene, or the reason why it failed."""
    with warnings_aside():
        # The page names a missed tolerance beside the run.
        try:
            yield from simulate_many(scenes, plan.tolerance, plan.engine, on_miss="warn")
            return
        except InputError:
            raise
        except LmpchainError:
            # One scene failed, so that the others are solved one by one.
            pass
    for scene in scenes:
        try:
            with warnings_aside():
                yield simulate(scene, plan.engine, plan.tolerance, on_miss="warn")
        except LmpchainError as error:
            yield str(error)


def _view(run: Trajectory, between: tuple[int, int], plan: Sweep) -> View:
    """Return the data of one run on the page."""
    linear = linear_theory(run)
    front = None
    try:
        passed: Front | str = (front := front_below(run))
    except InputError as error:
        key, reason = error.faults[0]
        passed = "no single one" if key == "excitation" else reason
    texts = dict(facts(run, linear, passed, plan.tolerance))
    full = live.view(run, between, linear=linear, front=front, facts=texts)
    return full.thinned(*PAGE.views[0])


def _fit(views: list[View | str], axes: list[Slider], plan: Sweep, grid: _Grid) -> str:
    """Return the page with as many times and grains of each run as its size limit allows."""
    for times, grains in PAGE.views:
        thin = [view if isinstance(view, str) else view.thinned(times, grains) for view in views]
        page = _render(live.figure_numbers(thin, axes, LEVELS), thin, axes, plan, grid)
        if len(page.encode()) <= PAGE.size:
            return page
    least = len(views) * PAGE.size // len(page.encode())
    raise InputError.at(
        "over", f"{len(views)} runs do not fit into a page of 2 MB: choose about {least}"
    )


def _render(
    numbers: dict[str, Any],
    views: Sequence[View | str],
    axes: Sequence[Slider],
    plan: Sweep,
    grid: _Grid,
) -> str:
    some = next((view for view in views if isinstance(view, View)), None)
    if some is None:
        raise InputError.at("scene", f"no run succeeds: {views[0]}")
    scene = grid.scenes[0]
    names = [_label(axis.key, scene.excitation.kind) for axis in axes]
    title = f"{scene.chain.grains} grains, {scene.excitation.kind}"
    return render_live(
        "explore.html",
        numbers,
        title=f"{title}: {' and '.join(names)}" if names else title,
        axes=[
            {"name": name, "count": len(axis.values), "unit": axis.unit}
            for name, axis in zip(names, axes, strict=True)
        ],
        caption=_caption(some, len(views), plan),
        scene=scene.to_text(),
        command=command(),
    )


def _label(key: str, kind: str) -> str:
    """Return a key of the scene in words, without its first table: "damping viscoelastic"."""
    if key == "excitation.velocity" and kind == "impulse":
        return "strike velocity"
    return key.partition(".")[2].replace(".", " ").replace("_", " ")


def _caption(view: View, runs: int, plan: Sweep) -> str:
    """Return the caption of the figure, with the omitted grains and times."""
    made = (
        f"The sliders select one of {runs} computed runs; a value in between shows the nearest run."
        if runs > 1
        else "One run."
    )
    return (
        f"{made} Each was computed by {plan.engine} to a relative tolerance of "
        f"{short_power(plan.tolerance)} and is shown at {view.time.size} times and "
        f"{view.grains.size} grains, rounded to 1/{LEVELS} of its largest value. Green and dashed: "
        "linear theory. On the map, dotted: the front; dashed: arrival of a long weak wave; "
        "horizontal line: the chosen grain. Beads move as the grains do, enlarged; orange bars: "
        "open contacts. Arrow keys on the map move through grains and times, the space bar plays."
    )
