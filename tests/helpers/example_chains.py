"""Chains that many tests use."""

from typing import Any

import numpy as np

from lmpchain import GLASS, PTFE, STEEL, Chain, Impurity, Material


def column(grains: int = 20, **chain: Any) -> Chain:
    """Return a column of glass beads of 1 mm under gravity; keywords change the chain."""
    return Chain(**{"grains": grains, "diameter": 1e-3} | chain)


def random_column(
    grains: int, seed: int = 1, spread: float = 0.2, diameter: float = 1e-3, **chain: Any
) -> Chain:
    """Return a column of beads whose diameters differ at random by up to this relative spread."""
    sizes = np.random.default_rng(seed).uniform(1 - spread, 1 + spread, grains)
    return column(grains, diameter=diameter * sizes, **chain)


RNG = np.random.default_rng(7)
DISORDERED = Chain(
    grains=30,
    material=[GLASS, STEEL, PTFE] * 10,
    diameter=RNG.uniform(0.5e-3, 2e-3, 30),
    gravity=3.7,
    top_load=1e-4,
)
CHAINS = {
    "the paper's": Chain(grains=120, diameter=1e-3),
    "disordered": DISORDERED,
    "loaded and free of gravity": Chain(
        grains=25, material=STEEL, diameter=5e-3, gravity=0.0, top_load=1.0
    ),
    "softer exponent": Chain(grains=40, diameter=1e-3, exponent=1.2),
    "harder exponent": Chain(grains=40, diameter=1e-3, exponent=2.7),
    "springs": Chain(grains=40, diameter=1e-3, exponent=1.0),
    "two grains": Chain(grains=2, diameter=1e-3),
    "own masses and constants": Chain(
        grains=4, diameter=1e-3, masses=[1e-6, 3e-6, 2e-6, 1e-6], contact_constants=[1e9, 3e9, 2e9]
    ),
}
BETWEEN = {"top": "wall", "bottom": "wall"}
RIGID = Material(density=1.0, youngs_modulus=1e30, poissons_ratio=0.0)
WALLED = {
    "on the ground": Chain(grains=40, diameter=1e-3, bottom="wall"),
    "squeezed": Chain(
        grains=25, material=STEEL, diameter=5e-3, gravity=0.0, top_load=1.0, **BETWEEN
    ),
    "just touched above": Chain(grains=30, diameter=1e-3, **BETWEEN, top_material=PTFE),
    "held below": Chain(grains=12, diameter=1e-3, top="wall", top_load=1e-4),
    "disordered": Chain(
        grains=30,
        material=[GLASS, STEEL, PTFE] * 10,
        diameter=RNG.uniform(0.5e-3, 2e-3, 30),
        gravity=3.7,
        top_load=1e-3,
        **BETWEEN,
        top_material="brass",
        bottom_material="tungsten_carbide",
    ),
    "softer exponent": Chain(grains=20, diameter=1e-3, exponent=1.2, top_load=1e-5, **BETWEEN),
    "springs": Chain(
        grains=20, diameter=1e-3, exponent=1.0, top_load=1e-4, **BETWEEN, bottom_material=STEEL
    ),
    "own masses and constants": Chain(
        grains=4,
        diameter=1e-3,
        masses=[1e-6, 3e-6, 2e-6, 1e-6],
        contact_constants=[1e9, 3e9, 2e9],
        **BETWEEN,
    ),
    "impurities": Chain(
        grains=9,
        diameter=1e-3,
        bottom="wall",
        impurity=[
            Impurity(grain=9, diameter=3e-3),
            Impurity(grain=4, material=STEEL),
            Impurity(grain=1, mass=1e-5),
        ],
    ),
    "two grains": Chain(grains=2, diameter=1e-3, top_load=1e-4, **BETWEEN),
}


def vacuum(grains: int, **ends: Any) -> Chain:
    """Return a chain of touching grains with m = K = 1 and diameter 100.

    The bottom is free unless `ends` say otherwise.
    """
    units = {"masses": np.ones(grains), "contact_constants": np.ones(grains - 1)}
    return Chain(grains=grains, diameter=100.0, gravity=0.0, **({"bottom": "free"} | units | ends))
