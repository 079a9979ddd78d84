"""True error of a user's run, split into step and rounding error, and steps that reduce it."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from os import PathLike
from typing import Any, NamedTuple

import numpy as np

from ..engines.lammps.deck import deck_steps
from ..engines.lammps.deck_reader import read_deck
from ..engines.lammps.engine import HEIGHTS
from ..engines.native import Native
from ..errors import InputError, shown
from ..integrators.methods import BY_NAME, LAGGED, SPLITTINGS
from ..measure import energy, front
from ..scene.scene import Scene, check_scene
from ..trajectory.dump_frames import is_dump
from ..trajectory.record import steps_over
from ..trajectory.trajectory import Trajectory
from ..util.lazy import listed
from ..util.notebook import Shown
from ..util.tables import align, finite, number, wrap
from .comparison import error, errors
from .cures import Cure, cures, distance, height_round_off, stability_limit, twin_run
from .reference import Reference
from .truth import as_trajectory, truth

__dir__ = listed(__name__)

UNKNOWN_METHOD = "unknown"  # Integrator of a dump, which does not name it.
ARRIVAL = 0.1  # Largest uncertainty of an arrival, as a fraction of the travel time.


@dataclass(frozen=True)
class DigitLimits:
    """Limits within which rounding explains how far a run is from a native run with the same steps.

    Attributes
    ----------
    printed : float
        Largest distance in units of the rounding error of the printed numbers.
    heights : float
        Largest distance in units of the bound on the rounding error of heights. Reflections amplify
        this rounding error up to tenfold.
    amplified : float
        Error of the reference above which the scene amplifies rounding errors.
    """

    printed: float = 2.0
    heights: float = 10.0
    amplified: float = 1e-15


DIGITS = DigitLimits()


class ArrivalError(NamedTuple):
    """Error of the arrival of the front relative to its travel time, the time, s, and the grain."""

    relative: float
    seconds: float
    grain: int


class Cause(NamedTuple):
    """A cause of an error: the equation, the time step, or rounding.

    Attributes
    ----------
    name : str
        Name of the cause.
    error : float
        Relative error due to this cause, defined as the error of the run.
    why : str
        Explanation of the cause.
    """

    name: str
    error: float
    why: str


@dataclass(frozen=True, eq=False, repr=False)
class RunCheck(Shown):
    """The true error of a run, its causes, and steps that reach smaller errors.

    Errors are relative to the largest motion of any grain at any time of the run.

    Attributes
    ----------
    subject : str
        File, folder or engine that was checked.
    error, error_displacement, error_velocity : float
        Larger of the two other errors; error of the displacement; error of the velocity. For a
        deck, these are expected errors.
    error_energy : float
        Largest difference of the energy above rest, relative to the largest energy; NaN if
        grains that move were not recorded, or if the ground depends on the time.
    arrival : ArrivalError or None
        Arrival error of the velocity front; None if no front passes, or if samples do not resolve
        it.
    integrator : str
        Name of the integrator; empty for a solution without steps.
    step_s, steps : float, int
        Largest step, s; number of steps. Both are 0 for a solution without steps.
    limit_s : float
        Longest stable step of the integrator on the chain at rest, s; infinite without load.
    causes : tuple of Cause
        Causes of the error: equation or step, and digits.
    cures : tuple of Cure
        Steps with which an integrator reaches smaller errors.
    reference : Reference
    """

    subject: str
    error: float
    error_displacement: float
    error_velocity: float
    error_energy: float
    arrival: ArrivalError | None
    integrator: str
    step_s: float
    steps: int
    limit_s: float
    causes: tuple[Cause, ...]
    cures: tuple[Cure, ...]
    reference: Reference

    @property
    def cause(self) -> str:
        """The name of the largest cause."""
        return max(self.causes, key=lambda cause: cause.error).name

    def exceeds(self, tolerance: float) -> bool:
        """Return whether the error is above a tolerance or NaN."""
        return not self.error <= tolerance

    def _summary(self) -> Iterator[Sequence[str]]:
        yield "error", _percent(self.error), "the larger of displacement and velocity"
        yield "  displacement", _percent(self.error_displacement), ""
        yield "  velocity", _percent(self.error_velocity), ""
        unknown = math.isnan(self.error_energy) and math.isfinite(self.error)
        why = "moving grains were not recorded, or the ground depends on time" if unknown else ""
        yield "energy", number(self.error_energy, ".2g", missing="-"), why
        if self.arrival:
            late = f"{self.arrival.seconds:.2g} s at grain {self.arrival.grain}"
            yield "front arrival", f"{self.arrival.relative:.2g}", f"of its travel time: {late}"
        elif math.isfinite(self.error):
            yield "front arrival", "-", "no front passes, or samples do not resolve it"
        for cause in self.causes:
            yield f"due to {cause.name}", _percent(cause.error), ""

    def table(self) -> str:
        """Return errors, causes and cures as text, within 80 columns."""
        lines = wrap(self.subject)
        if self.integrator:
            steps = steps_over(self.steps, self.step_s, float(self.reference.time[-1]))
            lines = wrap(f"{self.subject}, {steps} by {self.integrator}")
        lines += align(self._summary())
        for cause in self.causes:
            lines += wrap(f"{cause.name}: {cause.why}")
        if self.cures:
            lines += ["", *align(self._remedies())]
            if self.integrator == LAGGED.name:
                lines += wrap(
                    f"{LAGGED.name} is `fix nve`, whose damping forces use the velocity of the "
                    "previous half step, so that its order is 1; verlet is `fix mvv/dpd 1.0` here, "
                    "of order 2, as `lmpchain deck` writes it."
                )
            lines += wrap(
                "digits in LAMMPS: rounding error of heights, with the physical diameter, or with "
                "--diameter gauge if it is too large with the physical one. `lmpchain deck` writes "
                "verlet and kahan-li6; `lmpchain run` also offers rkn6."
            )
        lines += wrap(f"reference: {self.reference.method}; error {self.reference.error:.0e}")
        return "\n".join(lines)

    def _remedies(self) -> Iterator[Sequence[str]]:
        yield "to reach", "integrator", "step", "steps", "error", "digits in LAMMPS"
        for cure in self.cures:
            drawn = " (gauge)" if cure.diameter == "gauge" else ""
            yield (
                f"{cure.target:.0e}",
                cure.integrator,
                number(cure.step_s, unit="s", missing="none"),
                str(cure.steps or ""),
                number(cure.error, ".1e"),
                number(cure.heights, ".0e", missing="-") + drawn if cure.steps else "",
            )

    def to_json(self) -> dict[str, Any]:
        """Return the numbers for a JSON file; those that are not finite become None."""
        fields = {key: value for key, value in vars(self).items() if key != "reference"}
        return finite(fields) | {
            "reference": {"method": self.reference.method, "error": self.reference.error},
            "arrival": self.arrival and self.arrival._asdict(),
            "cause": self.cause,
            "causes": [finite(cause._asdict()) for cause in self.causes],
            "cures": [finite(cure._asdict()) for cure in self.cures],
        }


def check(
    run: Trajectory | str | PathLike[str],
    scene: Scene | None = None,
    *,
    units: str | Sequence[float] | None = None,
    progress: bool = False,
) -> RunCheck:
    """Measure the true error of a run and its parts from the time step and from rounding.

    The reference is a Taylor series in extended precision. A native run with the same integrator
    and step has the same error of the time step, but not the same rounding error. The difference
    from this run is therefore the rounding error: of heights in LAMMPS, of single precision, or of
    the digits that a dump leaves out. For a dump, the nearest of the possible methods is assumed:
    velocity Verlet or "kahan-li6" of `lmpchain deck`; in a damped chain, `fix mvv/dpd 1.0` or
    `fix nve` ("lagged-verlet").

    Parameters
    ----------
    run : Trajectory or path
        A trajectory, a file or a folder that lmpchain saved, or a LAMMPS dump.
    scene : Scene, optional
        Scene of the run. A dump requires it; a saved run contains it.
    units : str or (length, time, mass), optional
        Units of a dump, as for `Trajectory.from_dump`.
    progress : bool
        Whether to show a progress bar.

    Returns
    -------
    RunCheck

    Raises
    ------
    InputError
        If the run cannot be read, or if its scene is not the given one.

    Examples
    --------
    >>> from lmpchain import Chain, Impulse, simulate
    >>> from lmpchain.engines import Native
    >>> chain = Chain(grains=30, diameter=1e-3)
    >>> scene = Scene(chain=chain, excitation=Impulse(velocity=1e-4), duration=2e-5)
    >>> found = check(simulate(scene, Native("verlet", step=1e-7)))
    >>> found.cause, f"{found.error:.0e}"
    ('step', '4e-05')
    """
    if scene is not None:
        check_scene(scene)
    if not isinstance(run, Trajectory | str | PathLike):
        message = f"must be a trajectory, or the path of a run (got {shown(run)})"
        raise InputError.at("run", message)
    subject = f"trajectory of {run.engine}" if isinstance(run, Trajectory) else str(run)
    answer = _read(run, scene, units)
    scene = answer.scene
    solution = truth(scene, progress=progress)
    integrator, step, causes = _causes(answer, solution)
    return _record(subject, scene, answer, solution, integrator, step, causes)


def check_deck(
    folder: str | PathLike[str], scene: Scene | None = None, *, progress: bool = False
) -> RunCheck:
    """Predict the error of a LAMMPS deck from `in.column` and `column.data` before it runs.

    Nothing in the deck is executed. The chain is read from the two files, including edits by the
    user. A native run with the integrator and the step of the deck is compared with the reference.
    The rounding error of the heights is an estimate for typical runs.

    Parameters
    ----------
    folder : path
        Folder of a deck that `lmpchain deck` wrote.
    scene : Scene, optional
        Scene for which the deck was written; required only if its force or drive is given by
        points.
    progress : bool
        Whether to show a progress bar.

    Returns
    -------
    RunCheck
        Its error is infinite if the step is not stable.

    Raises
    ------
    InputError
        If the deck is not valid or contains unsupported commands.
    """
    if scene is not None:
        check_scene(scene)
    if not isinstance(folder, str | PathLike):
        raise InputError.at("folder", f"must be the path of a deck (got {shown(folder)})")
    deck = read_deck(folder, scene)
    scene = deck.scene
    solution = truth(scene, progress=progress)
    twin = twin_run(scene, deck.integrator, deck.step)
    steps = round(scene.duration / deck.step)
    heights = height_round_off(scene, deck.integrator, steps, solution, deck.gauge)
    why = "expected rounding error of the heights that LAMMPS stores"
    printed = 0.5 * 10.0 ** (1 - deck.digits)
    if printed > heights:
        why = _few_digits(f"the dump will have {deck.digits} digits")
    digits = Cause("digits", max(heights, printed), why)
    causes = (_step_cause(scene, twin, solution, deck.integrator, deck.step), digits)
    return _record(str(folder), scene, twin, solution, deck.integrator, deck.step, causes)


def _read(
    run: Trajectory | str | PathLike[str],
    scene: Scene | None,
    units: str | Sequence[float] | None,
) -> Trajectory:
    """Return the trajectory of a run; raise `InputError` if it is incomplete or invalid."""
    if isinstance(run, Trajectory):
        answer = run
    elif is_dump(run):
        if scene is None:
            cure = "create it with lmpchain new scene.toml --from DUMP"
            raise InputError.at(
                "scene", f"is missing, and a dump does not contain its scene: {cure}"
            )
        return Trajectory.from_dump(run, scene, units=units)
    else:
        answer = Trajectory.load(run)
    if units is not None:
        raise InputError.at("units", "is only for a LAMMPS dump: leave it out for a saved run")
    if scene is not None and scene != answer.scene:
        raise InputError.at("scene", "is not the scene of the run: leave it out for a saved run")
    return answer


def _causes(answer: Trajectory, solution: Reference) -> tuple[str, float, tuple[Cause, ...]]:
    """Return the integrator, the step, s, and the causes of the error of a trajectory."""
    scene = answer.scene
    cost = answer.cost
    wrong = error(answer, solution)
    if cost.integrator not in (*BY_NAME, UNKNOWN_METHOD):
        why = f"it solves Eq. ({answer.equation}) without time steps"
        return "", 0.0, (Cause("equation", wrong, why),)
    if answer.engine == Native.name:
        engine = Native(cost.integrator)
        rounding = engine.typical_round_off(scene, cost.steps, float(solution.scale[1]))
        step = Cause("step", wrong, _compare_with_limit(scene, engine.integrator, cost.step_s))
        why = "expected rounding error of double precision; displacements are stored, not heights"
        return engine.integrator, cost.step_s, (step, Cause("digits", rounding, why))
    pairs = _possible_steps(answer)
    twins = [(twin_run(scene, *pair), *pair) for pair in pairs]
    nearest: tuple[Trajectory | None, str, float] = twins[0]
    least = math.inf
    for candidate in twins:
        if candidate[0] is not None and (near := distance(answer, candidate[0], solution)) < least:
            nearest = candidate
            least = near
    twin, integrator, step_s = nearest
    step = _step_cause(scene, twin, solution, integrator, step_s)
    return integrator, step_s, (step, _digits(answer, solution, integrator, step_s, least))


def _possible_steps(answer: Trajectory) -> list[tuple[str, float]]:
    """Return possible integrators and steps, s, of a run, the most likely first."""
    name = answer.cost.integrator
    if name != UNKNOWN_METHOD:
        return [(name, answer.cost.step_s)]
    pairs = [("verlet", answer.cost.step_s)]
    composed = SPLITTINGS["kahan-li6"]
    runs = deck_steps(composed)
    # A deck of lmpchain with a composed method takes several LAMMPS steps per time step.
    if answer.scene.chain.damped:
        # The default of most users is fix nve.
        pairs.append((LAGGED.name, answer.cost.step_s))
    elif answer.cost.steps % (runs * (answer.time.size - 1)) == 0:
        pairs.append((composed.name, runs * answer.cost.step_s))
    return pairs


def _compare_with_limit(scene: Scene, integrator: str, step: float) -> str:
    limit = stability_limit(scene, integrator)
    if limit == math.inf:
        return f"{step:.3g} s; a chain without load has no stability limit at rest"
    if step > limit:
        return f"{step:.3g} s is beyond the stability limit of {limit:.3g} s: the run breaks down"
    return f"{step:.3g} s is {step / limit:.2g} of the stability limit, {limit:.3g} s"


def _step_cause(
    scene: Scene, twin: Trajectory | None, solution: Reference, integrator: str, step: float
) -> Cause:
    """Return the error caused by the time step; infinite if a run with this step breaks down."""
    why = _compare_with_limit(scene, integrator, step)
    if twin is not None:
        return Cause("step", error(twin, solution), why)
    breaks = "the run breaks down"
    return Cause("step", math.inf, why if breaks in why else f"{why}, but {breaks}")


def _digits(
    answer: Trajectory, solution: Reference, integrator: str, step: float, distance: float
) -> Cause:
    """Return the rounding error of a run, from its distance to a native run with the same step."""
    if distance == math.inf:
        return Cause("digits", 0.0, "unknown, because a native run with the same steps breaks down")
    scene = answer.scene
    digit, speed_digit = (
        float(answer.provenance.get(f"{name}_digit", 0.0)) for name in ("displacement", "velocity")
    )
    # Heights at rest are rounded as well.
    rounded = digit if answer.provenance.get("displacement") != "v_phi" else digit / 2
    printed = float(np.max(np.array([rounded, speed_digit / 2]) / solution.scale))
    steps = round(scene.duration / step)
    heights = height_round_off(scene, integrator, steps, solution)
    # If the scene amplifies rounding, the rounding error of the run grows as much.
    heights *= max(1.0, solution.error / DIGITS.amplified)
    if distance <= DIGITS.printed * printed and printed > heights:
        places = max(1, round(-math.log10(min(printed, 0.1))))
        why = _few_digits(f"the dump has about {places} digits of the largest motion")
    elif distance <= DIGITS.heights / HEIGHTS.typical * heights:
        why = "rounding error of the heights that LAMMPS stores"
        if answer.provenance.get("diameter") != "gauge":
            why += ": smaller with --diameter gauge"
    else:
        return Cause(
            "another cause",
            distance,
            f"the run differs from {integrator} with this step by more than rounding: it had "
            "another step or integrator, single precision, or forces that the scene does not "
            "contain",
        )
    return Cause("digits", distance, why)


def _few_digits(fault: str) -> str:
    return f"{fault}: write all digits with dump_modify ... format float %.17g"


def _record(
    subject: str,
    scene: Scene,
    answer: Trajectory | None,
    solution: Reference,
    integrator: str,
    step: float,
    causes: tuple[Cause, ...],
) -> RunCheck:
    """Return the record of a run, also of a run that broke down."""
    displacement = velocity = math.inf
    energy_error = math.nan
    arrival = None
    steps = round(scene.duration / step) if step else 0
    if answer is not None:
        if answer.cost.integrator != UNKNOWN_METHOD and step:
            # Adaptive runs make more steps than runs with equal steps.
            steps = answer.cost.steps
        displacement, velocity = errors(answer, solution)
        true = as_trajectory(answer.scene, solution)
        energy_error = _energy_error(answer, true)
        arrival = _arrival(answer, true)
    return RunCheck(
        subject=subject,
        error=float(np.maximum(displacement, velocity)),
        error_displacement=displacement,
        error_velocity=velocity,
        error_energy=energy_error,
        arrival=arrival,
        integrator=integrator,
        step_s=step,
        steps=steps,
        limit_s=stability_limit(scene, integrator) if integrator else math.inf,
        causes=causes,
        cures=cures(scene, solution, integrator),
        reference=solution,
    )


def _energy_error(answer: Trajectory, true: Trajectory) -> float:
    """Return the largest error of the energy above rest, relative to the largest energy."""
    try:
        total, exact = (energy.ledger(run).total for run in (answer, true))
    except InputError:
        # Grains that move were not recorded, or the ground depends on the time.
        return math.nan
    largest = float(np.abs(exact).max())
    return float(np.abs(total - exact).max()) / largest if largest else math.nan


def _arrival(answer: Trajectory, true: Trajectory) -> ArrivalError | None:
    """Return the largest error of the front's travel time where samples resolve the front."""
    try:
        tracked, exact = (front.track(run) for run in (answer, true))
    except InputError:
        return None
    # A grain is skipped if a different maximum may be its front.
    clear = exact.time_error <= ARRIVAL * exact.time
    grains, here, there = np.intersect1d(tracked.grain, exact.grain[clear], return_indices=True)
    times = exact.time[clear][there]
    if not grains.size:
        return None
    late = np.abs(tracked.time[here] - times)
    relative = late / times
    worst = int(relative.argmax())
    return ArrivalError(float(relative[worst]), float(late[worst]), int(grains[worst]))


def _percent(value: float) -> str:
    return number(value, ".2g", infinite="infinite")
