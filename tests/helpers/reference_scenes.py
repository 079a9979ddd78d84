"""Scenes of every kind with their motion in extended precision."""

from functools import cache

import numpy as np

from lmpchain import Chain, Displacement, Drive, Impulse, Scene

from .example_scenes import PAPER, paper, random_scene
from .independent_integrators import Reference, extended_reference


def between(excitation, **keys) -> Scene:
    """Return a scene of twelve glass beads between two walls; keywords change the chain."""
    chain = Chain(**{"grains": 12, "diameter": 1e-3, "top": "wall", "bottom": "wall"} | keys)
    duration = min(30 * chain.time_scale, 1e-4)
    return Scene(chain=chain, excitation=excitation, duration=duration, samples=6)


def path(size: float) -> Drive:
    return Drive(
        times=np.arange(9) * 1.3e-5, displacement=np.array([0, 1, -1, 2, 0, -2, 1, 1, 0]) * size
    )


def beads(velocity: float, duration: float = 100e-6, samples: int = 11) -> Scene:
    """Return a scene of a strike on 120 glass beads."""
    strike = Impulse(velocity=velocity)
    return Scene(chain=paper("weak").chain, excitation=strike, duration=duration, samples=samples)


CLOSED = {
    "paper": paper("weak", samples=6),
    "pressed by the wall": between(Impulse(velocity=1e-6, grain=5), top_load=1e-4),
    "springs": between(Displacement(displacement=1e-13, grain=2), top_load=1e-4, exponent=1.0),
    "exponent": between(
        Impulse(velocity=-1e-7), top_load=1e-4, exponent=2.3, gravity=0.0, bottom_material="ptfe"
    ),
    "impurities": between(
        Impulse(velocity=1e-6), top="free", impurity=[{"grain": 12, "mass": 1e-5}]
    ),
    "sine": between(Drive(amplitude=1e-10, frequency=3e4), top="free"),
    "path": between(path(1e-10), top="free", bottom="fixed"),
    "path and exponent": between(
        path(1e-11), top="free", bottom="fixed", exponent=1.7, material="steel"
    ),
}
OPENING = {  # A contact without overlap counts as open.
    "paper": paper("fig1", samples=6),
    "just touched by the wall": between(Impulse(velocity=-1e-4)),
    "vacuum": between(Impulse(velocity=1e-2, grain=4), gravity=0.0, top_material="steel"),
    "sine": between(Drive(amplitude=1e-8, frequency=3e4), top="free"),
    "sine in the vacuum": between(
        Drive(amplitude=1e-7, frequency=2e4), top="free", bottom="free", gravity=0.0
    ),
    "path": between(path(3e-9), top="free"),
}
KINDS = CLOSED | {f"{name}, opening": scene for name, scene in OPENING.items()}
LONG_AND_WEAK = "weak, to 400 us"


def at_speed(velocity: float) -> str:
    return f"strike at {velocity:g} m/s"


SCENES = (
    KINDS
    | {name: paper(name) for name in PAPER}
    | {at_speed(velocity): beads(velocity) for velocity in (1e-3, 1e-6, 1e-9, 1e-12)}
    | {LONG_AND_WEAK: beads(1e-6, 400e-6, 41)}
    | {f"random {seed}": random_scene(np.random.default_rng(seed)) for seed in range(20)}
    | {
        f"random for LAMMPS {seed}": random_scene(np.random.default_rng(seed), (1.0, 1.5, 1.5))
        for seed in range(100, 120)
    }
)


@cache
def reference_motion(name: str) -> Reference:
    """Return the displacement, velocity and their error for one of `SCENES`, computed once."""
    return extended_reference(SCENES[name])
