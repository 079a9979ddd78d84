"""Names, shapes and labels of the quantities accumulated during a run."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

from ..scene.scene import Scene

TIME = "fine_time"


class Quantity(NamedTuple):
    """Dimensions, unit and title of a quantity."""

    dimensions: tuple[str, ...]
    units: str
    title: str


QUANTITIES = {
    "peak_displacement": Quantity(("grain",), "m", "largest size of the displacement at any time"),
    "peak_velocity": Quantity(("grain",), "m s-1", "largest size of the velocity at any time"),
    "arrival_time": Quantity(
        ("grain",), "s", "when the front passes, by the velocity (measure.front.track)"
    ),
    # The number of the contact follows this name.
    "peak_force": Quantity((), "N", "largest force at any time of contact"),
    "force": Quantity((TIME,), "N", "force of contact"),
}


# Energies that a run accumulates if the chain has damping or a forcing.
ENERGIES = {
    "dissipated": Quantity(("time",), "J", "energy taken by viscous contacts and drag since t = 0"),
    "drive": Quantity(("time",), "J", "work of a force or a drive since t = 0"),
}


class ArrayLayout(NamedTuple):
    """Dimensions and shape of an array, and its attributes in files."""

    dimensions: tuple[str, ...]
    shape: tuple[int, ...]
    labels: dict[str, Any]


def file_name(name: str) -> str:
    """Return the name of a quantity in files, in which names contain no colon.

    Examples
    --------
    >>> file_name("peak_force:40_error")
    'peak_force_40_error'
    """
    return name.replace(":", "_")


def arrays(scene: Scene) -> dict[str, ArrayLayout]:
    """Return the arrays that a scene accumulates, by name in `Trajectory.gathered`.

    A run may lack the arrays that `energies` lists, because some engines do not accumulate them.
    """
    layouts: dict[str, ArrayLayout] = {}
    sizes = {"grain": scene.count(scene.chain), TIME: scene.fine.samples}
    for name in scene.quantities:
        key, _, contact = name.partition(":")
        dimensions, units, title = QUANTITIES[key]
        title = f"{title} {contact}".strip()
        shape = tuple(sizes[dimension] for dimension in dimensions)
        labels = {"units": units, "long_name": title}
        layouts[name] = ArrayLayout(dimensions, shape, labels)
        layouts[f"{name}_error"] = ArrayLayout(
            dimensions, shape, labels | {"long_name": f"error of the {title}"}
        )
        if TIME in dimensions:
            labels = {"units": "s", "long_name": "time since the strike"}
            layouts[TIME] = ArrayLayout(dimensions, shape, labels)
    return layouts | energies(scene)


def energies(scene: Scene) -> dict[str, ArrayLayout]:
    """Return the arrays of the energies that a run may accumulate, by name."""
    layouts = {}
    present = {"dissipated": scene.chain.damped, "drive": scene.excitation.does_work}
    for name in ENERGIES:
        if not present[name]:
            continue
        dimensions, units, title = ENERGIES[name]
        labels = {"units": units, "long_name": title}
        layouts[name] = ArrayLayout(dimensions, (scene.samples,), labels)
        labels = labels | {"long_name": f"error of the {title}"}
        layouts[f"{name}_error"] = ArrayLayout((), (), labels)
    return layouts


def variables(
    scene: Scene, values: dict[str, Any]
) -> dict[str, tuple[tuple[str, ...], Any, dict[str, str]]]:
    """Return dimensions, values and metadata of accumulated arrays, by name in files."""
    layouts = arrays(scene)
    return {
        file_name(name): (layouts[name].dimensions, array, layouts[name].labels)
        for name, array in values.items()
    }


def numbers(scene: Scene, values: Mapping[str, Any]) -> dict[str, Any]:
    """Return the values, errors and unit of each quantity for a JSON file; NaN becomes None."""
    return {
        name: {
            "values": _plain(values[name]),
            "errors": _plain(values[f"{name}_error"]),
            "unit": _unit(name),
        }
        for name in scene.quantities
    }


def _plain(values: Any) -> Any:
    """Return numbers as lists of Python numbers, with None for NaN and infinity."""
    given = np.asarray(values, dtype=object)
    given[~np.isfinite(np.asarray(values, dtype=float))] = None
    return given.tolist()


def _unit(name: str) -> str:
    return QUANTITIES[name.partition(":")[0]].units.replace(" s-1", "/s")


def describe_gathered(scene: Scene, values: Mapping[str, Any]) -> dict[str, str]:
    """Return a line for each quantity: the range of its values, and their largest error."""
    lines = {}
    for name in scene.quantities:
        value = np.ravel(values[name])
        error = np.ravel(values[f"{name}_error"])
        # A grain without a front has no arrival time.
        finite = np.isfinite(value)
        if not finite.any():
            lines[name] = "nothing: no front has passed"
            continue
        low = f"{value[finite].min():.6g}"
        high = f"{value[finite].max():.6g}"
        span = low if low == high else f"{low} to {high}"
        grains = "" if finite.all() else f" in {finite.sum()} of {finite.size} grains"
        lines[name] = f"{span} {_unit(name)}{grains}, off by {error[finite].max():.2g} at most"
    return lines
