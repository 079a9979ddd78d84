"""Scenes that many tests use."""

from typing import Any

import numpy as np

from lmpchain import (
    GLASS,
    Chain,
    Displacement,
    Drive,
    Impulse,
    Impurity,
    InputError,
    Profile,
    Scene,
    Trajectory,
    simulate,
)

PAPER = {  # Name: strike velocity, m/s, and gravity, m/s2.
    "fig1": (8.57e-3, 9.81),
    "fig5 10g": (8.57e-4, 98.1),
    "fig5 g": (8.57e-4, 9.81),
    "fig5 g/10": (8.57e-4, 0.981),
    "weak": (1e-6, 9.81),
}


def paper(name: str, samples: int = 26) -> Scene:
    """Return a scene of the paper: 120 glass beads of 1 mm diameter, for 100 us."""
    velocity, gravity = PAPER[name]
    chain = Chain(grains=120, material=GLASS, diameter=1e-3, gravity=gravity)
    return Scene(
        chain=chain, excitation=Impulse(velocity=velocity), duration=100e-6, samples=samples
    )


def scene_of(
    chain: Chain, excitation: Any, duration: float, samples: int | None = None, **more: Any
) -> Scene:
    """Return the scene of a chain and an excitation; options are those of `Scene`."""
    if samples is not None:
        more["samples"] = samples
    return Scene(chain=chain, excitation=excitation, duration=duration, **more)


def struck(
    chain: Chain, velocity: float, duration: float, samples: int | None = None, **more: Any
) -> Scene:
    """Return the scene of a strike on the top grain; options are those of `Scene`."""
    return scene_of(chain, Impulse(velocity=velocity), duration, samples, **more)


def struck_in_units(
    chain: Chain, number: float, units: float, samples: int | None = None, **more: Any
) -> Scene:
    """Return the scene of a strike with this strike number for a number of units of time."""
    velocity = number * chain.length_scale / chain.time_scale
    return struck(chain, velocity, units * chain.time_scale, samples, **more)


def run(
    chain: Chain,
    excitation: Any,
    duration: float,
    samples: int = 2,
    tolerance: float = 1e-9,
    engine: Any = "native",
    **more: Any,
) -> Trajectory:
    """Return the motion of a scene; options are those of `Scene`."""
    return simulate(scene_of(chain, excitation, duration, samples, **more), engine, tolerance)


def smooth(grains: int = 8, exponent: float = 1.5, samples: int = 2) -> Scene:
    """Return a short loaded chain struck so gently (v0* = 1e-3) that no contact nearly opens."""
    chain = Chain(
        grains=grains, material=GLASS, diameter=1e-3, gravity=0.0, top_load=1e-3, exponent=exponent
    )
    speed = 1e-3 * chain.length_scale / chain.time_scale
    return Scene(
        chain=chain,
        excitation=Impulse(velocity=speed),
        duration=8 * chain.time_scale,
        samples=samples,
    )


def stirred(
    chain: Chain,
    velocity: float,
    displacement: float = 0.0,
    seed: int = 1,
    last: int | None = None,
) -> Profile:
    """Return normally distributed motions of the movable grains up to `last`."""
    rng = np.random.default_rng(seed)
    v, u = (size * rng.normal(size=chain.grains) for size in (velocity, displacement))
    end = min(last or chain.grains, chain.movable)
    u[end:] = v[end:] = 0
    return Profile(displacement=u, velocity=v)


def random_scene(
    rng: np.random.Generator, exponents: tuple[float, ...] = (1.0, 1.25, 1.5, 1.5, 1.5, 2.0, 3.0)
) -> Scene:
    """Draw a valid chain and excitation, weak to strong."""
    while True:
        try:
            chain = _chain(rng, float(rng.choice(exponents)))
            return (
                _driven(rng, chain)
                if chain.top == "free" and rng.random() < 0.3
                else _struck(rng, chain)
            )
        except InputError:
            continue


