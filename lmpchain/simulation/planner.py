"""The plan of a scene, with reasons, and the calibration of the cost model on this machine."""

from __future__ import annotations

import json
import math
import platform
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from .. import engines
from ..chain.chain import Chain
from ..engines.base import Engine, Proposal
from ..engines.cost_model import PLAUSIBLE, cache_file, measured, speed
from ..errors import check_tolerance
from ..integrators.methods import methods_of
from ..scene.excitation import Impulse
from ..scene.scene import Scene, check_scene
from ..util.files import replacing
from ..util.notebook import Shown
from ..util.plotting import LEAST_ERROR, Axes, chart, finish
from ..util.remarks import warnings_aside
from ..util.tables import align, duration, number, wrap
from ..util.tabular import NamedColumn, Tabular, of_rows
from .api import simulate
from .choice import REFUSED, ask, cheapest, propose, reason

HEAD = ("", "engine", "Eq.", "model", "solver", "grains", "step", "cost")


@dataclass(frozen=True, repr=False)
class Plan(Shown, Tabular):
    """The cheapest choice of engine and step for a scene within a tolerance.

    Attributes
    ----------
    engine : str
        Name of the chosen engine.
    integrator : str
        Name of its integrator; empty if it has none.
    active_grains : int
        Number of grains that are computed.
    step : float
        Step, s; for an exact solution, the time between two samples.
    expected_error : float
        Expected error of equation and solver together; the run measures the error of the equation.
    expected_cost_s : float
        Time for setting up, integrating and estimating the error, s.
    why : str
        Reason for the choice.
    candidates : tuple of Proposal
        Proposals of all engines, including the chosen one.
    tolerance : float
        Largest relative error that is allowed.
    damping_effect : float
        Estimate of the relative change of the solution if damping were neglected; 0 without
        damping.
    damping : str
        The effect of damping as text.
    """

    engine: str
    integrator: str
    active_grains: int
    step: float
    expected_error: float
    expected_cost_s: float
    why: str
    candidates: tuple[Proposal, ...]
    tolerance: float
    damping_effect: float = 0.0
    damping: str = ""

    def table(self) -> str:
        """Return all candidates as a table within 80 columns, and the reason for the first one.

        The column "model" has the errors of the equations, and "solver" those of their solutions.
        """
        sentences = ["model and solver: expected errors of the equation and of its solution"]
        sentences += [f"{_label(each)}: {_verdict(each)}" for each in self._by_price()]
        sentences.append(f"{self.engine} {self.why}")
        if self.damping:
            sentences.append(f"damping: {self.damping}")
        return "\n".join([*align(self._summary()), *wrap(*sentences)])

    def _by_price(self) -> list[Proposal]:
        """Return the candidates: valid ones first, by cost, then the others."""
        return sorted(self.candidates, key=lambda proposal: proposal.price_s)

    def _fields(self) -> Iterator[tuple[str, Any]]:
        yield from (
            (key, value) for key, value in super()._fields() if key not in ("why", "candidates")
        )

    def _summary(self) -> Iterator[Sequence[str]]:
        yield HEAD
        for proposal in self._by_price():
            taken = (proposal.engine, proposal.integrator) == (self.engine, self.integrator)
            yield "*" if taken else "", *_cells(proposal)

    def plot(self, ax: Axes | None = None) -> Axes:
        """Draw expected error against cost of all candidates, and the tolerance; return the axes.

        Filled markers stand for candidates that are expected to meet the tolerance. The ring marks
        the chosen one.
        """
        ax = chart(ax, "expected cost [s]", "expected error, at most", "xy")
        ax.axhline(
            self.tolerance, color="0.4", lw=1, ls="--", label=f"tolerance {self.tolerance:g}"
        )
        for proposal in self.candidates:
            error = max(proposal.model_error + proposal.solver_error, LEAST_ERROR)
            if np.isfinite([error, proposal.cost_s]).all():
                colour, marker = engines.class_of(proposal.engine).style
                # Hollow markers are expected to miss the tolerance.
                filling = colour if proposal.kept else "none"
                label = proposal.engine if proposal.kept else f"{proposal.engine}, dropped"
                style: dict[str, Any] = {"color": colour, "mfc": filling, "ls": "none"}
                ax.plot(proposal.cost_s, error, marker, label=label, **style)
        ax.plot(
            self.expected_cost_s,
            max(self.expected_error, LEAST_ERROR),
            "o",
            ms=15,
            mfc="none",
            mec="k",
            label="chosen",
        )
        ax.margins(0.2)
        return finish(ax)

    def to_json(self) -> dict[str, Any]:
        """Return the plan for a JSON file; unknown numbers are null."""
        fields = dict(self.__dict__)
        # The candidates come last, because they are longest.
        proposals = fields.pop("candidates")
        return fields | {"candidates": [proposal.to_json() for proposal in proposals]}

    def _columns(self) -> Iterator[NamedColumn]:
        return of_rows([proposal.to_json() for proposal in self.candidates])


