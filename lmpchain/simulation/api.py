"""Simulation of a scene with an engine: `simulate` and `resume`."""

from __future__ import annotations

import math
import mmap
import time
from collections.abc import Generator, Iterable, Iterator, Mapping
from contextlib import AbstractContextManager, closing, nullcontext, suppress
from os import PathLike
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from .. import engines
from ..engines.base import Engine, Run
from ..engines.cost_model import announce, check_time, in_words, is_long
from ..engines.step_control import AVERAGES, PATIENCE, Attempt, Outcome, solve_to_tolerance
from ..errors import InputError, LmpchainError, ToleranceNotMet, check_tolerance, shown
from ..integrators.methods import BY_NAME
from ..scene.facts import LightCone
from ..scene.scene import Scene, check_scene
from ..trajectory.record import LARGEST_ERROR, Block
from ..trajectory.trajectory import Trajectory
from ..util.arrays import Array, check_flags
from ..util.memory import free_memory
from ..util.progress import RATE, ProgressBar
from ..util.remarks import warn
from .accumulation import GatheringRun, at_samples, of_engine
from .choice import choose, engine_for, fall_back, record, refusals

if TYPE_CHECKING:
    from .run_folder import RunFolder

ESTIMATE_S = 2.0  # Time between two error estimates for the progress bar, s.


def simulate(
    scene: Scene,
    engine: str | Engine = "auto",
    tolerance: float = 1e-6,
    *,
    on_miss: Literal["raise", "warn"] = "raise",
    progress: bool = False,
    folder: str | PathLike[str] | None = None,
    max_wall: float | None = None,
    **options: Any,
) -> Trajectory:
    """Simulate a scene and return its trajectory.

    Parameters
    ----------
    scene : Scene
        The scene to simulate.
    engine : str or Engine
        A name (see `engines.names()`), an engine object, or "auto" for the engine that
        `lmpchain.plan` chooses. If the run shows that the equation of this engine leaves out too
        much, "auto" solves Eq. (1) instead.
    tolerance : float
        Largest relative error, as defined in `ErrorEstimate`. With "auto" it limits the errors of
        equation and solver together, and with a named engine the error of the solver. With a given
        step no tolerance is enforced.
    on_miss : "raise" or "warn"
        Whether to raise an error or to warn if the tolerance cannot be met.
    progress : bool
        Whether to show a progress bar.
    folder : path, optional
        Run folder to create, see `lmpchain.simulation.run_folder`. Samples are written to disk
        during the run, and the arrays of the trajectory are read from there. After a stop of any
        kind `resume` continues the run.
    max_wall : float, optional
        Time after which a run in a folder stops, s.
    **options
        Options of a named engine.

    Returns
    -------
    Trajectory
        The motion of the recorded grains, with its error estimate and cost.

    Raises
    ------
    InputError
        If the engine cannot solve the scene, or if an option is wrong.
    ToleranceNotMet
        If the tolerance cannot be met. The exception has the reason and, unless the miss was clear
        before the run, the trajectory. The run of an unpredictable scene stops at the
        predictability horizon.
    RunFailed
        If the integration breaks down at a given step.
    Stopped
        If the time `max_wall` is over. The folder then contains all samples so far. After Ctrl-C
        and SIGTERM they are also written before the program ends.

    Examples
    --------
    >>> from lmpchain import Chain, Impulse
    >>> chain = Chain(grains=40, material="glass", diameter=1e-3)
    >>> scene = Scene(chain=chain, excitation=Impulse(velocity=1e-6), duration=50e-6)
    >>> t = simulate(scene, engine="native", tolerance=1e-9)
    >>> t.displacement.shape, bool(t.error_estimate.total <= 1e-9)
    ((101, 40), True)
    """
    check_scene(scene)
    check_tolerance(tolerance)
    check_on_miss(on_miss)
    check_flags(progress=progress)
    chosen = engine_for(engine, **options)
    if reasons := refusals(scene, chosen):
        raise InputError(reasons)
    asked = scene, chosen, tolerance, on_miss == "warn"
    if folder is None:
        if max_wall is not None:
            raise InputError.at(
                "max_wall", "requires a run folder, which keeps finished samples; name one"
            )
        memory = _Memory(*asked)
        return _conclude(memory, *_answer(memory, progress))
    from .run_folder import Requests, RunFolder

    with RunFolder(folder, Requests(max_wall), *asked) as output:
        answer = _answer(output, progress)
    return _conclude(output, *answer)


