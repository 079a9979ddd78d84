"""Decks that run by themselves in LAMMPS."""

from __future__ import annotations

from os import PathLike
from pathlib import Path

from ...errors import InputError, ToleranceNotMet, check_tolerance
from ...files import make_folder, write_aside
from ...scene import Scene
from ..base import Candidate
from . import deck
from .engine import Lammps


def write_deck(
    scene: Scene,
    folder: str | PathLike[str],
    *,
    tolerance: float = 1e-6,
    step: float | None = None,
    diameter: str = "physical",
    integrator: str = "verlet",
    pair_style: str = "granular",
) -> Path:
    """Write `in.column` and `column.data` to a folder; `lmp -in in.column` there runs the scene.

    Parameters
    ----------
    scene : Scene
    folder : path
        Made if it is not there.
    tolerance, step, diameter, pair_style
        As for `Lammps` and `simulate`. Where round-off in heights keeps the physical diameter from
        the tolerance, the deck is written for the error that can be had, and says so.
    integrator : "verlet" or "kahan-li6"

    Returns
    -------
    Path
        The deck.

    Raises
    ------
    InputError
        If LAMMPS cannot do the scene, or an option is wrong.
    """
    check_tolerance(tolerance)
    engine = Lammps(integrator, step, diameter, pair_style)
    if not deck.carries(engine.splitting):
        raise InputError([("integrator", f"a deck cannot carry the kicks of {integrator}; use verlet or kahan-li6")])
    if reasons := engine.refuses(scene):
        raise InputError(reasons)
    candidate, remark = _reachable(engine, scene, tolerance)
    folder = make_folder(folder)
    column = engine.column(scene, candidate, remark)
    deck.write_data(column, folder / "column.data")
    text = deck.run_deck(column, candidate.step, engine.splitting, candidate.steps_per_sample, scene.samples - 1)
    with write_aside(folder / "in.column") as aside:
        aside.write_text(text, encoding="ascii")
    return folder / "in.column"


def _reachable(engine: Lammps, scene: Scene, tolerance: float) -> tuple[Candidate, str]:
    """Return the candidate for the tolerance, or for the best that can be had, and a remark about it."""
    wanted, remark = tolerance, ""
    while True:
        try:
            return engine.candidate(scene, tolerance), remark
        except ToleranceNotMet as missed:
            if tolerance > 0.1:
                raise
            remark = remark or f"the tolerance of {wanted:.1g} is out of reach: {missed.reason}"
            tolerance *= 4
