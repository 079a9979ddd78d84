"""Quantities that a sweep stores for each scene: its motion, or derived numbers with errors."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..measure.motion import RESOLVED, RESOLVED_BY_DIFFERENCES, Motion
from ..measure.recorded import columns
from ..scene.recording import contact_of
from ..scene.scene import Scene
from ..simulation.accumulation import PEAK
from ..trajectory import gathered
from ..trajectory.accumulator import FRACTION, UNKNOWN
from ..util.arrays import Array


class SweepQuantity(NamedTuple):
    """A quantity that a sweep can store.

    Attributes
    ----------
    dimensions : tuple of str
        Dimensions among "time" and "grain".
    units, long_name : str
        Unit and description of the quantity in the results.
    measure : function
        Function that returns the quantity and its error, given a motion and the grains to store.
    recorded : bool
        Whether the quantity is the recorded motion itself, whose only error is the error of the
        trajectory.
    """

    dimensions: tuple[str, ...]
    units: str
    long_name: str
    measure: Callable[[Motion, NDArray[np.intp]], Iterable[Array]]
    recorded: bool = False


def _arrival_time(motion: Motion, _: NDArray[np.intp]) -> tuple[Array, Array]:
    rows = motion.fronts("velocity", FRACTION, width=False)
    return rows[:, 0], rows[:, 3]


def _wall_force(motion: Motion, _: NDArray[np.intp]) -> tuple[Array, Array]:
    force, error = motion.largest_wall_force()
    return np.array(force), np.array(error)


def _energy(motion: Motion, grains: NDArray[np.intp]) -> tuple[Array, Array]:
    from ..measure.energy import shares

    energy = shares(motion)
    chain = motion.scene.chain
    bodies = columns(chain.grains, chain.movable, grains) != UNKNOWN
    grain = np.isin(energy.grain, grains)
    # A contact counts if both of its bodies are recorded or fixed.
    contact = bodies[energy.contact] & bodies[energy.contact + 1]
    value = energy.kinetic[:, grain].sum(1) + energy.elastic[:, contact].sum(1)
    error = energy.kinetic_error[:, grain].sum(1) + energy.elastic_error[:, contact].sum(1)
    return value, error


def _grain_energy(motion: Motion, _: NDArray[np.intp]) -> tuple[Array, Array]:
    from ..measure.energy import shares

    energy = shares(motion)
    return energy.of_grain, energy.of_grain_error


def _contact_energy(motion: Motion, _: NDArray[np.intp]) -> Array:
    from ..measure.energy import shares

    energy = shares(motion)
    # Each row is the contact below a grain; the last contact, or one with a wall, may be unknown.
    below = np.full((2, *energy.kinetic.shape), np.nan)
    _, rows, places = np.intersect1d(energy.grain, energy.contact, return_indices=True)
    below[:, :, rows] = np.stack([energy.elastic, energy.elastic_error])[:, :, places]
    return below


QUANTITIES = {
    "displacement": SweepQuantity(
        ("time", "grain"),
        "m",
        "displacement from equilibrium, positive downward",
        lambda motion, _: (motion.displacement,),
        True,
    ),
    "velocity": SweepQuantity(
        ("time", "grain"), "m s-1", "velocity, downward", lambda motion, _: (motion.velocity,), True
    ),
    # Quantities that a run can accumulate have the names and units of `gathered`.
    "peak_displacement": SweepQuantity(
        *gathered.QUANTITIES["peak_displacement"],
        lambda motion, _: motion.peaks("displacement")[1:],
    ),
    "peak_velocity": SweepQuantity(
        *gathered.QUANTITIES["peak_velocity"], lambda motion, _: motion.peaks("velocity")[1:]
    ),
    "arrival_time": SweepQuantity(*gathered.QUANTITIES["arrival_time"], _arrival_time),
    "energy": SweepQuantity(
        ("time",),
        "J",
        "energy above rest of the recorded grains and the contacts between them",
        _energy,
    ),
    "grain_energy": SweepQuantity(
        ("time", "grain"),
        "J",
        "energy above rest of a grain and its share of contacts (measure.energy.shares)",
        _grain_energy,
    ),
    "contact_energy": SweepQuantity(
        ("time", "grain"),
        "J",
        "energy above rest of the contact below a grain; NaN if unknown",
        _contact_energy,
    ),
    "wall_force": SweepQuantity(
        (),
        "N",
        "largest force on the bottom support, at any time (measure.contact.wall_force)",
        _wall_force,
    ),
}


UNSURE = 0.1  # Largest relative error of a stored quantity, relative to its largest value.
# Quantities over all times, which a run can accumulate.
ALONG_THE_RUN = ("peak_displacement", "peak_velocity", "arrival_time", "wall_force")


def is_extreme(name: str) -> bool:
    """Return whether a quantity is a maximum over all times, or an arrival time."""
    return name in ALONG_THE_RUN or of_contact(name)


def of_contact(name: str) -> bool:
    """Return whether a quantity is the largest force of one contact, such as "peak_force:40"."""
    return name.partition(":")[0] == PEAK and contact_of(name) is not None


def quantity(name: str) -> SweepQuantity:
    """Return the quantity with a name, or the largest force of one contact."""
    if name in QUANTITIES:
        return QUANTITIES[name]
    dimensions, units, title = gathered.QUANTITIES[PEAK]
    # The run accumulates this force, so nothing remains to be measured.
    return SweepQuantity(dimensions, units, f"{title} {contact_of(name)}", lambda motion, _: ())


def with_gathered(scene: Scene, keep: Iterable[str], moves_grains: bool) -> Scene:
    """Return the scene with all quantities accumulated that its samples do not resolve.

    Parameters
    ----------
    scene : Scene
    keep : names of quantities
        Quantities to store.
    moves_grains : bool
        Whether the engine solves an equation of motion of the grains, Eq. (1) or (3), so that it
        can accumulate quantities.

    Raises
    ------
    InputError
        If a contact does not exist.
    """
    # For closely spaced samples the equation of motion bounds the values in between; with damping
    # the accelerations follow from samples, which must be closer.
    resolved = RESOLVED if scene.chain.conservative else RESOLVED_BY_DIFFERENCES
    swift = scene.sampling_phase > resolved
    early = not scene.chain.strongest_when_closest
    gathered_names = {
        _name_in_run(scene, name)
        for name in keep
        if of_contact(name)
        or (moves_grains and is_extreme(name) and (swift or (early and name == "wall_force")))
    }
    missing = sorted(gathered_names - {*scene.quantities, ""})
    return scene.replace(quantities=(*scene.quantities, *missing)) if missing else scene


def _name_in_run(scene: Scene, name: str) -> str:
    """Return the name under which a run accumulates a quantity; empty without such a wall."""
    if name != "wall_force":
        return name
    # The last moving grain touches this wall.
    return "" if scene.chain.bottom == "free" else f"{PEAK}:{scene.chain.movable}"


def measure_quantities(
    motion: Motion,
    keep: Iterable[str],
    grains: NDArray[np.intp],
    gathered_arrays: Mapping[str, Array],
) -> dict[str, Array]:
    """Return the quantities of a motion to store, at these of its grains.

    The error of a quantity has the name of the quantity followed by _error. `gathered_arrays` are
    the arrays that the run accumulated, by name.
    """
    rows = motion.rows(grains)
    arrays: dict[str, Array] = {}
    for name in keep:
        of_grains = "grain" in quantity(name).dimensions
        values = _read(motion, name, grains, gathered_arrays)
        # The motion itself has no separate error.
        for key, array in zip((name, f"{name}_error"), values, strict=False):
            arrays[gathered.file_name(key)] = array[..., rows] if of_grains else array
    return arrays


def _read(
    motion: Motion, name: str, grains: NDArray[np.intp], gathered_arrays: Mapping[str, Array]
) -> Iterable[Array]:
    """Return a quantity and its error, accumulated by the run or computed from its samples."""
    along = _name_in_run(motion.scene, name)
    if along not in gathered_arrays:
        return quantity(name).measure(motion, grains)
    value = gathered_arrays[along]
    if name == "wall_force":
        # A fixed grain adds its own weight to the force.
        value = value + motion.scene.chain.held_weight
    return value, gathered_arrays[f"{along}_error"]


def is_gathered(scene: Scene, name: str) -> bool:
    """Return whether the run of a scene accumulates a quantity."""
    return _name_in_run(scene, name) in scene.quantities


def add_rest(arrays: dict[str, Array], whole: Mapping[str, Array]) -> None:
    """Add to each error the difference between the predictable part and the whole run.

    The maxima of the predictable part do not include larger values at later times.
    """
    for name, values in whole.items():
        error = f"{name}_error"
        if error in arrays:
            arrays[error] = arrays[error] + np.abs(arrays[name] - values)


def leave_out_unsure(arrays: dict[str, Array], names: Iterable[str]) -> list[str]:
    """Set quantities with a relative error above 0.1 to NaN, and return their names.

    The error is relative to the largest value of all grains, because many grains hardly move.
    """
    unsure = []
    for name in names:
        value, error = (gathered.file_name(key) for key in (name, f"{name}_error"))
        largest = np.abs(arrays[value]).max(initial=0.0, where=~np.isnan(arrays[value]))
        doubtful = arrays[error] > UNSURE * largest
        # A value without an error is unknown, for example an arrival that the whole run lacks.
        doubtful |= np.isnan(arrays[error]) & ~np.isnan(arrays[value])
        if doubtful.any():
            unsure.append(name)
            for key in (value, error):
                arrays[key] = np.where(doubtful, np.nan, arrays[key])
    return unsure
