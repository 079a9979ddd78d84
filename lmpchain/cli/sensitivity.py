"""The command `sensitivity`: derivatives of a result of a saved run by grain parameters."""

from __future__ import annotations

import argparse
from typing import Any

from ..errors import InputError
from .common import STANDARD, check_outputs, collect, keep, read_scene

# Uncertain parameters: option after --sigma-, name of the parameter, description.
UNCERTAIN = {
    "diameter": ("diameters", "diameter"),
    "youngs-modulus": ("youngs_modulus", "Young's modulus"),
    "mass": ("masses", "mass"),
    "constant": ("contact_constants", "constant of a contact"),
    "viscoelastic": ("damping.viscoelastic", "viscous time of a contact"),
    "drag": ("damping.drag", "rate of drag"),
}


def sensitivity(arguments: argparse.Namespace) -> int:
    """Rank the parameters of a saved run by their influence on a result."""
    from ..design import sensitivities

    scene, picture, numbers, _ = collect(
        lambda: _scene(arguments.run),
        *check_outputs(arguments, arguments.run),
        lambda: sensitivities.objective(arguments.answer),
    )
    uncertainties = {
        field: getattr(arguments, f"sigma_{key.replace('-', '_')}")
        for key, (field, _) in UNCERTAIN.items()
    }
    shares = {field: share for field, share in uncertainties.items() if share is not None}
    result = sensitivities.sensitivity(
        scene, arguments.answer, shares, arguments.derivative_tolerance
    )
    print(result.table())
    keep(result, numbers, picture)
    return 0


def _scene(path: str) -> Any:
    """Return the scene of a saved run, or of a scene file."""
    if path == STANDARD or path.endswith(".toml"):
        return read_scene(path)
    from ..trajectory.dump_frames import is_dump
    from ..trajectory.trajectory import Trajectory

    if is_dump(path):
        raise InputError.at(path, "is a LAMMPS dump: give its scene, SCENE.toml, in its place")
    return Trajectory.load(path).scene
