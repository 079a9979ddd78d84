"""Parameters of a chain and its excitation: their values, changes, and effect on the equations.

The motion depends on masses, contact constants K_n, forces at rest
``F_n = F_top + g (m_1 + ... + m_n)`` and on the excitation. Displacements are relative to
equilibrium, whose overlaps ``eps_n = (F_n / K_n)^(1/delta)`` depend on all these quantities. A mass
therefore acts through its inertia, and through its weight on every contact below it. Diameters and
moduli act through Hertz's constants ``K = (4/3) E* sqrt(R*) dbar^(1.5 - delta)`` and through the
masses, unless these are given.

Parameters of laws by formula are named after their keys, ``chain.law.c`` and ``chain.ground.k``.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np
from scipy import sparse

from ..chain.chain import Chain
from ..chain.contact_law import pair_slopes
from ..chain.law import Law
from ..chain.materials import Material
from ..errors import InputError, not_among, shown
from ..integrators.adjoint import Inputs
from ..scene.acting import Drive, Force
from ..scene.excitation import Profile
from ..scene.scene import Scene, check_scene
from ..util.arrays import Array, numbers

VISCOSITY = "damping.viscoelastic"
DRAG = "damping.drag"
UNITS = {
    "masses": "kg",
    "contact_constants": "N/m^delta",
    "wall_constants": "N/m^delta",
    "diameters": "m",
    "youngs_modulus": "Pa",
    "top_load": "N",
    "gravity": "m/s2",
    "displacement": "m",
    "velocity": "m/s",
    "drive": "m",
    "force": "N",
    "amplitude": "m or N",
    "frequency": "Hz",
    VISCOSITY: "s",
    DRAG: "1/s",
}
# Parameters that are themselves inputs of the motion.
DIRECT = ("masses", "top_load", "gravity", "displacement", "velocity", "drive", "force")
LAW = "chain.law."
GROUND = "chain.ground."


def by_differences(scene: Scene) -> bool:
    """Return whether the scene has derivatives by differences only: adjoints require powers."""
    return scene.chain.ground is not None or scene.chain.law.power is None


def formula_of(chain: Chain, name: str) -> tuple[Law, str]:
    """Return the formula that a name such as chain.law.c belongs to, and its parameter, c."""
    place, _, key = name.rpartition(".")
    law = chain.law if place == LAW.removesuffix(".") else chain.ground
    assert isinstance(law, Law)
    return law, key


def names_of_formulas(chain: Chain) -> list[str]:
    """Return the names of the parameters of all formulas of a chain.

    Examples
    --------
    >>> from lmpchain import Chain, laws
    >>> names_of_formulas(Chain(grains=3, diameter=1e-3, law=laws.toda(b=1e5, k=1e3)))
    ['chain.law.k', 'chain.law.b']
    """
    pairs = ((LAW, chain.law), (GROUND, chain.ground))
    return [place + key for place, law in pairs if isinstance(law, Law) for key in law.given]


def check(scene: Scene, names: Iterable[str]) -> tuple[str, ...]:
    """Return each name once; raise `InputError` if one is unknown or has no derivative."""
    check_scene(scene)
    names = as_names(names)
    known = [*UNITS, *names_of_formulas(scene.chain)]
    faults = [(name if name in known else "parameters", _refuse(scene, name)) for name in names]
    if not names:
        faults = [("parameters", f"name one or more of {', '.join(known)} (got {shown(names)})")]
    faults = [(key, message) for key, message in faults if message]
    if faults:
        raise InputError(faults)
    return tuple(dict.fromkeys(names))


def as_names(names: Iterable[str]) -> tuple[str, ...]:
    """Return one name or several as a tuple; raise `InputError` for other values."""
    if not isinstance(names, Iterable):
        message = f"must be one or more names of parameters (got {shown(names)})"
        raise InputError.at("parameters", message)
    return (names,) if isinstance(names, str) else tuple(names)


def _refuse(scene: Scene, name: str) -> str:
    """Return why a scene has no derivative with respect to a parameter; empty if it has one."""
    chain = scene.chain
    course = _course(scene)
    if scene.excitation.from_below:
        return "has no derivative in a scene whose base is driven: drive the top"
    match name:
        case "top_load" | "gravity" if not chain.compressed:
            return "has no derivative in a chain without compression: add a load or gravity"
        case "top_load" if chain.top == "wall" and chain.load_grain == 1 and chain.top_load == 0:
            return "has no derivative at 0, because the top wall only touches: give a top_load"
        case "contact_constants" if chain.grains == 1:
            return "there is no contact between grains: use wall_constants"
        case "contact_constants" if chain.law.given_constant is not None:
            return f"are given by the law: use {LAW}k"
        case "diameters" | "masses" | "youngs_modulus" if chain.impurity and by_differences(scene):
            return "has no derivative with impurities and formulas: give every grain its own value"
        case "displacement" | "velocity" if course is not None and by_differences(scene):
            return "has no derivative with formulas and a drive or force: use parameters of these"
        case "wall_constants" if not chain.wall_constants.any():
            return 'there is no wall: use top or bottom = "wall"'
        case "amplitude" | "frequency" if getattr(course, name, None) is None:
            return "needs a drive or force that is a sine or a burst"
        case "drive" | "force" if course is None or course.kind != name or course.times is None:
            return f"needs a {name} that is given by points"
        case "drive" | "force" if course and course.interpolation == "pchip":
            cure = 'use interpolation = "linear" or "spline"'
            return f"has no derivative everywhere with monotone interpolation: {cure}"
    known = [*UNITS, *names_of_formulas(chain)]
    return "" if name in known else not_among(name, known)


def unit(scene: Scene, name: str) -> str:
    """Return the unit of the parameters of this name; empty for those of formulas."""
    if name.startswith("chain."):
        return ""
    if name == "amplitude":
        return "N" if isinstance(scene.excitation, Force) else "m"
    return UNITS[name]


def values(scene: Scene, name: str) -> Array:
    """Return the values of the parameters with this name in the scene, (P,)."""
    chain = scene.chain
    if name.startswith("chain."):
        law, key = formula_of(chain, name)
        return np.array(law.given[key], ndmin=1)
    if name == "youngs_modulus":
        return chain.by_grain("youngs_modulus")
    if name in (VISCOSITY, DRAG):
        return np.atleast_1d(getattr(chain.damping, name.removeprefix("damping.")))
    if name in ("displacement", "velocity"):
        return scene.initial()[name == "velocity"]
    if name in ("drive", "force"):
        samples: Array = getattr(scene.excitation, scene.excitation.strength[1])
        return samples
    owner = scene.excitation if name in ("amplitude", "frequency") else chain
    return np.atleast_1d(getattr(owner, name))


def inputs(scene: Scene) -> Inputs:
    """Return all inputs of the motion for the scene."""
    chain = scene.chain
    course = _course(scene)
    return Inputs(
        chain.masses,
        chain.contacts.constant,
        chain.contacts.force,
        *scene.initial(),
        np.zeros(0) if course is None else course.numbers,
        chain.contact_viscosity,
        chain.drag,
    )


def pull(scene: Scene, gradient: Inputs, name: str) -> Array:
    """Return the gradient over parameters of this name, (P,), from that over all inputs."""
    if name in DIRECT:
        return _with_weight(scene.chain, gradient, name)
    return sum(
        matrix.T @ _with_weight(scene.chain, gradient, key)
        for key, matrix in _dependence(scene, name).items()
    )


def _with_weight(chain: Chain, gradient: Inputs, key: str) -> Array:
    """Return derivatives by inputs of this name, (P,), including those through forces at rest."""
    match key:
        case "masses":
            # Masses act through their inertia, and through their weight on all contacts below.
            return gradient.masses + chain.gravity * np.cumsum(gradient.forces[:0:-1])[::-1]
        case "top_load":
            return np.array([gradient.forces[_pressed_by_load(chain)].sum()])
        case "gravity":
            return np.array([gradient.forces[1:] @ np.cumsum(chain.masses)])
        case "force":
            return gradient.drive
    return getattr(gradient, key)  # type: ignore[no-any-return]


def push(scene: Scene, name: str, change: Array) -> Inputs:
    """Return the changes of all inputs, (D, ...), for changes (D, P) of the named parameters."""
    chain = scene.chain
    course = _course(scene)
    sizes = {
        "masses": chain.grains,
        "constants": chain.grains + 1,
        "top_load": 1,
        "gravity": 1,
        "displacement": chain.grains,
        "velocity": chain.grains,
        "drive": 0 if course is None else course.numbers.size,
        "viscosity": chain.grains + 1,
        "drag": chain.grains,
    }
    changes = {key: np.zeros((len(change), size)) for key, size in sizes.items()}
    for key, matrix in _dependence(scene, name).items():
        changes[key] = (matrix @ change.T).T
    # The weight of a heavier grain acts on all contacts below it.
    heavier = chain.gravity * np.cumsum(changes["masses"], axis=1)
    weight = heavier + changes.pop("gravity") * np.cumsum(chain.masses)
    forces = np.pad(weight, ((0, 0), (1, 0)))
    forces[:, _pressed_by_load(chain)] += changes.pop("top_load")
    return Inputs(forces=np.where(chain.contacts.pressed, forces, 0.0), **changes)


def _pressed_by_load(chain: Chain) -> slice:
    """Return the contacts that carry the load, beginning with the contact of a top wall if any."""
    return slice(chain.load_grain if chain.load_grain > 1 else 0, None)


def _course(scene: Scene) -> Drive | Force | None:
    """Return the excitation if it acts after t = 0, otherwise None."""
    return scene.excitation if isinstance(scene.excitation, (Drive, Force)) else None


def _dependence(scene: Scene, name: str) -> dict[str, sparse.csr_array]:
    """Return one matrix per input: its derivatives with respect to the named parameters."""
    chain = scene.chain
    if name == "contact_constants":
        return {"constants": _between(chain)}
    if name == "wall_constants":
        walls = sparse.lil_array((chain.grains + 1, 2))
        walls[0, 0] = chain.contacts.exists[0]
        walls[-1, 1] = chain.contacts.exists[-1]
        return {"constants": walls.tocsr()}
    if name == "youngs_modulus":
        return {"constants": _by_modulus(chain)}
    if name == "diameters":
        fixed = [impurity.grain for impurity in chain.impurity if impurity.mass]
        # A given mass does not depend on the diameter.
        follows = ~np.isin(np.arange(chain.grains) + 1, fixed)
        follows &= chain.given_masses is None
        return {
            "masses": _diagonal(follows * 3 * chain.masses / chain.diameters),
            "constants": _by_diameter(chain),
        }
    if name == VISCOSITY:
        return {"viscosity": _by_viscosity(chain)}
    if name == DRAG:
        every = np.ones(chain.grains)
        if np.ndim(chain.damping.drag) == 0:
            return {"drag": sparse.csr_array(every[:, None])}
        return {"drag": _diagonal(every)}
    if name in ("amplitude", "frequency"):
        return {"drive": sparse.csr_array(np.eye(2)[:, [int(name == "frequency")]])}
    if name == "force":
        return {"drive": _diagonal(np.ones(values(scene, name).size))}
    return {name: _diagonal(np.ones(values(scene, name).size))}


def _between(chain: Chain) -> sparse.csr_array:
    """Return the derivatives (N+1, N-1) of all contact constants by those between grains.

    The constant of a wall changes in proportion to that of the adjacent contact, unless it is
    given."""
    grains = chain.grains
    constant = chain.contacts.constant
    row = np.arange(1, grains)
    column = np.arange(grains - 1)
    entry = np.ones(grains - 1)
    if chain.given_wall_constants is None:
        row = np.append(row, [0, grains])
        column = np.append(column, [0, grains - 2])
        entry = np.append(entry, constant[[0, -1]] / constant[[1, -2]])
    return sparse.csr_array((entry, (row, column)), shape=(grains + 1, grains - 1))


def _by_body(chain: Chain, above: Array, below: Array) -> sparse.csr_array:
    """Return dK per property of the grains, (N+1, N), given d(log K) per upper and lower grain.

    Given constants do not depend on the property. If only the constants between grains are given,
    a wall constant depends on the property through the ratio of the wall's and the adjacent
    contact's constants that would follow from the grains.
    """
    last = chain.grains
    contact = np.arange(last + 1)
    follow = np.full(last + 1, float(chain.given_contact_constants is None))
    walls = [0, last]
    near = [1, last - 1]
    follow[walls] = float(chain.given_wall_constants is None)
    # A wall constant changes with the grain at the wall, minus its dependence through the next
    # contact.
    row = np.append(contact, walls)
    source = np.append(contact, near)
    rate = chain.contacts.constant[row] * np.append(follow, follow[walls] * (follow[near] - 1))
    upper = source > 0
    lower = source < last
    entries = np.concatenate(((rate * above[source])[upper], (rate * below[source])[lower]))
    rows = np.concatenate((row[upper], row[lower]))
    columns = np.concatenate((source[upper] - 1, source[lower]))
    return sparse.csr_array((entries, (rows, columns)), shape=(last + 1, last))


def _by_viscosity(chain: Chain) -> sparse.csr_array:
    """Return dA of contacts per common viscosity, (N+1, 1), or per given one, (N+1, N-1)."""
    last = chain.grains
    if np.ndim(chain.damping.viscoelastic) == 0:
        return sparse.csr_array(np.ones((last + 1, 1)))
    # A wall contact has the viscosity of the contact next to it.
    column = np.clip(np.arange(last + 1) - 1, 0, last - 2)
    return sparse.csr_array((np.ones(last + 1), (np.arange(last + 1), column)))


def _diagonal(entries: Array) -> sparse.csr_array:
    """Return a diagonal matrix."""
    return sparse.csr_array((entries, np.arange(entries.size), np.arange(entries.size + 1)))


def _by_modulus(chain: Chain) -> sparse.csr_array:
    """Return dK/dE, (N+1, N), for E* = 1 / (1/M_above + 1/M_below) and the M of a wall's grain."""
    young = chain.by_grain("youngs_modulus")
    walls = (chain.top_material, chain.bottom_material)
    of_grains = chain.by_grain("plane_strain_modulus")
    top, bottom = (
        wall.plane_strain_modulus if wall else of_grain  # type: ignore[union-attr]
        for wall, of_grain in zip(walls, of_grains[[0, -1]], strict=True)
    )
    above, below = pair_slopes(np.concatenate(([top], of_grains, [bottom])))
    above[1:] /= young
    below[:-1] /= young
    if chain.top_material is None:
        below[0] = 1 / young[0]
    if chain.bottom_material is None:
        above[-1] = 1 / young[-1]
    return _by_body(chain, above, below)


