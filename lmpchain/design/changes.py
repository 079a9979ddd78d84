"""Scenes with other values of the parameters that gradients are computed for."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from ..chain.chain import Chain
from ..chain.law import Law
from ..chain.materials import Material
from ..errors import InputError
from ..scene.excitation import Profile
from ..scene.scene import Scene
from ..util.arrays import Array, numbers
from . import parameters as params

NUMBERS = ("top_load", "gravity", "amplitude", "frequency")


def changed(scene: Scene, values: Mapping[str, Array]) -> Scene:
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
    names = params.check(scene, values)
    chain: dict[str, Any] = {}
    excitation: dict[str, Any] = {}
    damping = scene.chain.damping
    for name in names:
        value = numbers(values[name], name)
        shape = params.values(scene, name).shape
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
            case params.VISCOSITY | params.DRAG:
                key = name.removeprefix("damping.")
                one = np.ndim(getattr(damping, key)) == 0
                damping = damping.replace(**{key: float(value[0]) if one else value})
                chain["damping"] = damping
            case _ if name.startswith("chain."):
                law, key = params.formula_of(scene.chain, name)
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
