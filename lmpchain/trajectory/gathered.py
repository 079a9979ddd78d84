"""Names, shapes and labels of what is gathered all along a run."""

from __future__ import annotations

from typing import Any, NamedTuple

from ..scene.scene import Scene

TIME = "fine_time"
# dimensions, unit and name
KINDS: dict[str, tuple[tuple[str, ...], str, str]] = {
    "peak_displacement": (("grain",), "m", "largest size of the displacement at any time"),
    "peak_velocity": (("grain",), "m s-1", "largest size of the velocity at any time"),
    "arrival_time": (("grain",), "s", "when the front passes, by the velocity (measure.front.track)"),
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
        made[f"{name}_error"] = Kind(dimensions, shape, {"units": units, "long_name": f"error of the {about}"})
        if TIME in dimensions:
            made[TIME] = Kind((TIME,), (scene.fine.samples,), {"units": "s", "long_name": "time since the strike"})
    return made


def variables(scene: Scene, values: dict[str, Any]) -> dict[str, tuple[tuple[str, ...], Any, dict[str, str]]]:
    """Return dimensions, values and metadata of what was gathered, by its name in files."""
    every = arrays(scene)
    return {stored(name): (every[name].dimensions, each, every[name].labels) for name, each in values.items()}