def _by_diameter(chain: Chain) -> sparse.csr_array:
    """Return the derivatives (N+1, N) of all contact constants by the diameters of grains.

    A diameter changes the effective radius of a contact and the mean diameter."""
    diameters = chain.diameters
    upper, lower = pair_slopes(np.concatenate(([np.inf], diameters / 2, [np.inf])))
    # Weight of a grain in the mean diameter at a contact.
    share = np.full(chain.grains + 1, 0.5)
    share[[0, -1]] = 1.0
    delta = chain.law.power_of("the derivative by a diameter")
    by_length = (1.5 - delta) * share / chain.contact_lengths
    above = np.zeros(chain.grains + 1)
    below = np.zeros(chain.grains + 1)
    above[1:] = upper[1:] / 2 / diameters + by_length[1:]
    below[:-1] = lower[:-1] / 2 / diameters + by_length[:-1]
    return _by_body(chain, above, below)


NUMBERS = ("top_load", "gravity", "amplitude", "frequency")


def changed(scene: Scene, new: Mapping[str, Array]) -> Scene:
    """Return the scene with these parameter values, by the parameter names of `gradient`.

    Raises
    ------
    InputError
        If the scene has no such parameter, or if it does not allow these values.

    Examples
    --------
    >>> from lmpchain import Chain, Impulse, Scene
    >>> chain = Chain(grains=3, diameter=1e-3)
    >>> scene = Scene(chain=chain, excitation=Impulse(velocity=1e-3), duration=1e-5)
    >>> changed(scene, {"diameters": [1e-3, 2e-3, 1e-3]}).chain.diameters.tolist()
    [0.001, 0.002, 0.001]
    """
    names = check(scene, new)
    chain: dict[str, Any] = {}
    excitation: dict[str, Any] = {}
    damping = scene.chain.damping
    for name in names:
        value = numbers(new[name], name)
        shape = values(scene, name).shape
        if value.shape != shape:
            raise InputError.at(name, f"must be of shape {shape}, not {value.shape}")
        number = float(value[0]) if name in NUMBERS else value
        match name:
            case "displacement" | "velocity":
                # A state that is not given remains as the excitation sets it.
                displacement, velocity = scene.initial()
                start = Profile(displacement=displacement, velocity=velocity)
                scene = scene.replace(excitation=start.replace(**{name: value}))
            case "drive" | "force":
                excitation[scene.excitation.strength[1]] = value
            case "amplitude" | "frequency":
                excitation[name] = number
            case _ if name in (VISCOSITY, DRAG):
                key = name.removeprefix("damping.")
                one = np.ndim(getattr(damping, key)) == 0
                damping = damping.replace(**{key: float(value[0]) if one else value})
                chain["damping"] = damping
            case _ if name.startswith("chain."):
                law, key = formula_of(scene.chain, name)
                field = "ground" if law.of_ground else "law"
                law = chain.get(field, law)
                one = np.ndim(law.given[key]) == 0
                entry = float(value[0]) if one else value
                chain[field] = Law(law.text, **(law.given | {key: entry}))
            case "youngs_modulus":
                chain["material"] = _materials(scene.chain, value)
            case "diameters":
                chain["diameter"] = value
            case _:
                chain[name] = number
    if scene.chain.impurity and {"diameter", "masses", "material"} & chain.keys():
        message = "give every grain its own diameter and material instead of impurities"
        raise InputError.at("impurity", message)
    if chain:
        scene = scene.replace(chain=scene.chain.replace(**chain))
    if excitation:
        scene = scene.replace(excitation=scene.excitation.replace(**excitation))
    return scene


def _materials(chain: Chain, moduli: Array) -> tuple[Material, ...]:
    """Return the materials of the grains with other Young's moduli (N,), Pa."""
    material = chain.material
    materials = material if isinstance(material, tuple) else (material,) * chain.grains
    pairs = list(zip(materials, moduli.tolist(), strict=True))
    # A checked copy is slow, and few grains differ as a rule.
    copies = {pair: pair[0].replace(youngs_modulus=pair[1]) for pair in dict.fromkeys(pairs)}
    return tuple(copies[pair] for pair in pairs)
