"""Scenes that many tests use."""

from typing import Any

import numpy as np

from lmpchain import (
    GLASS,
    Chain,
    Displacement,
    Drive,
    Force,
    Impulse,
    Impurity,
    InputError,
    Packet,
    Profile,
    Scene,
)  # fmt: skip

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


def struck(velocity: float = 1e-6, grains: int = 40, duration: float = 5e-5, **chain: Any) -> Scene:
    """Return a column of 1 mm beads with a strike on its top; options change the chain."""
    return Scene(
        chain=Chain(**{"grains": grains, "diameter": 1e-3} | chain),
        excitation=Impulse(velocity=velocity),
        duration=duration,
        samples=11,
    )


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


def acted_scene(
    rng: np.random.Generator, exponents: tuple[float, ...] = (1.0, 1.25, 1.5, 1.5, 1.5, 2.0, 3.0)
) -> Scene:
    """Draw forces, bursts, moving walls and packets on chains of one or more grains."""
    while True:
        try:
            chain = _ended(rng, _chain(rng, float(rng.choice(exponents))))
            return _acted(rng, chain)
        except InputError:
            continue


def _ended(rng: np.random.Generator, chain: Chain) -> Chain:
    """Draw the constants of walls, and sometimes reduce the chain to a single grain."""
    keys = chain.given()
    if rng.random() < 0.1 and "wall" in (chain.top, chain.bottom):
        lone = {key: value for key, value in keys.items() if key != "impurity"}
        keys = lone | {"grains": 1, "diameter": float(chain.diameters[0])}
        keys |= {"bottom": "wall" if chain.bottom == "fixed" else chain.bottom}
        chain = Chain(**keys)
    if rng.random() < 0.3:
        keys.pop("top_material", None)
        keys.pop("bottom_material", None)
        keys["wall_constants"] = chain.wall_constants * 10 ** rng.uniform(-1, 1, 2)
    return Chain(**keys)


def _acted(rng: np.random.Generator, chain: Chain) -> Scene:
    grain = 1 if rng.random() < 0.5 else int(rng.integers(1, chain.movable + 1))
    length, omega = (
        _units(rng, chain, grain)
        if chain.grains > 1
        else (chain.length_scale, 1 / chain.time_scale)
    )
    if not np.isfinite(omega) or not length:
        length = 1e-8
        omega = 1e4
    size = 10 ** rng.uniform(-4, 1) if chain.compressed else 1.0
    duration = rng.uniform(2, 20) / omega
    frequency = omega / (2 * np.pi) * 10 ** rng.uniform(-1, 0.3)
    strength = float(size * chain.masses[grain - 1] * omega**2 * length) * rng.choice([-1.0, 1.0])
    cycles = float(rng.choice([1.0, 2.0, 5.0, rng.uniform(0.3, 6)]))
    apart = np.append(0, np.cumsum(rng.uniform(0.3, 1, rng.integers(5, 30))))
    times = apart * (duration * rng.uniform(1, 1.2) / apart[-1])
    wall = 0 if chain.top == "wall" and rng.random() < 0.8 else 1
    waves = {"amplitude": strength, "frequency": frequency}
    excitation = {
        "sine": lambda: Force(grain=grain, **waves),
        "burst": lambda: Force(grain=grain, **waves, cycles=cycles),
        "half-sine": lambda: Force(
            grain=grain, shape="half-sine", amplitude=strength, duration=0.5 / frequency
        ),
        "points": lambda: Force(
            grain=grain, times=times, force=rng.normal(size=times.size) * strength
        ),
        "moved": lambda: Drive(amplitude=size * length, frequency=frequency, grain=wall),
        "moved in a burst": lambda: Drive(
            amplitude=size * length, frequency=frequency, grain=wall, cycles=cycles
        ),
        "moved by points": lambda: Drive(
            times=times,
            displacement=np.append(0, rng.normal(size=times.size - 1)) * size * length,
            grain=wall,
        ),
        "packet": lambda: Packet(
            frequency=frequency / 2,
            width=chain.grains / 13,
            grain=chain.grains // 2,
            amplitude=min(size, 1) * length,
        ),
    }
    made = excitation[rng.choice(list(excitation))]()
    return Scene(chain=chain, excitation=made, duration=duration, samples=11)


def wide_scene(rng: np.random.Generator) -> Scene:
    """Draw a scene from the whole range of inputs, with 2 to 10^5 grains."""
    while True:
        try:
            return _at_speed(rng, _wide_chain(rng), 10 ** rng.uniform(-9, 0))
        except InputError:
            continue


def _wide_chain(rng: np.random.Generator) -> Chain:
    grains = int(10 ** rng.uniform(np.log10(2), 5.001))
    gravity = 9.81 * 10 ** rng.uniform(-2, 2) if rng.random() < 0.7 else 0.0
    walls = {end: "wall" for end in ("top", "bottom") if rng.random() < 0.2}
    materials = {f"{end}_material": _material(rng) for end in walls if rng.random() < 0.5}
    diameter = 1e-3 * 10 ** rng.uniform(-0.5, 1)
    return Chain(
        grains=grains,
        material=_material(rng),
        diameter=diameter if rng.random() < 0.7 else diameter * rng.uniform(0.7, 1.3, grains),
        gravity=gravity,
        exponent=float(rng.choice([1.0, 1.5, 1.5, 1.5, 3.0, *rng.uniform(1, 3, 3)])),
        top_load=10 ** rng.uniform(-4, 1) if gravity == 0 or rng.random() < 0.2 else 0.0,
        impurity=_impurities(rng, grains, diameter) if rng.random() < 0.3 else [],
        **walls,
        **materials,
    )


def _at_speed(rng: np.random.Generator, chain: Chain, speed: float) -> Scene:
    """Draw an excitation that moves grains at about this speed, with a suitable duration."""
    grain = 1 if rng.random() < 0.6 else int(rng.integers(1, chain.movable + 1))
    mass = chain.masses[grain - 1]
    contact = min(grain, chain.grains - 1) - 1
    constant = chain.contact_constants[contact]
    stiffness = chain.linear_stiffness[contact]
    hit = speed / (mass * speed**2 / constant) ** (1 / (chain.exponent + 1))
    omega = max(float(np.sqrt(stiffness / mass)), float(hit))
    duration = rng.uniform(2, 20) / omega
    sign = rng.choice([-1.0, 1.0])
    kind = rng.choice(["impulse", "impulse", "displacement", "profile", "sine", "spline"])
    if kind == "impulse":
        excitation = Impulse(velocity=sign * speed, grain=grain)
    elif kind == "displacement":
        excitation = Displacement(displacement=sign * speed / omega, grain=grain)
    elif kind == "profile":
        velocity = np.zeros(chain.grains)
        struck = slice(grain - 1, min(grain + 20, chain.movable))
        velocity[struck] = speed * rng.normal(size=velocity[struck].size)
        excitation = Profile(velocity=velocity)
    elif kind == "sine":
        frequency = omega * 10 ** rng.uniform(-1, 0.3)
        excitation = Drive(amplitude=speed / frequency, frequency=frequency / (2 * np.pi))
    else:
        times = np.append(0, np.cumsum(rng.uniform(0.3, 1, rng.integers(5, 30))))
        times *= duration * rng.uniform(1, 1.2) / times[-1]
        path = np.append(0, rng.normal(size=times.size - 1)) * speed * times[-1] / times.size
        excitation = Drive(times=times, displacement=path)
    return Scene(
        chain=chain, excitation=excitation, duration=duration, samples=int(rng.choice([5, 11, 51]))
    )
