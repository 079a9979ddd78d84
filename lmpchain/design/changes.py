"""Scenes with other parameters than they were made with."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from ..errors import InputError
from ..scene.excitation import Profile
from ..scene.scene import Scene
from ..util.arrays import Array
from . import parameters as params

ONE = ("top_load", "gravity", "amplitude", "frequency")  # numbers, not arrays


def changed(scene: Scene, values: Mapping[str, Array]) -> Scene:
    """Return the scene with these parameters, by the names that `gradient` knows.

    Raises
    ------
    InputError
        If the scene has no such parameter, or does not allow these values.

    Examples
    --------
    >>> from lmpchain import Chain, Impulse, Scene
    >>> chain = Chain(grains=3, diameter=1e-3)
    >>> scene = Scene(chain=chain, excitation=Impulse(velocity=1e-3), duration=1e-5)
    >>> changed(scene, {"diameters": [1e-3, 2e-3, 1e-3]}).chain.diameters.tolist()
    [0.001, 0.002, 0.001]
    """
    chain: dict[str, Any] = {}
    acts: dict[str, Any] = {}
    names = params.check(scene, values)
    for name in names:
        given = np.array(values[name], dtype=float)
        wanted = params.values(scene, name).shape
        if given.shape != wanted:
            raise InputError([(name, f"must be of shape {wanted}, not {given.shape}")])
        value: Any = float(given[0]) if name in ONE else given
        if name in ("displacement", "velocity"):
            start = dict(zip(("displacement", "velocity"), scene.initial(), strict=True)) | {
                name: value
            }
            scene = scene.replace(excitation=Profile(**start))
        elif name in ("drive", "force"):
            acts[scene.excitation.strength[1]] = value
        elif name in ("amplitude", "frequency"):
            acts[name] = value
        elif name == "youngs_moduli":
            made = scene.chain.material
            each = made if isinstance(made, tuple) else (made,) * scene.chain.grains
            kinds = {
                pair: None for pair in zip(each, given.tolist(), strict=True)
            }  # few, as a rule
            kinds = {
                (material, modulus): material.replace(youngs_modulus=modulus)
                for material, modulus in kinds
            }
            chain["material"] = tuple(
                kinds[pair] for pair in zip(each, given.tolist(), strict=True)
            )
        else:
            chain["diameter" if name == "diameters" else name] = value
    if scene.chain.impurity and {"diameter", "masses", "material"} & chain.keys():
        raise InputError(
            [("impurity", "give every grain its own diameter and material in place of impurities")]
        )
    if chain:
        scene = scene.replace(chain=scene.chain.replace(**chain))
    return scene.replace(excitation=scene.excitation.replace(**acts)) if acts else scene