def plan(scene: Scene, tolerance: float = 1e-6, engine: str | None = None) -> Plan:
    """Return the engine and the step that `simulate` chooses with engine "auto", and the reason.

    Parameters
    ----------
    scene : Scene
        The scene to solve.
    tolerance : float
        Largest relative error of equation and solver together.
    engine : str, optional
        Name of an engine, such as "lammps", whose integrators are compared. By default all engines
        are compared.

    Returns
    -------
    Plan
        The choice, with the proposals of all engines.

    Raises
    ------
    InputError
        If the tolerance is not between 0 and 1, or there is no such engine.
    ToleranceNotMet
        If no engine is expected to meet the tolerance, or if the named engine is not.

    Examples
    --------
    >>> from lmpchain import Chain, Impulse
    >>> strike = Impulse(velocity=8.57e-4)
    >>> scene = Scene(chain=Chain(grains=120, diameter=1e-3), excitation=strike, duration=100e-6)
    >>> plan(scene).engine
    'native'
    """
    check_scene(scene)
    check_tolerance(tolerance)
    if engine is None:
        proposals = propose(scene, tolerance, every=True)
        best = cheapest(proposals)
        why = reason(best, proposals)
        proposals = [_with_step(each, scene, tolerance) for each in proposals]
    else:
        proposals = [ask(each, scene, tolerance) for each in _ways(engine, scene)]
        best = cheapest(proposals)
        why = f"with {best.integrator} is the cheapest way" if best.integrator else "was requested"
    return Plan(
        engine=best.engine,
        integrator=best.integrator,
        active_grains=best.active_grains,
        step=best.step,
        expected_error=best.model_error + best.solver_error,
        expected_cost_s=best.cost_s,
        why=why,
        candidates=tuple(proposals),
        tolerance=tolerance,
        damping_effect=scene.damping_effect,
        damping=scene.damping_remark,
    )


def _ways(name: str, scene: Scene) -> list[Engine]:
    """Return an engine with each of its integrators that applies to a scene."""
    engine = engines.get(name)
    methods = [kind for kind in methods_of(scene.chain) if kind in engine.integrators]
    return [engines.get(name, integrator=kind) for kind in methods] or [engine]


def _with_step(proposal: Proposal, scene: Scene, tolerance: float) -> Proposal:
    """Return the proposal of an engine that is used only by name, with its step."""
    if proposal.possible or proposal.equation is not None:
        return proposal
    # Trials are repeated with shorter steps. If nothing bounds the work of a drive, the total time
    # of the trials is unknown.
    unbounded = scene.excitation.does_work and scene.largest_strain == math.inf
    engine = engines.plain(proposal.engine)
    possible = not engines.obstacles(engine, scene)
    # A plan spends at most half a second on a trial.
    if possible and (unbounded or engine.trial_s(engine.part(scene), tolerance) > 0.5):
        cure = f"its step requires long trials, which plan --engine {proposal.engine} runs"
        return proposal._replace(why=f"{proposal.why}; {cure}")
    asked = ask(engine, scene, tolerance)
    why = proposal.why if asked.possible else f"{proposal.why}; {asked.why}"
    return asked._replace(kept=False, why=why)