def check_on_miss(on_miss: Any) -> None:
    """Raise `InputError` unless an option is "raise" or "warn"."""
    if not isinstance(on_miss, str) or on_miss not in ("raise", "warn"):
        raise InputError.at("on_miss", f'must be "raise" or "warn" (got {shown(on_miss)})')


def resume(
    folder: str | PathLike[str],
    *,
    max_wall: float | None = None,
    progress: bool = False,
    ranks: int | None = None,
) -> Trajectory:
    """Continue a run in a folder; the result is bit for bit equal to an uninterrupted run.

    Parameters
    ----------
    folder : path
        Folder of `simulate(..., folder=...)` or `lmpchain run -o FOLDER/`. A finished run is only
        read.
    max_wall : float, optional
        Time after which the run stops again, s.
    progress : bool
        Whether to show a progress bar.
    ranks : int, optional
        Number of MPI ranks that share the column in LAMMPS from now on; by default the previous
        number. The result is bit for bit the same for any number.

    Returns
    -------
    Trajectory
        The trajectory of the whole run.

    Raises
    ------
    InputError
        If this is not a run folder, if another process uses it, or if the engine cannot use these
        ranks.
    LmpchainError
        If the run fails, under the same conditions as in `simulate`.
    """
    from .run_folder import Requests, RunFolder, status

    state = status(folder)
    if state["state"] == "finished":
        trajectory = Trajectory.load(folder)
        if state["reason"] and not state["best_effort"]:
            horizon_s = state["known_until"]
            raise ToleranceNotMet(
                state["reason"], trajectory, math.inf if horizon_s is None else horizon_s
            )
        return trajectory
    with RunFolder(folder, Requests(max_wall), ranks=ranks) as output:
        answer = _answer(output, progress)
    return _conclude(output, *answer)


def _answer(output: _Memory | RunFolder, progress: bool) -> tuple[Trajectory, Outcome[Any]]:
    """Solve the rest of a scene, with another engine if the model error is too large."""
    attempt = output.attempt or _first(output, output.scene)
    with output.requests:
        while True:
            scene = output.scene.until(attempt.known_until)
            engine = output.prepare(output.engine or engines.plain(attempt.proposal.engine))
            try:
                outcome, gathered = _solve(scene, engine, attempt, output, progress)
            except ToleranceNotMet as limit:
                attempt = _shorten(output, scene, limit)
                continue
            try:
                # A named engine is never replaced.
                error = outcome.error
                following = None if output.engine else fall_back(scene, outcome.attempt, error)
            except ToleranceNotMet as refusal:
                outcome = outcome._replace(missed=attempt.refusal or refusal.reason)
                break
            if not following:
                break
            cost = outcome.cost
            # The cost of the answer includes the time of the first engine.
            attempt = following._replace(
                refusal=attempt.refusal,
                known_until=attempt.known_until,
                planned_s=cost.setup_s + following.planned_s,
                spent_s=cost.integration_s + cost.estimate_s,
                compiled_s=cost.compile_s,
            )
    return output.finish(outcome, gathered), outcome


def _first(output: _Memory | RunFolder, scene: Scene) -> Attempt:
    """Return the first attempt at a scene, or at its predictable part."""
    return choose(scene, output.engine, output.tolerance, output.best_effort)


def _shorten(output: _Memory | RunFolder, scene: Scene, limit: ToleranceNotMet) -> Attempt:
    """Return the first attempt at a scene up to its predictability horizon.

    Raises
    ------
    ToleranceNotMet
        If the horizon precedes the second sample, or if there is no attempt.
    """
    beginning = scene.until(limit.known_until)
    if beginning is scene:
        raise limit
    attempt = _first(output, beginning)
    return attempt._replace(refusal=limit.reason, known_until=limit.known_until)


