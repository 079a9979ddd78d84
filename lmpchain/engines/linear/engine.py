"""Exact solutions of the linearised chain, Eq. (3): by eigenmodes, or by Chebyshev polynomials."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Iterator, Mapping, Sequence
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from ...integrators.kernels.chebyshev import SPAN, terms
from ...scene.scene import Scene
from ...trajectory.record import Block, Cost
from ...util.arrays import EPSILON, Array
from ...util.compilation import clock
from ..base import Candidate, Engine, ErrorBudget, Run, SharperBound
from ..cost_model import seconds
from .model_error import (
    PhaseError,
    bounds,
    decidable,
    dense,
    evaluation_times,
    evaluations,
    least_error,
)
from .solutions import ChebyshevSolution, ModalSolution, Solution

BLOCK = 16  # samples a block, if so many fit
BLOCK_VALUES, SMALL = (
    2**22,
    2**14,
)  # values that are at hand at a time, and that take no time worth speaking of
MOST_MODES = 12_000  # 1.2 GB of eigenvectors
# analysis/calibration/roundoff.py
CANCELS = (
    40.0  # digits in the last place that a burst loses in modes, at the lowest of its frequencies
)
LOOK_VALUES = 2**18  # a contact that opens ends a look: values at a time


class LinearEngine(Engine):
    """An engine for the linearised chain, Eq. (3), exact to round-off."""

    equation: ClassVar[int] = 3
    # timings of `work`: analysis/calibration/cost_model.py; of `round_off`: analysis/calibration/roundoff.py
    batches: ClassVar[bool] = True

    def refuses(self, scene: Scene) -> list[tuple[str, str]]:
        """Return why there is no linear theory of this scene."""
        contacts, reasons = scene.chain.contacts, []
        if not scene.chain.compressed:
            reasons.append(
                (
                    "gravity",
                    "without gravity and load nothing can be linearised; use the engine native",
                )
            )
        elif (contacts.exists & ~contacts.pressed).any():
            reasons.append(
                (
                    "top",
                    "a wall that only touches cannot be linearised; give a top_load or use native",
                )
            )
        if not scene.excitation.linear:
            reasons.append(
                (
                    "excitation",
                    "linear engines know no motion or force by points; use the engine native",
                )
            )
        return reasons

    def candidate(self, scene: Scene, tolerance: float) -> Candidate:
        """Propose the one way there is."""
        (least, most), values = bounds(scene), scene.samples * scene.recorded.size
        look = SharperBound(least, self._seconds(self.work(scene, 0, 0)) - self._seconds(0.0))
        return Candidate(
            step=scene.duration / (scene.samples - 1),
            active_grains=scene.chain.grains,
            model_error=most,
            solver_error=self.round_off(scene),
            cost_s=self._seconds(self.work(scene, scene.samples, values)),
            sharper=look if decidable(scene) else None,
        )

    def _seconds(self, work_s: float) -> float:
        return seconds(self.name, self.start_up_s, work_s)

    def least_model_error(self, scene: Scene) -> float:
        """Return a bound below the model error, from the strike alone."""
        return least_error(scene)

    def bound_model_error(self, scene: Scene, candidate: Candidate) -> float:
        """Bound the model error from the linear solution, evaluated between the samples too."""
        return self.look(scene).at_most

    def estimate_model_error(self, scene: Scene) -> float:
        """Estimate the model error from the linear solution, as a run does."""
        return self.look(scene).error

    def look(self, scene: Scene) -> PhaseError:
        """Follow the linear solution and what it leaves out; end where a contact opens."""
        times, error = np.append(evaluation_times(scene), scene.duration), PhaseError(scene)
        size, every = max(64, LOOK_VALUES // scene.chain.grains), np.ones(times.size, bool)
        for _ in _followed(self.solve(scene, {}), error, times, every, size):
            if error.remark:
                break
        return error

    def round_off(self, scene: Scene) -> float:
        """Return the relative error that rounding makes: that of the frequencies, times the periods."""
        return EPSILON * (10 + scene.chain.band_edge * scene.duration)

    @abstractmethod
    def work(self, scene: Scene, samples: int, values: int) -> float:
        """Return the time for samples and evaluations between them on the reference machine, s."""

    @abstractmethod
    def solve(self, scene: Scene, state: Mapping[str, Array]) -> Solution:
        """Return the solution, from the start or from a kept state."""

    def start(
        self,
        scenes: Sequence[Scene],
        candidate: Candidate,
        state: Mapping[str, Array] | None = None,
    ) -> Run:
        """Start one scene, or a batch of scenes recorded alike."""
        return LinearRun(self, scenes, state or {})

    def refine(self, candidate: Candidate, error: ErrorBudget | None, tolerance: float) -> None:
        """Nothing can be better than round-off."""
        return None

    def describe(self, scene: Scene, candidate: Candidate) -> dict[str, str]:
        """There is nothing to choose."""
        return {}


class Chebyshev(LinearEngine):
    """Exact propagator of Eq. (3) as a sum of Chebyshev polynomials, Eq. (19)."""

    name: ClassVar[str] = "chebyshev"
    start_up_s: ClassVar[float] = 2e-4

    def refuses(self, scene: Scene) -> list[tuple[str, str]]:
        """Return why there is no linear theory of this scene, or no such series of it."""
        reasons, given = super().refuses(scene), scene.excitation
        if (
            given.linear
            and given.does_work
            and not (scene.drive and np.isinf(scene.drive.waveform.end))
        ):
            reasons.append(
                (
                    "excitation",
                    f"{self.name} knows motions that are a sine without end only; use modes",
                )
            )
        return reasons

    def work(self, scene: Scene, samples: int, values: int) -> float:
        """Return the time for the polynomials from one evaluation to the next."""
        z, moments = scene.chain.band_edge * scene.duration, _moments(scene, samples)
        series = min(moments, max(1.0, z / SPAN))
        orders, grains = (
            terms(z / series),
            min(scene.chain.grains, z / 4 + 30),
        )  # on average in a growing light cone
        a_series = 3e-6 + 2 * orders * (7e-8 + 1.7e-9 * grains)
        return (
            series * a_series + moments * (3e-7 + grains * (5e-10 * orders + 2e-9)) + 1e-8 * values
        )

    def solve(self, scene: Scene, state: Mapping[str, Array]) -> Solution:
        """Return the solution, from the start or from a kept state."""
        return ChebyshevSolution(scene, state)


class Modes(LinearEngine):
    """Sum the eigenmodes, Eqs. (14)-(16); one diagonalisation, whatever the number of samples."""

    name: ClassVar[str] = "modes"

    def refuses(self, scene: Scene) -> list[tuple[str, str]]:
        """Return why there is no linear theory of this scene, or no room for its modes."""
        reasons = super().refuses(scene)
        if scene.chain.grains > MOST_MODES:
            reasons.append(
                (
                    "grains",
                    f"eigenvectors of more than {MOST_MODES} grains do not fit; use chebyshev",
                )
            )
        return reasons

    def round_off(self, scene: Scene) -> float:
        """Return the relative error that rounding makes; eigenvectors have their part in it.

        A burst is the sum of three sines whose transients all but cancel, the more the sooner after its beginning.
        """
        rounding, wave = (
            super().round_off(scene) + EPSILON * 4 * scene.chain.grains,
            scene.excitation.waveform,
        )
        if wave and wave.envelope:
            begun = min(1.0, wave.envelope * scene.duration)
            rounding += (
                EPSILON
                * CANCELS
                / begun**2
                * (1 + scene.chain.grains * wave.fastest / scene.chain.band_edge)
            )
        return rounding

    def work(self, scene: Scene, samples: int, values: int) -> float:
        """Return the time for the diagonalisation, and for sums over modes at every evaluation."""
        grains, moments = scene.chain.grains, _moments(scene, samples)
        once, a_moment = (
            6e-8 * grains**2 + 1e-10 * grains**3,
            5e-7 + 3e-8 * grains + 6e-10 * grains**2,
        )
        return once + a_moment * moments + 1e-8 * values

    def solve(self, scene: Scene, state: Mapping[str, Array]) -> Solution:
        """Return the solution, whose start is all that is needed."""
        return ModalSolution(scene)


def _moments(scene: Scene, samples: int) -> int:
    """Return how often a solution is evaluated for so many samples, 0 for a look at it alone."""
    return samples + (0 if samples and dense(scene) else evaluations(scene))


def _followed(
    solution: Solution, error: PhaseError, times: Array, recorded: NDArray[np.bool_], size: int
) -> Iterator[tuple[slice, Array, Array]]:
    """Evaluate a solution at all times, add to its model error, and yield it, so many times at a time."""
    for begin in range(0, times.size, size):
        part = slice(begin, begin + size)
        u, v, reach = solution.at(times[part])
        error.add(times[part], recorded[part], u, v, reach)
        yield part, u, v


class LinearRun(Run):
    """Samples of linear solutions, whichever way they are found."""

    def __init__(
        self,
        engine: LinearEngine,
        scenes: Sequence[Scene],
        state: Mapping[str, Array],
    ):
        began = clock()
        if len({(s.chain.grains, s.samples, s.duration, s.grains) for s in scenes}) != 1:
            raise ValueError("a batch needs chains of one length, recorded alike")
        self._engine, self._scene = engine, scenes[0]
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
        """Yield the answer."""
        times, grains = self._scene.time, self._scene.chain.grains
        size = max(1, min(max(BLOCK, SMALL // grains), BLOCK_VALUES // grains))
        while self._sample < self._scene.samples:
            began = clock()
            here = slice(self._sample, min(self._sample + size, self._scene.samples))
            before = times[self._sample - 1] if self._sample else -1.0
            shape = (len(self._solutions), here.stop - here.start, self._rows.size)
            block, evaluated = Block(here, np.empty(shape), np.empty(shape)), 0
            for real, (solution, error) in enumerate(
                zip(self._solutions, self._phase_errors, strict=True)
            ):
                extra = self._between[real]
                extra = extra[(extra > before) & (extra < times[here.stop - 1])]
                moments = np.union1d(times[here], extra) if extra.size else times[here]
                wanted = (
                    np.isin(moments, times[here], assume_unique=True)
                    if extra.size
                    else np.ones(moments.size, bool)
                )
                place, evaluated = 0, evaluated + moments.size
                for part, u, v in _followed(
                    solution, error, moments, wanted, max(1, BLOCK_VALUES // grains)
                ):
                    which, into = (
                        np.ix_(wanted[part], self._rows),
                        slice(place, place + int(wanted[part].sum())),
                    )
                    block.displacement[real, into], block.velocity[real, into] = u[which], v[which]
                    place = into.stop
            self._sample = here.stop
            took, asked = clock() - began, (here.stop - here.start) * len(self._solutions)
            self._integration_s += took * asked / evaluated
            self._estimate_s += took * (1 - asked / evaluated)
            yield block

    @property
    def progress(self) -> float:
        """Part of the samples done."""
        return self._sample / self._scene.samples

    def errors(self) -> list[ErrorBudget]:
        """Return round-off, and what linearising leaves out."""
        differences = np.zeros(self._scene.samples)
        roundoff = self._engine.round_off(self._scene)
        return [
            ErrorBudget(0.0, roundoff, True, differences, phase.error, phase.remark, phase.at_most)
            for phase in self._phase_errors
        ]

    def cost(self) -> Cost:
        """Return what it has cost so far."""
        return Cost(
            integration_s=self._integration_s,
            estimate_s=self._estimate_s,
            setup_s=self._setup_s,
            steps=self._scene.samples - 1,
            force_evaluations=sum(solution.work for solution in self._solutions),
            active_grains=self._scene.chain.grains,
            integrator=self._engine.name,
            step_s=self._scene.duration / (self._scene.samples - 1),
            ranks=1,
        )

    @property
    def scale(self) -> Array:
        """Largest displacement and velocity of any grain at any time, (2, R)."""
        return np.stack([error.scale for error in self._phase_errors], axis=1)

    def state(self) -> dict[str, Array]:
        """Return what `start` needs to go on from the last sample with the same bits."""
        kept = {"sample": np.array(self._sample)}
        for i, (solution, error) in enumerate(
            zip(self._solutions, self._phase_errors, strict=True)
        ):
            kept |= {f"{i}.phase_error": error.state.copy()} | {
                f"{i}.{key}": value for key, value in solution.state().items()
            }
        return kept

    def close(self) -> None:
        """There is nothing to release."""