def _label(proposal: Proposal) -> str:
    return f"{proposal.engine} {proposal.integrator}".rstrip()


def _verdict(proposal: Proposal) -> str:
    """Return the verdict on a proposal as text; one short line if it is dropped."""
    if proposal.why.startswith(REFUSED):
        return engines.brief(proposal.engine, proposal.why.removeprefix(REFUSED))
    if not proposal.kept:
        return f"dropped: {proposal.why.partition('; ')[0]}"
    diameter = proposal.choices.get("diameter")
    drawn = f"; {diameter} diameter: {proposal.choices['why']}" if diameter else ""
    return f"kept: {proposal.why}{drawn}"


def _cells(proposal: Proposal) -> Iterator[str]:
    yield _label(proposal)
    yield "" if proposal.equation is None else f"({proposal.equation})"
    yield number(proposal.model_error, ".1g")
    yield number(proposal.solver_error, ".1g")
    yield str(proposal.active_grains or "")
    yield number(proposal.step, unit="s")
    yield duration(proposal.cost_s, missing="")


REPEATS = 5  # Number of timed repetitions of each solution.


def calibrate() -> tuple[Path, float]:
    """Measure the speed of the engines on this machine, and store it.

    Returns
    -------
    path : Path
        File in which the speeds are stored.
    took : float
        Time of the measurement, s: a few tenths of a second after the kernels are compiled.

    Raises
    ------
    OSError
        If the result cannot be stored. It is then lost, and the earlier speeds stay in use.
    """
    # Number of grains, and duration in tens of time units.
    small = 2, 1
    large = 60, 40
    timed = [
        engine
        for engine in map(engines.get, engines.automatic())
        if not engine.refuses(_scene(*small))
    ]
    for engine in timed:
        _time(engine, *small)  # Compilation and imports happen in this first call.
    began = time.perf_counter()
    speeds = {}
    for engine in timed:
        (short, light), (long, heavy) = (_time(engine, *size) for size in (small, large))
        slowness = max((long - short) / (heavy - light), 2 / PLAUSIBLE)
        speeds[engine.name] = (
            max(short - slowness * light, 2 * engine.start_up_s / PLAUSIBLE),
            slowness,
        )
    took = time.perf_counter() - began
    # Engines that were not timed keep the results of an earlier measurement.
    speeds = dict(measured()) | speeds
    path = cache_file()
    measured.cache_clear()
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with replacing(path) as aside:
            aside.write_text(
                json.dumps({"host": platform.node(), "engines": speeds}, indent=2) + "\n",
                encoding="utf-8",
            )
    finally:
        measured.cache_clear()
    return path, took


def _scene(grains: int, periods: int) -> Scene:
    chain = Chain(grains=grains, diameter=1e-3, gravity=0.0, top_load=1e-3)
    return Scene(
        chain=chain,
        excitation=Impulse(velocity=1e-12),
        duration=periods * 10 * chain.time_scale,
        samples=11,
    )


def _time(engine: Engine, grains: int, periods: int) -> tuple[float, float]:
    """Return the shortest time of a solution, s, and its work on the reference machine, s."""
    scene = _scene(grains, periods)
    start, slowness = speed(engine.name, engine.start_up_s)
    work = (engine.propose(engine.part(scene), 1e-9).cost_s - start) / slowness
    times = []
    with warnings_aside():
        for _ in range(REPEATS):
            began = time.perf_counter()
            simulate(scene, engine, 1e-9)
            times.append(time.perf_counter() - began)
    return min(times), work
