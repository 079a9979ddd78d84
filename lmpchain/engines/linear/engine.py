"""Exact solutions of the linearised chain, Eq. (3): by eigenmodes, or by Chebyshev polynomials."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Iterator, Mapping, Sequence
from functools import partial
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from ...chain.ground import is_spring
from ...integrators.kernels.chebyshev import SPAN, terms
from ...integrators.kernels.phase_error import Evaluations
from ...integrators.steps import Steps
from ...scene.scene import Scene
from ...trajectory.record import Block, Cost
from ...util.arrays import EPSILON, Array, last_digit
from ...util.compilation import clock
from ...util.plotting import COLOURS
from ..base import Engine, ErrorBudget, Proposal, Run
from ..cost_model import seconds
from .model_error import PhaseError, dense, evaluation_times, evaluations, expected_error
from .solutions import ChebyshevSolution, LinearSolution, ModalSolution, sum_energies

FROM_BELOW = ("end", "linear engines cannot drive the base; use the native engine")
BLOCK = 16  # Number of samples of a block, if they fit into memory.
# Largest number of values in memory, and number of values of negligible cost.
BLOCK_VALUES = 2**22
SMALL_BLOCK = 2**14
MOST_MODES = 12_000  # The eigenvectors of this number of modes take 1.2 GB.
# Rounding error of the modes of a burst at the lowest of its frequencies, in ulps; see
# analysis/calibration/roundoff.py.
CANCELS = 40.0


class LinearEngine(Engine):
    """An engine for the linearised chain, Eq. (3), exact up to rounding."""

    equation: ClassVar[int] = 3
    # The times of `work` were measured by analysis/calibration/cost_model.py.
    batches: ClassVar[bool] = True

    def refuses(self, scene: Scene) -> list[tuple[str, str]]:
        """Return the reasons why linear theory does not apply to this scene."""
        contacts = scene.chain.contacts
        reasons = [FROM_BELOW] if scene.excitation.from_below else []
        if not scene.chain.compressed:
            why = "without gravity and load nothing can be linearised; use the native engine"
            reasons.append(("gravity", why))
        elif scene.chain.loose_grains:
            reasons.append(("load_grain", f"{scene.chain.loose}, or use native"))
        elif (contacts.exists & ~contacts.pressed).any():
            why = "a wall that only touches cannot be linearised; give a top_load or use native"
            reasons.append(("top", why))
        if not scene.excitation.linear:
            why = "linear engines do not support a motion or force by points; use the native engine"
            reasons.append(("excitation", why))
        return reasons

    def propose(self, scene: Scene, tolerance: float) -> Proposal:
        """Propose the exact solution."""
        return Proposal(
            engine=self.name,
            equation=self.equation,
            steps=Steps.spread(scene.sampling_interval, 1),
            active_grains=scene.chain.grains,
            model_error=expected_error(scene),
            solver_error=self.round_off(scene),
            cost_s=seconds(self.name, self.start_up_s, self.work(scene)),
        )

    def look(self, scene: Scene) -> PhaseError:
        """Compute the linear solution and its model error; stop if a contact opens."""
        times = np.append(evaluation_times(scene), scene.duration)
        error = PhaseError(scene)
        recorded = np.ones(times.size, bool)
        size = max(1, BLOCK_VALUES // scene.chain.grains)
        for _ in _follow(self.solve(scene, {}), error, times, recorded, size):
            # Linear theory becomes invalid when a contact opens.
            if error.remark:
                break
        return error

    def round_off(self, scene: Scene) -> float:
        """Return the relative rounding error, which grows with the phase."""
        return EPSILON * (10 + scene.linear_frequency * scene.duration)

    def most_summed(self, scene: Scene) -> int:
        """Return the largest number of evaluations for the energies of a run.

        The quadrature must not increase the time of a short run much. A forced run may use more
        evaluations, because the energy balance then yields neither the dissipated energy nor the
        work.
        """
        # This number of evaluations times grains takes 40 or 10 ms.
        values = 2**16 if scene.excitation.does_work else 2**14
        return max(values // scene.chain.grains, _evaluations(scene))

    @abstractmethod
    def work(self, scene: Scene) -> float:
        """Return the time for all evaluations on the reference machine, s."""

    @abstractmethod
    def solve(self, scene: Scene, state: Mapping[str, Array]) -> LinearSolution:
        """Return the solution from t = 0 or from a stored state."""

    def start(
        self,
        scenes: Sequence[Scene],
        proposal: Proposal,
        state: Mapping[str, Array] | None = None,
    ) -> Run:
        """Start a run of one scene, or of a batch of scenes with the same recording."""
        return LinearRun(self, scenes, state or {})

    def refine(self, proposal: Proposal, error: ErrorBudget | None, tolerance: float) -> None:
        """Return None, because the only error is rounding."""
        return None


class Chebyshev(LinearEngine):
    """Exact propagator of Eq. (3) as a sum of Chebyshev polynomials, Eq. (19)."""

    name: ClassVar[str] = "chebyshev"
    auto = "cheapest"
    style = (COLOURS["pink"], "D")
    start_up_s: ClassVar[float] = 2e-4

    def refuses(self, scene: Scene) -> list[tuple[str, str]]:
        """Return reasons why linear theory or the series of a single propagator does not apply."""
        reasons = super().refuses(scene)
        excitation = scene.excitation
        # The propagator of the chain and its drive is a constant matrix only for a sine.
        if (
            excitation.linear
            and excitation.does_work
            and not (scene.drive and np.isinf(scene.drive.waveform.end))
        ):
            why = f"{self.name} supports only an endless sine as a drive; use modes"
            reasons.append(("excitation", why))
        return reasons

    def work(self, scene: Scene) -> float:
        """Return the time for the polynomials from one evaluation to the next, s."""
        radians = scene.chain.band_edge * scene.duration
        count = _evaluations(scene)
        series = min(count, max(1.0, radians / SPAN))
        polynomials = series * terms(radians / series)
        reached = min(scene.chain.grains, 30 + radians / 4)  # Mean width of the light cone.
        return 7e-10 * polynomials * (reached + 100) + 1.3e-8 * count * scene.chain.grains

    def solve(self, scene: Scene, state: Mapping[str, Array]) -> LinearSolution:
        """Return the solution from t = 0 or from a stored state."""
        return ChebyshevSolution(scene, state)


class Modes(LinearEngine):
    """Eigenmode sums, Eqs. (14)-(16), by one diagonalisation for any number of samples."""

    name: ClassVar[str] = "modes"
    auto = "cheapest"
    style = (COLOURS["green"], "^")
    dissipates: ClassVar[bool] = True
    knows_ground: ClassVar[bool] = True
    start_up_s: ClassVar[float] = 2.4e-4

    def refuses(self, scene: Scene) -> list[tuple[str, str]]:
        """Return the reasons why linear theory does not apply or its modes exceed the memory."""
        reasons = super().refuses(scene)
        if scene.chain.grains > MOST_MODES:
            why = f"eigenvectors of more than {MOST_MODES} grains do not fit; use chebyshev"
            reasons.append(("grains", why))
        if scene.chain.ground is not None and not is_spring(scene.chain.ground):
            why = "the ground is not a linear spring with a stiffness of 0 or more: use native"
            reasons.append(("chain.ground", why))
        if scene.chain.damped:
            from ...theory.modes import unequal_damping

            cure = "or use the native engine"
            unequal = unequal_damping(scene.chain)
            reasons += [(key, f"{why}, {cure}") for key, equal, why in unequal if not equal]
        return reasons

    def round_off(self, scene: Scene) -> float:
        """Return the relative rounding error, including the error of the eigenvectors.

        A burst is the sum of three sines. Their transients nearly cancel shortly after its start,
        so that the rounding error is larger.
        """
        rounding = super().round_off(scene) + EPSILON * 4 * scene.chain.grains
        wave = scene.excitation.waveform
        if wave and wave.envelope:
            begun = min(1.0, wave.envelope * scene.duration)
            highest = scene.chain.grains * wave.fastest / scene.chain.band_edge
            rounding += EPSILON * CANCELS / begun**2 * (1 + highest)
        if wave and scene.chain.damped:
            # Exponentials of a damped mode cancel in a motion that is slow or has just begun.
            radians = scene.chain.band_edge * scene.duration
            slow = scene.chain.band_edge / wave.fastest * max(1.0, radians**-3)
            rounding += slow * super().round_off(scene)
        return rounding

    def work(self, scene: Scene) -> float:
        """Return the time of the diagonalisation and of sums over modes, s."""
        grains = scene.chain.grains
        return 5.5e-11 * grains**3 + 6e-8 * grains * _evaluations(scene)

    def solve(self, scene: Scene, state: Mapping[str, Array]) -> LinearSolution:
        """Return the solution; it needs no stored state."""
        return ModalSolution(scene)


def _smallest_motion(scene: Scene, largest: Array) -> float:
    """Return the smaller of the largest displacement and velocity, m or m/s; 1 if both are 0."""
    sizes = np.array([*largest, *(np.abs(x).max() for x in scene.initial())])
    return float(sizes[sizes > 0].min(initial=1.0))


def _evaluations(scene: Scene) -> int:
    """Return the number of evaluations of a solution, at samples and between them."""
    return scene.samples + (0 if dense(scene) else evaluations(scene))


def _follow(
    solution: LinearSolution,
    error: PhaseError,
    times: Array,
    recorded: NDArray[np.bool_],
    size: int,
) -> Iterator[tuple[slice, Array, Array]]:
    """Yield a solution, evaluated `size` times at once, and accumulate its model error."""
    for begin in range(0, times.size, size):
        burst = slice(begin, begin + size)
        u, v, reach = solution.at(times[burst])
        error.add(Evaluations(times[burst], recorded[burst], u, v, reach))
        yield burst, u, v


class LinearRun(Run):
    """A run of linear solutions."""

    def __init__(
        self,
        engine: LinearEngine,
        scenes: Sequence[Scene],
        state: Mapping[str, Array],
    ):
        began = clock()
        if len({(s.chain.grains, s.samples, s.duration, s.grains) for s in scenes}) != 1:
            raise ValueError("a batch needs chains of one length with the same recorded grains")
        self._engine = engine
        self._scenes = scenes
        self._scene = scenes[0]
        self._sample = int(state.get("sample", 0))
        self._phase_errors = [
            PhaseError(scene, state.get(f"{i}.phase_error")) for i, scene in enumerate(scenes)
        ]
        self._solutions = [
            engine.solve(
                scene,
                {key: state[f"{i}.{key}"] for key in ("u", "v", "time") if f"{i}.{key}" in state},
            )
            for i, scene in enumerate(scenes)
        ]
        self._rows: NDArray[np.intp] = scenes[0].recorded - 1
        self._between = [
            np.zeros(0) if dense(scene) else evaluation_times(scene) for scene in scenes
        ]
        self._integration_s = self._estimate_s = 0.0
        self._setup_s = clock() - began

    def blocks(self) -> Iterator[Block]:
        """Yield the solution in blocks."""
        grains = self._scene.chain.grains
        size = max(1, min(max(BLOCK, SMALL_BLOCK // grains), BLOCK_VALUES // grains))
        while self._sample < self._scene.samples:
            began = clock()
            samples = slice(self._sample, min(self._sample + size, self._scene.samples))
            count = samples.stop - samples.start
            realisations = len(self._solutions)
            shape = (realisations, count, self._rows.size)
            block = Block(samples, np.empty(shape), np.empty(shape))
            evaluated = sum(self._fill(block, real) for real in range(realisations))
            self._sample = samples.stop
            took = clock() - began
            # Evaluations between the samples are only for the model error.
            integration_s = took * count * realisations / evaluated
            self._integration_s += integration_s
            self._estimate_s += took - integration_s
            yield block

    def _fill(self, block: Block, real: int) -> int:
        """Fill a block with one realisation, and return the number of evaluations."""
        times = self._scene.time
        before = times[block.samples.start - 1] if block.samples.start else -1.0
        between = self._between[real]
        between = between[(between > before) & (between < times[block.samples.stop - 1])]
        moments = np.union1d(times[block.samples], between)
        recorded = np.isin(moments, times[block.samples], assume_unique=True)
        size = max(1, BLOCK_VALUES // self._scene.chain.grains)
        filled = 0
        for burst, u, v in _follow(
            self._solutions[real], self._phase_errors[real], moments, recorded, size
        ):
            rows = np.ix_(recorded[burst], self._rows)
            into = slice(filled, filled + rows[0].size)
            block.displacement[real, into] = u[rows]
            block.velocity[real, into] = v[rows]
            filled = into.stop
        return moments.size

    @property
    def progress(self) -> float:
        """Fraction of the samples that are done."""
        return self._sample / self._scene.samples

    def errors(self) -> list[ErrorBudget]:
        """Return the rounding errors and the model errors."""
        roundoff = self._engine.round_off(self._scene) / EPSILON
        return [
            ErrorBudget(
                0.0,
                roundoff * last_digit(_smallest_motion(scene, phase.scale)),
                1.0,
                phase.error,
                phase.remark,
                phase.at_most,
            )
            for scene, phase in zip(self._scenes, self._phase_errors, strict=True)
        ]

    def energies(self, errors: Sequence[ErrorBudget]) -> list[dict[str, Array]]:
        """Return the dissipated energy, the work and their errors for every realisation."""
        engine = self._engine
        return [
            sum_energies(
                scene,
                partial(engine.solve, scene, {}),
                budget,
                phase.scale,
                engine.most_summed(scene),
            )
            for scene, budget, phase in zip(self._scenes, errors, self._phase_errors, strict=True)
        ]

    def cost(self) -> Cost:
        """Return the cost so far."""
        return Cost(
            integration_s=self._integration_s,
            estimate_s=self._estimate_s,
            setup_s=self._setup_s,
            steps=self._scene.intervals,
            force_evaluations=sum(solution.work for solution in self._solutions),
            active_grains=self._scene.chain.grains,
            integrator=self._engine.name,
            step_s=self._scene.sampling_interval,
            ranks=1,
        )

    @property
    def scale(self) -> Array:
        """Largest displacement and velocity of any grain at any time, (2, R)."""
        return np.stack([error.scale for error in self._phase_errors], axis=1)

    def state(self) -> dict[str, Array]:
        """Return the state of every solution and of its model error at the last sample."""
        state = {"sample": np.array(self._sample)}
        for i, (solution, error) in enumerate(
            zip(self._solutions, self._phase_errors, strict=True)
        ):
            state[f"{i}.phase_error"] = error.state
            state |= {f"{i}.{key}": value for key, value in solution.state().items()}
        return state