def _solve(
    scene: Scene,
    engine: Engine,
    attempt: Attempt,
    output: _Memory | RunFolder,
    progress: bool,
) -> tuple[Outcome[Any], dict[str, Array]]:
    """Solve a scene with one engine; return the outcome, and the quantities of the scene."""
    scene_part = engine.part(scene)
    # A run that accumulates quantities yields samples of the whole scene itself.
    cone = None if engine.whole or scene.quantities else scene.light_cone
    state: Mapping[str, Array] = {}
    gathering: GatheringRun | None = None
    solved: Run | None = None

    def begin(attempt: Attempt) -> Mapping[str, Array] | None:
        nonlocal state
        state = output.begin(attempt) or {}
        _announce(scene, attempt, 1 - output.samples / scene.samples)
        # An attempt from t = 0 has no state.
        return (of_engine(state) or None) if state else None

    def collect(run: Run) -> Any:
        nonlocal gathering, solved
        solved = run
        if scene.quantities:
            run = gathering = GatheringRun(run, engine, [scene], [scene_part], state)
        if not progress:
            return output.collect(run, _expand(_on_time(run.blocks()), cone))
        with closing(_show_progress(run, engine.name, scene.samples, output.samples)) as blocks:
            return output.collect(run, _expand(_on_time(blocks), cone))

    outcome = solve_to_tolerance(engine, [scene_part], attempt, collect, begin, output.best_effort)
    gathered = gathering.results([outcome.error.total])[0] if gathering else {}
    for energies in solved.energies(outcome.errors) if solved else []:
        gathered |= at_samples(scene, energies)
    return outcome, gathered


def _announce(scene: Scene, attempt: Attempt, left: float) -> None:
    """Announce a long attempt, with the reason and cheaper choices.

    `left` is the fraction of the samples that remains.
    """
    cost_s = left * attempt.proposal.cost_s
    if is_long(cost_s + attempt.spent_s):
        cures = ", ".join(["a shorter duration", *_cheaper(scene, attempt, cost_s)])
        cure = f"{cures} takes less; a run folder keeps finished samples"
        announce(cost_s, attempt.work(scene.samples), cure, attempt.spent_s)


def _cheaper(scene: Scene, attempt: Attempt, cost_s: float) -> Iterator[str]:
    """Yield choices with a shorter expected time than an attempt, with these times."""
    if attempt.proposal.fixed:
        yield "a longer step"
        return
    tolerance = attempt.tolerance
    method = BY_NAME.get(attempt.proposal.integrator)
    if method and 10 * tolerance < 1:
        tenth_s = cost_s / 10 ** (1 / method.order)
        yield f"a tolerance of {10 * tolerance:.2g} (about {in_words(tenth_s)})"
    with suppress(LmpchainError):
        best = choose(scene, None, tolerance, True)
        if best.proposal.cost_s < cost_s / 2:
            yield f"the engine {best.proposal.engine} (about {in_words(best.proposal.cost_s)})"


def _on_time(blocks: Iterator[Block]) -> Iterator[Block]:
    """Yield blocks; raise `TooLong` if they take far more time than the budget."""
    for block in blocks:
        yield block
        check_time()


def _expand(blocks: Iterator[Block], cone: LightCone[Scene] | None) -> Iterator[Block]:
    """Return blocks of the light cone as blocks of the whole scene."""
    if cone is None:
        return blocks
    rows = cone.rows
    columns = cone.columns
    return (
        Block(block.samples, block.displacement[:, :, rows], block.velocity[:, :, rows], columns)
        for block in blocks
    )


def _conclude(
    output: _Memory | RunFolder, trajectory: Trajectory, outcome: Outcome[Any]
) -> Trajectory:
    """Return the trajectory, with warnings; raise `ToleranceNotMet` if the tolerance was missed."""
    if "redone" in trajectory.provenance:
        warn(trajectory.provenance["redone"], stacklevel=3)
    model = trajectory.error_estimate.model
    bound = min(outcome.error.model_bound, LARGEST_ERROR)
    if model > output.tolerance:
        limit = f" (at most {bound:.2g})" if bound > model else ""
        size = f"about {model:.2g} of the solution{limit}"
        if model == LARGEST_ERROR:
            size = f"all of the solution, an error of {LARGEST_ERROR:g}"
        error = f"Eq. ({trajectory.equation}) leaves out {size}"
        remark = f"{error}, more than {output.tolerance:g}. {outcome.error.remark}"
        warn(remark.rstrip(". "), stacklevel=3)
    if not outcome.missed and outcome.known_until < math.inf:
        # With a given step there is no tolerance to report.
        cannot = f"this scene amplifies round-off beyond {PATIENCE.visible:g} of the motion"
        time_s = f"from about t = {outcome.known_until:.4g} s on"
        warn(f"{cannot} {time_s}, whatever the step is: use {AVERAGES}", stacklevel=3)
    if outcome.missed:
        if not output.best_effort:
            raise ToleranceNotMet(outcome.missed, trajectory, outcome.known_until)
        warn(outcome.missed, stacklevel=3)
    return trajectory


