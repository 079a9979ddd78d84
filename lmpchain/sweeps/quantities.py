"""What a sweep can keep of each scene: its motion, or numbers read off it with their errors."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..measure.motion import RESOLVED, Motion
from ..measure.recorded import columns
from ..scene.recording import contact_of
from ..scene.scene import Scene
from ..simulation.gatherer import FRACTION, PEAK
from ..trajectory import gathered
from ..trajectory.between.derivatives import UNKNOWN
from ..util.arrays import Array


class Quantity(NamedTuple):
    """Something read off a motion: its dimensions, unit and name, and how it and its error are found."""

    dimensions: tuple[str, ...]
    units: str
    long_name: str
    measure: Callable[[Motion, NDArray[np.intp]], tuple[Array, ...]]
    whole: bool = False  # whether it is the recorded motion itself, with the error of the trajectory and no other


def _arrival_time(motion: Motion, _: NDArray[np.intp]) -> tuple[Array, Array]:
    rows = motion.fronts("velocity", FRACTION, width=False)
    return rows[:, 0], rows[:, 3]


def _peak_displacement(motion: Motion, _: NDArray[np.intp]) -> tuple[Array, Array]:
    return motion.peaks("displacement")[1:]


def _peak_velocity(motion: Motion, _: NDArray[np.intp]) -> tuple[Array, Array]:
    return motion.peaks("velocity")[1:]


def _wall_force(motion: Motion, _: NDArray[np.intp]) -> tuple[Array, Array]:
    force, error = motion.largest_wall_force()
    return np.array(force), np.array(error)


def _energy(motion: Motion, grains: NDArray[np.intp]) -> tuple[Array, Array]:
    from ..measure.energy import shares

    energy, chain = shares(motion), motion.scene.chain
    known = columns(chain.grains, chain.movable, grains) != UNKNOWN
    grain, contact = (
        np.isin(energy.grain, grains),
        known[energy.contact] & known[energy.contact + 1],
    )
    moving = energy.kinetic[:, grain].sum(1), energy.kinetic_error[:, grain].sum(1)
    held = energy.elastic[:, contact].sum(1), energy.elastic_error[:, contact].sum(1)
    return moving[0] + held[0], moving[1] + held[1]


def _grain_energy(motion: Motion, _: NDArray[np.intp]) -> tuple[Array, Array]:
    from ..measure.energy import shares

    energy = shares(motion)
    return energy.of_grain, energy.of_grain_error


def _contact_energy(motion: Motion, _: NDArray[np.intp]) -> tuple[Array, Array]:
    from ..measure.energy import shares

    energy = shares(motion)
    below = np.full((2, *energy.kinetic.shape), np.nan)
    _, there, places = np.intersect1d(energy.grain, energy.contact, return_indices=True)
    below[:, :, there] = np.stack([energy.elastic, energy.elastic_error])[:, :, places]
    return below[0], below[1]


QUANTITIES = {
    "displacement": Quantity(
        ("time", "grain"),
        "m",
        "displacement from equilibrium, positive downward",
        lambda m, _: (m.displacement,),
        True,
    ),
    "velocity": Quantity(
        ("time", "grain"), "m s-1", "velocity, downward", lambda m, _: (m.velocity,), True
    ),
    "peak_displacement": Quantity(
        ("grain",), "m", "largest size of the displacement at any time", _peak_displacement
    ),
    "peak_velocity": Quantity(
        ("grain",), "m s-1", "largest size of the velocity at any time", _peak_velocity
    ),
    "arrival_time": Quantity(
        ("grain",),
        "s",
        "when the front passes, by the velocity (measure.front.track)",
        _arrival_time,
    ),
    "energy": Quantity(
        ("time",),
        "J",
        "energy above rest of the recorded grains and the contacts between them",
        _energy,
    ),
    "grain_energy": Quantity(
        ("time", "grain"),
        "J",
        "energy above rest of a grain and its share of contacts (measure.energy.shares)",
        _grain_energy,
    ),
    "contact_energy": Quantity(
        ("time", "grain"),
        "J",
        "energy above rest of the contact below a grain; NaN if unknown",
        _contact_energy,
    ),
    "wall_force": Quantity(
        (),
        "N",
        "largest force on what holds the bottom, at any time (measure.contact.wall_force)",
        _wall_force,
    ),
}


ALONG_THE_RUN = ("peak_displacement", "peak_velocity", "arrival_time", "wall_force")


def of_contact(name: str) -> bool:
    """Say whether a quantity is the largest force of a contact, as "peak_force:40"."""
    return name.partition(":")[0] == PEAK and contact_of(name) is not None


def quantity(name: str) -> Quantity:
    """Return one of the quantities, or the largest force of a contact."""
    if name in QUANTITIES:
        return QUANTITIES[name]
    _, units, about = gathered.KINDS[PEAK]
    return Quantity((), units, f"{about} {name.partition(':')[2]}", lambda m, _: ())


def with_gathered(scene: Scene, keep: Iterable[str], moves_grains: bool) -> Scene:
    """Return the scene with those quantities gathered along the run that its samples do not show.

    Parameters
    ----------
    scene : Scene
    keep : names of quantities
    moves_grains : bool
        Whether the engine solves an equation of motion of the grains, Eq. (1) or (3), so that it
        can gather.

    Raises
    ------
    InputError
        If there is no such contact.
    """
    # between samples closer than this the equation of motion leaves no room for a larger value
    swift = scene.highest_frequency * scene.duration / (scene.samples - 1) > RESOLVED
    gathered_names = {
        _gathered_name(scene, name)
        for name in keep
        if of_contact(name) or (swift and moves_grains and name in ALONG_THE_RUN)
    }
    missing = sorted(gathered_names - {*scene.quantities, ""})
    return scene.replace(quantities=(*scene.quantities, *missing)) if missing else scene


def _gathered_name(scene: Scene, name: str) -> str:
    """Return the name under which a run gathers a quantity; empty for a wall that is not there."""
    if name != "wall_force":
        return name
    # below the last grain that moves
    return "" if scene.chain.bottom == "free" else f"{PEAK}:{scene.chain.movable}"


def measured(
    motion: Motion,
    keep: Iterable[str],
    grains: NDArray[np.intp],
    gathered_arrays: Mapping[str, Array],
) -> dict[str, Array]:
    """Return what is kept of a motion, by name, at these of its grains.

    Errors are under the name with _error. `gathered_arrays` are those of the run, by name.
    """
    rows = slice(None) if grains.tobytes() == motion.grains.tobytes() else motion.rows(grains)
    arrays: dict[str, Array] = {}
    for name in keep:
        of_grains = "grain" in quantity(name).dimensions
        values = _read(motion, name, grains, gathered_arrays)
        for key, array in zip((name, f"{name}_error"), values, strict=False):
            arrays[gathered.file_name(key)] = array[..., rows] if of_grains else array
    return arrays


def _read(
    motion: Motion, name: str, grains: NDArray[np.intp], gathered_arrays: Mapping[str, Array]
) -> tuple[Array, ...]:
    """Return a quantity and its error: as gathered along the run, else from the samples."""
    along = _gathered_name(motion.scene, name)
    if along not in gathered_arrays:
        return quantity(name).measure(motion, grains)
    value = gathered_arrays[along]
    if name == "wall_force":
        # a grain that is held presses with its own weight, too
        chain = motion.scene.chain
        value = value + chain.gravity * chain.masses[chain.movable :].sum()
    return value, gathered_arrays[f"{along}_error"]
