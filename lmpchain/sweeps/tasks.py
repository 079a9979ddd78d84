"""Tasks of a sweep: solve some scenes, similar ones in batches, and write the results."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from contextlib import AbstractContextManager, suppress
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from .. import engines
from ..chain.band_edge import band_edges
from ..chain.bounds import LIMITS
from ..chain.chain import Chain
from ..chain.equilibrium import Equilibrium, derive_chain
from ..disorder.draws import OF_CONTACTS, drawn_constants
from ..engines.base import Engine
from ..engines.cost_model import announced
from ..errors import InputError, LmpchainError, RunFailed, ToleranceNotMet
from ..measure.motion import motion_of
from ..scene.scene import Scene
from ..simulation.api import simulate
from ..simulation.many import in_batches
from ..trajectory.trajectory import Trajectory
from ..util.arrays import Array
from ..util.remarks import warnings_aside
from ..util.validation import make_unchecked, with_derived
from .axes import DAMPING, INDEX
from .file import Place, Sweep, read_text
from .quantities import (
    add_rest,
    is_extreme,
    is_gathered,
    leave_out_unsure,
    measure_quantities,
    quantity,
    with_gathered,
)
from .results import find_recorded
from .store import NAME, NOT_DONE, StoreLayout, complete, part_of, read_part, write_part

Result = Scene | InputError


def scenes(plan: Sweep, first: int, count: int, together: bool) -> list[Result]:
    """Return consecutive scenes of a sweep, or the errors that prevent them.

    If `together` is true, similar scenes are derived in one batch. The scenes record all grains
    that the stored quantities need. They can be solved, but their options do not describe them
    completely.
    """
    results: list[Result] = []
    length = len(plan.axes[-1]) if together and _alike(plan) else 1
    while len(results) < count:
        number = first + len(results)
        # A batch ends with the last axis, because scenes differ in other keys beyond it.
        end = min(number + length - number % length, first + count)
        results += _together(plan, range(number, end))
    return results


def _alike(plan: Sweep) -> bool:
    """Return whether scenes along the last axis differ only in numbers of grains and contacts."""
    last = plan.axes[-1]
    return (
        last.drawn
        and set(last.columns) <= {INDEX}
        and not any(axis.arrays for axis in plan.axes[:-1])
    )


def _together(plan: Sweep, numbers: range) -> list[Result]:
    """Return neighbours along the last axis, derived together if possible."""
    derived: list[Scene | None] = [None] * len(numbers)
    if len(numbers) > 1:
        # A fault of the common tables is a fault of every scene.
        with suppress(InputError):
            derived = _derive(plan, [plan.place(number) for number in numbers]) or derived
    return [
        _alone(plan, number) if scene is None else scene
        for number, scene in zip(numbers, derived, strict=True)
    ]


def _alone(plan: Sweep, number: int) -> Result:
    try:
        return _wider(plan.scene(plan.place(number)), plan)
    except InputError as error:
        return error


def _wider(scene: Scene, plan: Sweep) -> Scene:
    """Return the scene with all grains and forces recorded that the quantities need."""
    keep = plan.keep
    scene = with_gathered(scene, keep, engines.get(plan.engine).moves_grains)
    if scene.grains == "all" or all(
        quantity(name).recorded or name in scene.quantities for name in keep
    ):
        return scene
    last = scene.chain.grains
    # Forces and energies of contacts also need the neighbours of a grain.
    numbers = {n for grain in scene.recorded.tolist() for n in (grain - 1, grain, grain + 1)}
    numbers |= {last - 1, last} if "wall_force" in keep else set()
    grains = tuple(sorted(numbers - {0, last + 1}))
    return make_unchecked(
        Scene, **scene.given() | {"grains": "all" if len(grains) == last else grains}
    )


def _derive(plan: Sweep, places: Sequence[Place]) -> list[Scene | None] | None:
    """Return scenes whose chains are derived in one batch, or None if this is not possible.

    The first scene provides everything that the scenes share; `InputError` is raised if it is not
    valid. A scene is None if its chain is not certainly valid.
    """
    common = _wider(plan.regular_scene(places[0]), plan)
    disorder = plan.disorder(places[0])
    chain = common.chain
    # Each scene would have a different light cone or excitation.
    if common.light_cone is not None or common.excitation.of_chain:
        return None
    if chain.grains == 1 or (disorder and disorder.of not in OF_CONTACTS):
        return None
    values = [plan.draw_values(place, chain.grains) for place in places]
    # Damping is drawn with the chain, and does not change the equilibrium.
    if any(key in DAMPING for key in values[0]):
        return None
    drawn = {
        key.removeprefix("chain."): np.array([row[key] for row in values]) for key in values[0]
    }
    # A chain with invalid numbers is made alone, which raises an error with the reason.
    with np.errstate(all="ignore"):
        equilibria = derive_chain(chain, drawn)
        if disorder:
            law = {key: value for key, value in disorder.given().items() if key != "index"}
            factors = drawn_constants(chain, indices=[place[-1] for place in places], **law)
            # The random contacts multiply the contacts between the drawn grains.
            constants = equilibria.contacts.constant[..., 1:-1] * factors
            equilibria = derive_chain(chain, drawn | {"contact_constants": constants})
        sound = _sound(chain, equilibria, drawn)
        chains = _chains(chain, equilibria, "diameter" in drawn)
    return [
        _scene(common, chain, bool(drawn)) if accepted else None
        for chain, accepted in zip(chains, sound, strict=True)
    ]


def _sound(chain: Chain, equilibria: Equilibrium, drawn: Mapping[str, Array]) -> NDArray[np.bool_]:
    """Return a mask of the R chains that `Chain` certainly accepts, (R,)."""
    sound = equilibria.computable(chain.movable)
    sound &= (equilibria.contacts.constant[:, 1:-1] > 0).all(1)
    for key, values in drawn.items():
        low, high = (-1.0, 0.5) if key == "material.poissons_ratio" else (0.0, np.inf)
        sound &= ((values > low) & (values <= high) & np.isfinite(values)).all(1)
    # Random contacts have no lower limit of their stiffness.
    if drawn:
        sound &= (equilibria.compression <= LIMITS.compression).all(1)
    return sound


def _chains(chain: Chain, equilibria: Equilibrium, widths: bool) -> list[Chain]:
    """Return R chains like this one, with these equilibria and, if they differ, diameters."""
    fields = {key: value for key, value in chain.given().items() if key != "impurity"}
    edges = band_edges(*map(np.ascontiguousarray, equilibria.dynamical_matrix(chain.movable)))
    chains = []
    for row, edge in enumerate(edges.tolist()):
        equilibrium = equilibria.row(row)
        fields["masses"] = equilibrium.masses
        fields["contact_constants"] = equilibrium.contacts.constant[1:-1]
        if widths or chain.impurity:
            fields["diameter"] = equilibrium.diameters
        # Known results are passed on, because each chain would derive them again.
        derived = {"equilibrium": equilibrium, "band_edge": edge}
        chains.append(with_derived(make_unchecked(Chain, **fields), **derived))
    return chains


def _scene(common: Scene, chain: Chain, checked: bool) -> Scene | None:
    """Return the common scene with another chain; None if the strike is too strong for it."""
    fields = common.given() | {"chain": chain}
    try:
        scene = Scene(**fields) if checked else make_unchecked(Scene, **fields)
    except InputError:
        return None
    # All scenes share the grains of the first one, so that they fit in one batch.
    return with_derived(scene, light_cone=None)


class TaskLimits(NamedTuple):
    """Limits of the tasks of a sweep.

    Attributes
    ----------
    scenes : int
        Largest number of scenes of a task.
    numbers : int
        Largest number of samples x grains of all scenes of a task.
    pending : int
        Largest number of tasks that an executor has at a time.
    deaths : int
        Number of processes that may die during a task before the task is given up.
    scheduler_s : float
        Longest wait for an answer of a Dask scheduler, s.
    priced : int
        Number of scenes from whose expected times the time of all scenes is extrapolated.
    """

    scenes: int = 256
    numbers: int = 2**22
    pending: int = 256
    deaths: int = 3
    scheduler_s: float = 5.0
    priced: int = 16


TASKS = TaskLimits()
KNOWN = 0.9  # Fraction of the predictability horizon up to which a scene is simulated.


class Beginning(NamedTuple):
    """The predictable part of a scene whose end cannot be predicted.

    Attributes
    ----------
    known : Trajectory
        Run that ends shortly before the predictability horizon.
    whole : Trajectory
        Run of the whole scene; beyond the horizon it is one of many equally plausible trajectories.
    reason : str
        Reason why the whole scene misses the tolerance.
    """

    known: Trajectory
    whole: Trajectory
    reason: str


@dataclass(frozen=True, eq=False)
class SweepTask:
    """Scenes to solve, from the number `first` on, and the layout of their results.

    Attributes
    ----------
    folder : Path
        Folder of the results.
    files : Path
        Folder of the CSV files.
    layout : StoreLayout
        Layout of the store.
    grains : (G,) array
        Numbers of the grains in the arrays of the store.
    first : int
        Number of the first scene.
    """

    folder: Path
    files: Path
    layout: StoreLayout
    grains: np.ndarray
    first: int

    @property
    def count(self) -> int:
        """Number of scenes."""
        return min(self.layout.batch, self.layout.count - self.first)


def count_scenes(engine: str, scene: Scene) -> int:
    """Return the number of scenes like this one per task; large scenes get separate tasks."""
    if not engines.get(engine).batches:
        return 1
    numbers = scene.fine.samples * scene.chain.grains
    return max(1, min(TASKS.scenes, TASKS.numbers // numbers))


def announce_work(
    plan: Sweep, scenes: Sequence[Scene], total: int, workers: int = 1
) -> AbstractContextManager[None]:
    """Announce the cost of all scenes of a plan, extrapolated from these scenes."""
    engine = engines.get(plan.engine)
    costs = []
    for scene in scenes[:: math.ceil(len(scenes) / TASKS.priced) or 1]:
        with suppress(LmpchainError):
            costs.append(engine.propose(engine.part(scene), plan.tolerance).cost_s)
    cost_s = total / workers * sum(costs) / max(1, len(costs))
    work = f"{total} scenes by {engine.name} for a tolerance of {plan.tolerance:.2g}"
    return announced(cost_s, work, "fewer scenes, a larger tolerance or more workers takes less")


def answer(task: SweepTask) -> None:
    """Solve the unfinished scenes of a task, and write their results."""
    shard = task.first // task.layout.shard
    if part_of(task.folder, task.first).exists() or complete(task.folder, shard):
        return
    if not task.folder.is_dir():
        raise RunFailed(
            f"a worker does not see the folder {task.folder}: all machines must share it"
        )
    plan = _read_plan(task.folder / NAME, task.files)
    engine = engines.get(plan.engine)
    alike = engine.batches and engine.equation == 1
    # Warnings were given when the sweep began; the result contains the error of each answer.
    with warnings_aside(), announced(0.0, "", ""):
        columns = _make_columns(task)
        remaining = dict(enumerate(scenes(plan, task.first, task.count, alike)))
        # Invalid scenes are already errors.
        batch = {row: scene for row, scene in remaining.items() if isinstance(scene, Scene)}
        for row, result in in_batches(engine, batch, plan.tolerance):
            # A scene that missed the tolerance is solved again alone, up to its predictability
            # horizon.
            if isinstance(result, Trajectory):
                del remaining[row]
                _put(columns, row, result, plan, task)
        for row, scene in remaining.items():
            _put(columns, row, _answer_alone(scene, engine, plan), plan, task)
    columns["reason"] = np.array(columns["reason"], dtype=str)
    write_part(task.folder, task.first, _insert_earlier(columns, task))


def _insert_earlier(columns: dict[str, Any], task: SweepTask) -> dict[str, Any]:
    """Return the arrays with the results of an earlier sweep in their place.

    The scenes of the earlier sweep are solved again in the same batch, because the last bits of the
    other scenes may depend on the batch.
    """
    path = part_of(task.folder, task.first, whole=False)
    if not path.exists():
        return columns
    earlier = {name: read_part(path, name, column) for name, column in task.layout.columns.items()}
    answered = earlier["reason"] != NOT_DONE
    # Scenes are the first dimension, but numpy broadcasts along the last ones.
    return {
        name: np.where(answered, earlier[name].T, values.T).T for name, values in columns.items()
    }


# Tasks of one sweep follow one another.
@lru_cache(maxsize=2)
def _read_plan(path: Path, files: Path) -> Sweep:
    return read_text(path.read_text(encoding="utf-8"), files)


def _make_columns(task: SweepTask) -> dict[str, Any]:
    """Return an array of NaN for each quantity, (R, ...) each, and empty reasons."""
    columns: dict[str, Any] = {
        name: np.full((task.count, *column.shape), np.nan)
        for name, column in task.layout.columns.items()
    }
    return columns | {"reason": [""] * task.count}


def _put(
    columns: Mapping[str, Any],
    row: int,
    result: Trajectory | Beginning | LmpchainError,
    plan: Sweep,
    task: SweepTask,
) -> None:
    """Store the quantities of a result in a row, or the reason for its failure."""
    if isinstance(result, LmpchainError):
        columns["reason"][row] = str(result)
        return
    keep = list(plan.keep)
    reason = ""
    # The samples of a beginning are not those of the scene.
    scene = (result.whole if isinstance(result, Beginning) else result).scene
    if isinstance(result, Beginning):
        keep = [name for name in keep if is_extreme(name)]
        reason = result.reason
        whole = result.whole
        result = result.known
    position = plan.place(task.first + row)
    grains = find_recorded(plan, position, scene.chain.grains)
    order = np.argsort(task.grains)
    places: dict[str, Any] = {
        "time": slice(scene.samples),
        "grain": order[np.searchsorted(task.grains, grains, sorter=order)],
    }
    arrays = measure_quantities(motion_of(result), keep, grains, result.gathered)
    if reason:
        add_rest(arrays, measure_quantities(motion_of(whole), keep, grains, whole.gathered))
        leave_out_unsure(arrays, keep)
    else:
        read = [name for name in keep if is_extreme(name) and not is_gathered(scene, name)]
        unsure = leave_out_unsure(arrays, read)
        if unsure:
            reason = f"samples are too far apart to show {', '.join(unsure)}: record more samples"
    columns["reason"][row] = reason
    for name, values in arrays.items():
        index = tuple(places[dimension] for dimension in task.layout.columns[name].dimensions)
        # This is a view of the row, even if the row is a single number.
        columns[name][row, ...][index] = values
    columns["model_error"][row] = result.error_estimate.model
    columns["solver_error"][row] = result.error_estimate.solver
    if "time" in columns:
        columns["time"][row, : scene.samples] = scene.time
    for key, values in plan.draw_values(position, scene.chain.grains).items():
        columns[key][row, : len(values)] = values


def _answer_alone(
    scene: Scene | InputError, engine: Engine, plan: Sweep
) -> Trajectory | Beginning | LmpchainError:
    """Solve one scene or its predictable part, or return the reason for the failure."""
    if isinstance(scene, InputError):
        return scene
    try:
        return simulate(scene, engine, plan.tolerance)
    except ToleranceNotMet as missed:
        return _answer_beginning(scene, engine, plan, missed) or missed
    except (InputError, RunFailed) as error:
        return error


def _answer_beginning(
    scene: Scene, engine: Engine, plan: Sweep, missed: ToleranceNotMet
) -> Beginning | None:
    """Simulate the predictable part of a scene; return None if it determines no quantity."""
    keep = [name for name in plan.keep if is_extreme(name)]
    if missed.known_until == math.inf or not keep:
        return None
    # The run ends slightly earlier, because the combined error of all runs must meet the tolerance.
    beginning = scene.replace(duration=KNOWN * missed.known_until, samples=2)
    beginning = with_gathered(beginning, keep, engine.moves_grains)
    try:
        known = simulate(beginning, engine, plan.tolerance)
        # This run with equal steps is one of many equally likely ones; it shows possible later
        # changes.
        steady = engines.Native(known.cost.integrator, step=known.cost.step_s)
        whole = simulate(scene, steady)
    except LmpchainError:
        return None
    return Beginning(known, whole, str(missed))