def _chain(rng: np.random.Generator, exponent: float) -> Chain:
    grains = int(rng.choice([2, 3, 5, 12, 30, 60]))
    kind = rng.choice(["gravity", "gravity", "load", "vacuum"])
    top = "wall" if rng.random() < 0.3 else "free"
    bottom = rng.choice(
        ["fixed", "wall", "free"] if kind == "vacuum" else ["fixed", "fixed", "wall"]
    ).item()
    walls = [
        f"{end}_material" for end, what in (("top", top), ("bottom", bottom)) if what == "wall"
    ]
    pressed = kind == "load" or (kind == "gravity" and rng.random() < 0.3)
    diameter = 1e-3 * 10 ** rng.uniform(-0.5, 1)
    return Chain(
        grains=grains,
        material=_material(rng),
        diameter=diameter if rng.random() < 0.7 else diameter * rng.uniform(0.7, 1.3, grains),
        gravity=9.81 * 10 ** rng.uniform(-2, 2) if kind == "gravity" else 0.0,
        top_load=10 ** rng.uniform(-4, 1) if pressed else 0.0,
        exponent=exponent,
        top=top,
        bottom=bottom,
        impurity=_impurities(rng, grains, diameter) if rng.random() < 0.3 else [],
        **{key: _material(rng) for key in walls if rng.random() < 0.5},
    )


def _material(rng: np.random.Generator) -> str:
    return rng.choice(["glass", "steel", "ptfe"]).item()


def _impurities(rng: np.random.Generator, grains: int, diameter: float) -> list[Impurity]:
    """Draw up to three grains that differ in size, in material, or only in mass."""
    found = []
    for grain in rng.permutation(grains)[: rng.integers(1, 4)] + 1:
        what = rng.choice(["diameter", "material", "mass"])
        mass = 2426 * np.pi / 6 * diameter**3 * 10 ** rng.uniform(-0.5, 0.5)
        draws = {
            "diameter": diameter * rng.uniform(0.5, 2),
            "material": _material(rng),
            "mass": mass,
        }
        found.append(Impurity(grain=grain, **{what: draws[what]}))
    return found


def _units(rng: np.random.Generator, chain: Chain, grain: int) -> tuple[float, float]:
    """Return the scales of length and frequency of a grain: of its contact, or of a strike."""
    if chain.compressed:
        contact = min(grain, chain.grains - 1) - 1
        overlap = chain.equilibrium_overlap[contact]
        return float(overlap), float(
            np.sqrt(chain.linear_stiffness[contact] / chain.masses[contact])
        )
    speed = 10 ** rng.uniform(-4, 0)
    scale = (chain.masses.mean() / chain.contact_constants.mean()) ** (1 / (chain.exponent + 1))
    unit = scale * speed ** ((1 - chain.exponent) / (1 + chain.exponent))
    return float(speed * unit), float(1 / unit)


def _struck(rng: np.random.Generator, chain: Chain) -> Scene:
    grain = 1 if rng.random() < 0.6 else int(rng.integers(1, chain.movable + 1))
    length, omega = _units(rng, chain, grain)
    duration = rng.uniform(2, 20) / omega
    if not chain.compressed:
        return Scene(
            chain=chain,
            excitation=Impulse(velocity=length * omega, grain=grain),
            duration=duration,
            samples=11,
        )
    number = 10 ** rng.uniform(-4, 4)
    draw = rng.random()
    if draw < 0.6:
        excitation = Impulse(velocity=number * length * omega, grain=grain)
    elif draw < 0.8:
        excitation = Displacement(
            displacement=rng.choice([-1.0, 1.0]) * min(number, 50) * length, grain=grain
        )
    else:
        velocity = rng.normal(size=chain.grains) * min(number, 10) * length * omega
        velocity[chain.movable :] = 0
        excitation = Profile(velocity=velocity)
    return Scene(chain=chain, excitation=excitation, duration=duration, samples=11)


def _driven(rng: np.random.Generator, chain: Chain) -> Scene:
    """Draw a sine of any frequency, or a path through random points."""
    length, omega = _units(rng, chain, 1)
    length *= 10 ** rng.uniform(-4, 1) if chain.compressed else 1.0
    duration = rng.uniform(2, 20) / omega
    if rng.random() < 0.5:
        excitation = Drive(
            amplitude=length, frequency=omega / (2 * np.pi) * 10 ** rng.uniform(-1, 0.3)
        )
    else:
        apart = rng.uniform(0.3, 1, rng.integers(5, 30))
        times = np.append(0, np.cumsum(apart)) * (duration * rng.uniform(1, 1.2) / apart.sum())
        excitation = Drive(
            times=times, displacement=np.append(0, rng.normal(size=apart.size)) * length
        )
    return Scene(chain=chain, excitation=excitation, duration=duration, samples=11)
