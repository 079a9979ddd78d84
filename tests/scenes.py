"""Scenes that many tests share."""

import numpy as np

from lmpchain import GLASS, Chain, Displacement, Impulse, InputError, Profile, Scene

PAPER = {  # name: strike m/s, gravity m/s2
    "fig1": (8.57e-3, 9.81),
    "fig5 10g": (8.57e-4, 98.1),
    "fig5 g": (8.57e-4, 9.81),
    "fig5 g/10": (8.57e-4, 0.981),
    "weak": (1e-6, 9.81),
}


def paper(name: str, samples: int = 26) -> Scene:
    """Return a scene of the paper: 120 glass beads of 1 mm to 100 us."""
    velocity, gravity = PAPER[name]
    chain = Chain(grains=120, material=GLASS, diameter=1e-3, gravity=gravity)
    return Scene(chain=chain, excitation=Impulse(velocity=velocity), duration=100e-6, samples=samples)


def smooth(grains: int = 8, exponent: float = 1.5, samples: int = 2) -> Scene:
    """Return a short loaded chain struck so gently (v0* = 1e-3) that nothing comes near to opening."""
    chain = Chain(grains=grains, material=GLASS, diameter=1e-3, gravity=0.0, top_load=1e-3, exponent=exponent)
    speed = 1e-3 * chain.length_scale / chain.time_scale
    return Scene(chain=chain, excitation=Impulse(velocity=speed), duration=8 * chain.time_scale, samples=samples)


def random_scene(
    rng: np.random.Generator, exponents: tuple[float, ...] = (1.0, 1.25, 1.5, 1.5, 1.5, 2.0, 3.0)
) -> Scene:
    """Draw a chain and an excitation, weak to strong, that `Scene` accepts."""
    while True:
        try:
            return _draw(rng, float(rng.choice(exponents)))
        except InputError:
            continue


def _draw(rng: np.random.Generator, exponent: float) -> Scene:
    grains = int(rng.choice([2, 3, 5, 12, 30, 60]))
    kind = rng.choice(["gravity", "gravity", "load", "vacuum"])
    diameter = 1e-3 * 10 ** rng.uniform(-0.5, 1)
    chain = Chain(
        grains=grains,
        material=rng.choice(["glass", "steel", "ptfe"]).item(),
        diameter=diameter if rng.random() < 0.7 else diameter * rng.uniform(0.7, 1.3, grains),
        gravity=9.81 * 10 ** rng.uniform(-2, 2) if kind == "gravity" else 0.0,
        top_load=10 ** rng.uniform(-4, 1) if kind == "load" else 0.0,
        exponent=exponent,
        bottom="free" if kind == "vacuum" and rng.random() < 0.5 else "fixed",
    )
    grain = 1 if rng.random() < 0.6 else int(rng.integers(1, chain.movable + 1))
    if not chain.compressed:
        speed = 10 ** rng.uniform(-4, 0)
        scale = (chain.masses.mean() / chain.contact_constants.mean()) ** (1 / (exponent + 1))
        unit = scale * speed ** ((1 - exponent) / (1 + exponent))
        return Scene(
            chain=chain, excitation=Impulse(velocity=speed, grain=grain), duration=unit * rng.uniform(2, 20), samples=11
        )
    contact = min(grain, grains - 1) - 1
    overlap = chain.equilibrium_overlap[contact]
    omega = np.sqrt(chain.linear_stiffness[contact] / chain.masses[contact])
    number = 10 ** rng.uniform(-4, 4)
    draw = rng.random()
    if draw < 0.6:
        excitation = Impulse(velocity=number * overlap * omega, grain=grain)
    elif draw < 0.8:
        excitation = Displacement(displacement=rng.choice([-1.0, 1.0]) * min(number, 50) * overlap, grain=grain)
    else:
        velocity = rng.normal(size=grains) * min(number, 10) * overlap * omega
        velocity[chain.movable :] = 0
        excitation = Profile(velocity=velocity)
    return Scene(chain=chain, excitation=excitation, duration=rng.uniform(2, 20) / omega, samples=11)