LARGE_BYTES = 2**26  # The free memory is checked for samples of more than this number of bytes.


class _Memory:
    """A run whose blocks are collected in memory, with its options; `engine` None means "auto"."""

    attempt: Attempt | None = None
    # Number of samples from an earlier process.
    samples = 0
    # There are no stop requests here: signals act at once.
    requests: AbstractContextManager[Any] = nullcontext()

    def __init__(self, scene: Scene, engine: Engine | None, tolerance: float, best_effort: bool):
        self.scene = scene
        self.engine = engine
        self.tolerance = tolerance
        self.best_effort = best_effort

    def prepare(self, engine: Engine) -> Engine:
        """Store the engine that solves the scene, and return it."""
        self._answering = engine
        return engine

    def begin(self, attempt: Attempt) -> Mapping[str, Array] | None:
        """Return no state, so that the attempt starts at t = 0."""
        self._known = scene = self.scene.until(attempt.known_until)
        # Memory pages of grains that the wave does not reach are never written.
        cone = scene.light_cone
        moving = (scene.recorded if cone is None else scene.recorded[cone.columns]).size
        if LARGE_BYTES < 16 * scene.samples * moving > free_memory():
            raise _too_large(scene.samples, moving)
        return None

    def collect(self, _: Run, blocks: Iterable[Block]) -> tuple[Array, Array]:
        """Return the displacement and velocity, (T, G) m and m/s."""
        scene = self._known
        u = v = np.empty(0)
        for block in blocks:
            # A single block that contains the whole result is not copied.
            if block.displacement.shape[1] == scene.samples and block.columns == slice(None):
                u = block.displacement[0]
                v = block.velocity[0]
                continue
            if not u.size:
                shape = scene.samples, scene.count(scene.chain)
                try:
                    u, v = (_zeros(shape, block.displacement.shape[2]) for _ in range(2))
                except (MemoryError, ValueError, OSError):
                    raise _too_large(*shape) from None
            u[block.samples, block.columns] = block.displacement[0]
            v[block.samples, block.columns] = block.velocity[0]
        return u, v

    def finish(
        self, outcome: Outcome[tuple[Array, Array]], gathered: dict[str, Array]
    ) -> Trajectory:
        """Return the trajectory."""
        scene = self._known
        engine = self._answering
        displacement, velocity = outcome.collected
        return Trajectory(
            scene=scene,
            engine=engine.name,
            equation=engine.equation,
            time=scene.time.copy(),
            grains=scene.recorded.copy(),
            displacement=displacement,
            velocity=velocity,
            error_estimate=outcome.error.estimate,
            cost=outcome.cost,
            provenance=record(engine, scene, outcome.attempt.proposal, self.tolerance),
            gathered=gathered,
        )


def _too_large(samples: int, grains: int) -> InputError:
    """Return the error for a trajectory that does not fit into memory."""
    return InputError.at(
        "samples",
        f"{16e-9 * samples * grains:.3g} GB of samples do not fit into "
        f"{free_memory() / 1e9:.3g} GB of free memory: record fewer samples or grains, or use a "
        "run folder (-o FOLDER/)",
    )


def _zeros(shape: tuple[int, int], moving: int) -> Array:
    """Return zeros whose columns use memory only when they are written.

    If few columns move, small pages are used, because huge pages would also store the zeros between
    these columns.
    """
    if 2 * moving > shape[1] or shape[1] < mmap.PAGESIZE:
        return np.zeros(shape)
    pages = mmap.mmap(-1, 8 * shape[0] * shape[1])
    if hasattr(mmap, "MADV_NOHUGEPAGE"):
        pages.madvise(mmap.MADV_NOHUGEPAGE)
    return np.frombuffer(pages).reshape(shape)


def _show_progress(run: Run, name: str, samples: int, done: int) -> Generator[Block, None, None]:
    """Yield the blocks of a run, and show progress, speed and error so far."""
    estimated = time.monotonic()
    with ProgressBar(samples, name, " samples", done=done, layout=RATE) as bar:
        for block in run.blocks():
            yield block
            bar.reach(max(block.samples.stop, run.progress * samples))
            if time.monotonic() > estimated + ESTIMATE_S:
                bar.remark(f"error {run.errors()[0].estimate.total:.1g}")
                estimated = time.monotonic()
