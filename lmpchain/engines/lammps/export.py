"""Complete decks for LAMMPS."""

from __future__ import annotations

from os import PathLike
from pathlib import Path

from ...errors import InputError, check_tolerance
from ...scene.scene import Scene, check_scene
from ...util.files import expanded
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
    template: str | PathLike[str] | None = None,
    include: str | PathLike[str] | None = None,
    overwrite: bool = False,
) -> Path:
    """Write `in.column` and `column.data` to a folder; `lmp -in in.column` there runs the scene.

    Parameters
    ----------
    scene : Scene
    folder : path
        Folder for the deck; it is created if it does not exist.
    tolerance, step, diameter, pair_style
        As for `Lammps` and `simulate`. If the rounding error of heights exceeds the tolerance, the
        deck is written for the smallest tolerance that can be met, and contains a remark.
    integrator : "verlet" or "kahan-li6"
        Method of time integration.
    template, include : path, optional
        As for `Lammps`, but the template is the complete deck and may contain any dump and run
        commands.
    overwrite : bool
        Whether to replace a deck that was edited, or files that lmpchain did not write.

    Returns
    -------
    Path
        Path of the deck.

    Raises
    ------
    InputError
        If LAMMPS cannot solve the scene, or if an option is wrong.
    """
    check_scene(scene)
    check_tolerance(tolerance)
    engine = Lammps(integrator, step, diameter, pair_style, template=template, include=include)
    deck.check_carried(engine.splitting(scene), "integrator")
    if reasons := engine.refuses(scene):
        raise InputError(reasons)
    return engine.write_deck(scene, tolerance, expanded(folder), overwrite)
