"""Names, shapes and labels of what is gathered all along a run."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

from ..scene.scene import Scene

TIME = "fine_time"
# dimensions, unit and name
KINDS: dict[str, tuple[tuple[str, ...], str, str]] = {
    "peak_displacement": (("grain",), "m", "largest size of the displacement at any time"),
    "peak_velocity": (("grain",), "m s-1", "largest size of the velocity at any time"),
    "arrival_time": (
        ("grain",),
        "s",
        "when the front passes, by the velocity (measure.front.track)",
    ),
    "peak_force": ((), "N", "largest force at any time of contact"),
    "force": ((TIME,), "N", "force of contact"),
}


class Kind(NamedTuple):
    """Dimensions and shape of an array, and its attributes in files."""

    dimensions: tuple[str, ...]
    shape: tuple[int, ...]
    labels: dict[str, Any]


def stored(name: str) -> str:
    """Return what a quantity is called in files, whose names hold no colon.

    Examples
    --------
    >>> stored("peak_force:40_error")
    'peak_force_40_error'
    """
    return name.replace(":", "_")


def arrays(scene: Scene) -> dict[str, Kind]:
    """Return what is gathered of a scene, by its name in `Trajectory.gathered`."""
    made: dict[str, Kind] = {}
    for name in scene.quantities:
        kind, _, contact = name.partition(":")
        dimensions, units, about = KINDS[kind]
        about = f"{about} {contact}".strip()
        sizes = {"grain": scene.count(scene.chain), TIME: scene.fine.samples}
        shape = tuple(sizes[dimension] for dimension in dimensions)
        made[name] = Kind(dimensions, shape, {"units": units, "long_name": about})
        made[f"{name}_error"] = Kind(
            dimensions, shape, {"units": units, "long_name": f"error of the {about}"}
        )
        if TIME in dimensions:
            made[TIME] = Kind(
                (TIME,), (scene.fine.samples,), {"units": "s", "long_name": "time since the strike"}
            )
    return made


def variables(
    scene: Scene, values: dict[str, Any]
) -> dict[str, tuple[tuple[str, ...], Any, dict[str, str]]]:
    """Return dimensions, values and metadata of what was gathered, by its name in files."""
    every = arrays(scene)
    return {
        stored(name): (every[name].dimensions, each, every[name].labels)
        for name, each in values.items()
    }


def in_words(scene: Scene, values: Mapping[str, Any]) -> dict[str, str]:
    """Return a line for each quantity: between what its values lie, and how far off they are at most."""
    lines = {}
    for name in scene.quantities:
        value, error = (np.ravel(values[key]) for key in (name, f"{name}_error"))
        there = np.isfinite(value)
        if not there.any():
            lines[name] = "nothing: no front has passed"
            continue
        low, high = (f"{extreme(value[there]):.6g}" for extreme in (np.min, np.max))
        units = KINDS[name.partition(":")[0]][1].replace(" s-1", "/s")
        some = "" if there.all() else f" in {there.sum()} of {there.size} grains"
        span = low if low == high else f"{low} to {high}"
        lines[name] = f"{span} {units}{some}, off by {error[there].max():.2g} at most"
    return lines
