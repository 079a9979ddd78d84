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
        Made if it is not there.
    tolerance, step, diameter, pair_style
        As for `Lammps` and `simulate`. Where round-off in heights keeps the physical diameter from
        the tolerance, the deck is written for the error that can be had, and says so.
    integrator : "verlet" or "kahan-li6"
    template, include : path, optional
        As for `Lammps`, but the template may run and dump as it likes: it is all of the deck.
    overwrite : bool
        Whether to replace a deck that was edited, or files that lmpchain did not write.

    Returns
    -------
    Path
        The deck.

    Raises
    ------
    InputError
        If LAMMPS cannot do the scene, or an option is wrong.
    """
    check_scene(scene)
    check_tolerance(tolerance)
    engine = Lammps(integrator, step, diameter, pair_style, template=template, include=include)
    deck.check_carried(engine.splitting(scene), "integrator")
    if reasons := engine.refuses(scene):
        raise InputError(reasons)
    return engine.write_deck(scene, tolerance, expanded(folder), overwrite)
