"""Scenes drawn from the whole range of inputs, each from a seed; only their cost is limited.

2 to 10^5 grains, exponents 1 to 3, every end and excitation, strike numbers 1e-12 to 1e4, mass
ratios to 10^6, impurities, tapered, periodic and disordered chains, 0.5 to 4000 periods, 2 to 1001
samples, some of them on the nodes of the motion.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from lmpchain import (
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
)

MATERIALS = ("glass", "steel", "ptfe", "brass", "tungsten_carbide")


def trial_scene(
    rng: np.random.Generator, exponents: tuple[float, ...] = (), work: float = 2e5
) -> Scene:
    """Draw a scene with one of these exponents (default: any) and this work in grain-radians."""
    while True:
        try:
            chain = _chain(rng, exponents)
            scene = _struck(rng, chain, work)
            _ = scene.strike_number, scene.largest_strain
            return scene
        except InputError:  # The scene is invalid, for example beyond Hertz's law.
            continue


def loose_trial_scene(rng: np.random.Generator, work: float = 1e4) -> Scene:
    """Draw a scene with opening contacts: striker, vacuum, unequal springs or strong strike."""
    while True:
        try:
            chain = _loose_chain(rng)
            scene = _struck(rng, chain, work, weakest=0.1)
            if rng.random() < 0.3:
                scene = scene.replace(excitation=_acting(rng, chain, scene.duration, weakest=0.1))
            scene = scene.replace(samples=2 if rng.random() < 0.4 else int(_log(rng, 2, 101.5)))
            angle = scene.highest_frequency * scene.duration
            if scene.largest_strain > 0.3 and angle < 2 * max(np.sqrt(work), work / chain.grains):
                return scene
        except InputError:
            continue


def damped(
    rng: np.random.Generator,
    scene: Scene,
    alike: bool = False,
    least: float = 1e-4,
    most: float = 2.0,
) -> Scene:
    """Return the scene with viscous contacts, a drag or both, from weak damping to overdamping.

    A omega and gamma / omega are `least` to `most`. LAMMPS knows a drag that is alike for all
    grains.
    """
    omega = scene.highest_frequency
    grains = scene.chain.grains
    while True:
        viscosity = _log(rng, least, most) / omega * (rng.random() < 0.8)
        drag = _log(rng, least, most) * omega * (rng.random() < 0.5)
        if viscosity + drag > 0:
            break
    damping: dict[str, Any] = {"viscoelastic": viscosity, "drag": drag}
    if rng.random() < 0.3 and grains > 1:
        damping["viscoelastic"] = viscosity * rng.random(grains - 1)
    if rng.random() < 0.3 and not alike:
        damping["drag"] = drag * (rng.random(grains) < 0.5)
    return scene.replace(chain=scene.chain.replace(damping=damping))


def short_damped_scene(rng: np.random.Generator) -> Scene:
    """Draw a damped scene of at most 12 grains with few radians between samples.

    It takes a few steps a sample, so that thousands of trials are cheap.
    """
    drawer = acted_trial_scene if rng.random() < 0.5 else trial_scene
    while True:
        scene = drawer(rng, work=10 ** rng.uniform(2, 3.5))
        if scene.chain.grains <= 12:
            break
    scene = damped(rng, scene, least=0.05, most=10.0)
    intervals = scene.highest_frequency * scene.duration / _log(rng, 1, 6)
    return scene.replace(samples=1 + int(np.clip(intervals, 1, 60)))


def _log(rng: np.random.Generator, low: float, high: float) -> float:
    return float(np.exp(rng.uniform(np.log(low), np.log(high))))


def _chain(rng: np.random.Generator, exponents: tuple[float, ...]) -> Chain:
    near_springs = 1 + _log(rng, 1e-6, 0.1)
    any_exponent = (1.0, 1.5, 1.5, 1.5, 2.0, 3.0, near_springs, *rng.uniform(1, 3, 2))
    grains = int(_log(rng, 2, 100 if rng.random() < 0.7 else 1.0001e5))
    pressed = rng.choice(["gravity", "gravity", "load", "both", "vacuum"])
    ends: dict[str, Any] = {"top": "wall" if rng.random() < 0.3 else "free"}
    ends["bottom"] = rng.choice(
        ["fixed", "wall", "free"] if pressed == "vacuum" else ["fixed", "wall"]
    ).item()
    for end in ("top", "bottom"):
        if ends[end] == "wall" and rng.random() < 0.5:
            ends[f"{end}_material"] = rng.choice(MATERIALS).item()
    fields: dict[str, Any] = {
        "grains": grains,
        "exponent": float(rng.choice(exponents or any_exponent)),
        "gravity": _log(rng, 1e-3, 1e3) if pressed in ("gravity", "both") else 0.0,
        "top_load": _log(rng, 1e-5, 30) if pressed in ("load", "both") else 0.0,
        **ends,
        **_grains(rng, grains),
    }
    return Chain(**fields)


def _loose_chain(rng: np.random.Generator) -> Chain:
    """Draw a chain of touching contacts, springs, or a compressed chain."""
    exponents = (
        1.0,
        1.25,
        1.5,
        1.5,
        2.0,
        2.5,
        3.0,
        1 + _log(rng, 1e-3, 0.1),
        *rng.uniform(1, 3, 4),
    )
    kind = rng.choice(["striker"] * 4 + ["loose"] + ["free"] * 3 + ["springs"] * 2 + ["pressed"])
    grains = int(_log(rng, 3, 30 if rng.random() < 0.85 else 1000))
    fields: dict[str, Any] = {"grains": grains, "exponent": float(rng.choice(exponents))}
    fields["top"] = "wall" if rng.random() < 0.3 else "free"
    fields["bottom"] = rng.choice(["fixed", "wall", *["free"] * 4 * (kind == "free")]).item()
    fields |= _grains(rng, grains)
    fields["gravity"] = 0.0
    if kind != "free":
        fields["top_load"] = _log(rng, 1e-4, 30)
    if kind in ("striker", "loose"):
        fields["load_grain"] = 2 if kind == "striker" else int(rng.integers(2, grains))
    if kind in ("springs", "pressed") and rng.random() < 0.5:
        fields |= {"top_load": 0.0, "gravity": _log(rng, 1e-1, 1e2)}
    if kind == "springs":
        fields |= {"exponent": 1.0, "masses": 1e-6 * _log(rng, 1, 1e4) ** rng.random(grains)}
    return Chain(**fields)


def _grains(rng: np.random.Generator, grains: int) -> dict[str, Any]:
    """Draw the grains: equal, with impurities, tapered, periodic, disordered or listed."""
    diameter = _log(rng, 2e-4, 5e-2)
    material = rng.choice(MATERIALS).item()
    n = np.arange(grains)
    kind = rng.choice(
        ["alike", "alike", "impurities", "tapered", "periodic", "disordered", "masses", "constants"]
    )
    if kind == "impurities":
        odd = []
        for grain in rng.permutation(grains)[: rng.integers(1, 4)] + 1:
            heavier = 2426 * np.pi / 6 * diameter**3 * _log(rng, 1e-3, 1e3)
            what = rng.choice(["diameter", "material", "mass"]).item()
            draws = {
                "diameter": diameter * _log(rng, 0.3, 3),
                "material": rng.choice(MATERIALS).item(),
                "mass": heavier,
            }
            odd.append(Impurity(grain=int(grain), **{what: draws[what]}))
        return {"diameter": diameter, "material": material, "impurity": odd}
    if kind == "tapered":
        return {"diameter": diameter * _log(rng, 0.2, 5) ** (n / grains), "material": material}
    if kind == "periodic":
        cell = rng.integers(2, 5)
        materials = [rng.choice(MATERIALS).item() for _ in range(cell)]
        return {"diameter": diameter, "material": [materials[i % cell] for i in n]}
    if kind == "disordered":
        return {"diameter": diameter * rng.uniform(0.7, 1.3, grains), "material": material}
    alike: dict[str, Any] = {"diameter": diameter, "material": material}
    if kind == "masses":
        ratio = _log(rng, 1, 1e6)
        mass = 2426 * np.pi / 6 * diameter**3
        return alike | {
            "masses": mass
            * (np.where(n % 2, ratio, 1) if rng.random() < 0.5 else ratio ** rng.random(grains))
        }
    if kind == "constants":
        return alike | {
            "contact_constants": 1e9 * _log(rng, 0.1, 10) * rng.gamma(3, 1 / 3, grains - 1)
        }
    return alike


def _struck(rng: np.random.Generator, chain: Chain, work: float, weakest: float = 1e-12) -> Scene:
    grain = 1 if rng.random() < 0.6 else int(rng.integers(1, chain.movable + 1))
    number = _log(rng, weakest, 1e4)
    # A contact that only touches has no length scale.
    contact = min(max(grain, 1 + chain.loose_grains), chain.grains - 1) - 1
    mass = chain.masses[grain - 1]
    constant = chain.contact_constants[contact]
    if chain.compressed:
        length = chain.equilibrium_overlap[contact]
        speed = number * length * np.sqrt(chain.linear_stiffness[contact] / mass)
        rest = float(np.sqrt(chain.linear_stiffness[contact] / mass))
    else:
        speed = _log(rng, 1e-9, 3)
        rest = 0.0
        length = number = 0.0
    # Collision frequency, rad/s.
    hit = speed / (mass * speed**2 / constant) ** (1 / (chain.exponent + 1))
    omega = max(rest, hit)
    excitation = _excitation(rng, chain, grain, speed, omega, periods := _log(rng, 0.5, 4000))
    once = Scene(
        chain=chain, excitation=excitation, duration=2 * np.pi * periods / omega, samples=2
    )
    # Samples at nodes are at half periods of the excitation or of the chain.
    if rng.random() < 0.1:
        half = np.pi / (excitation.fastest or chain.band_edge or omega)
        samples = int(_log(rng, 2, 20))
        duration = half * (samples - 1) * int(_log(rng, 1, 20))
    else:
        samples = int(_log(rng, 2, 1001.5))
        duration = once.duration
    angle = once.highest_frequency * duration
    most = max(np.sqrt(work), work / chain.grains)  # Largest phase, limited by the work.
    if angle > most:
        duration *= most / angle * rng.uniform(0.5, 1)
    # The knots depend on the duration.
    if isinstance(excitation, Drive) and excitation.times is not None:
        stretch = duration * rng.uniform(1, 1.2) / excitation.times[-1]
        excitation = Drive(
            times=excitation.times * stretch, displacement=excitation.displacement * stretch
        )
    samples = max(2, min(samples, int(2e6 / chain.grains)))
    return Scene(chain=chain, excitation=excitation, duration=float(duration), samples=samples)


def _excitation(
    rng: np.random.Generator, chain: Chain, grain: int, speed: float, omega: float, periods: float
) -> Impulse | Displacement | Profile | Drive:
    sign = float(rng.choice([-1.0, 1.0]))
    kinds = [
        "impulse",
        "impulse",
        "displacement",
        "profile",
        *["sine", "spline"] * (chain.top == "free"),
    ]
    match rng.choice(kinds):
        case "impulse":
            return Impulse(velocity=sign * speed, grain=grain)
        case "displacement":
            return Displacement(displacement=sign * speed / omega, grain=grain)
        case "profile":
            fields = {}
            for key, size in (("velocity", speed), ("displacement", speed / omega)):
                if rng.random() < 0.7 or (key == "displacement" and not fields):
                    fields[key] = np.zeros(chain.grains)
                    struck = slice(grain - 1, min(grain + 20, chain.movable))
                    fields[key][struck] = size * rng.normal(size=fields[key][struck].size)
            return Profile(**fields)
        case "sine":
            frequency = omega * _log(rng, 0.02, 3)
            return Drive(amplitude=sign * speed / frequency, frequency=frequency / (2 * np.pi))
    times = np.append(0, np.cumsum(rng.uniform(0.3, 1, rng.integers(1, 30))))
    path = (
        np.append(0, rng.normal(size=times.size - 1))
        * speed
        * 2
        * np.pi
        * periods
        / omega
        / times.size
    )
    return Drive(times=times * (2 * np.pi * periods / omega / times[-1]), displacement=path)


def acted_trial_scene(
    rng: np.random.Generator, exponents: tuple[float, ...] = (), work: float = 2e5
) -> Scene:
    """Draw a scene as `trial_scene` does, but with a force, a burst, a moving wall or a packet."""
    while True:
        still = trial_scene(rng, exponents, work)
        try:
            scene = still.replace(excitation=_acting(rng, still.chain, still.duration))
            angle = scene.highest_frequency * scene.duration
            most = max(np.sqrt(work), work / scene.chain.grains)
            if angle > most and not isinstance(scene.excitation, Packet):
                continue
            _ = scene.strike_number, scene.largest_strain
            return scene.replace(duration=scene.duration * min(1.0, most / angle))
        except InputError:
            continue


def _acting(
    rng: np.random.Generator, chain: Chain, duration: float, weakest: float = 1e-10
) -> Force | Drive | Packet:
    """Draw a forcing of this duration with a relative strength from 1e-10 to 100."""
    grain = 1 if rng.random() < 0.4 else int(rng.integers(1, chain.movable + 1))
    kinds = ["force"] * 4 + ["wall"] * 3 * (chain.top == "wall") + ["drive"] * (chain.top == "free")
    kind = rng.choice(kinds + ["packet"] * 3 * chain.compressed)
    contact = max(grain - 1, int(chain.top == "free")) if kind == "force" else int(kind == "drive")
    while (kind == "force" or chain.loose_grains) and (
        chain.compressed and chain.contacts.force[contact] == 0.0
    ):
        # For an unloaded wall above grain 1, the contact below the grain is used.
        contact += 1
    constant = chain.contacts.constant[contact]
    mass = chain.masses[max(contact - 1, 0)]
    held = chain.contacts.force[contact] if chain.compressed else _log(rng, 1e-6, 10)
    size = float(rng.choice([-1.0, 1.0])) * held * _log(rng, weakest, 1e2)
    length = abs(size) / chain.contacts.stiffness[contact] if chain.compressed else 0.0
    length = (
        max(length, (abs(size) / constant) ** (1 / chain.exponent)) if abs(size) > held else length
    )
    if not chain.compressed:
        length = (abs(size) / constant) ** (1 / chain.exponent)
    omega = chain.band_edge if chain.compressed else float(np.sqrt(abs(size) / length / mass))
    frequency = omega * _log(rng, 0.02, 3) / (2 * np.pi)
    if kind == "packet":
        middle = (chain.grains + 1) // 2
        width = _log(rng, 1.5, max(1.6, chain.grains / 10))
        return Packet(
            frequency=frequency / 3,
            width=width,
            grain=middle,
            amplitude=float(np.sign(size)) * length,
        )
    strength = size if kind == "force" else float(np.sign(size)) * length
    where: dict[str, Any] = {"grain": grain if kind == "force" else int(kind == "drive")}
    acts: Any = Force if kind == "force" else Drive
    course = rng.choice(
        ["sine", "burst", "burst", "spline", *["half-sine"] * 2 * (kind == "force")]
    )
    if course == "half-sine":
        return Force(shape="half-sine", amplitude=strength, duration=0.5 / frequency, **where)
    if course == "spline":
        times = np.append(0, np.cumsum(rng.uniform(0.3, 1, rng.integers(2, 30))))
        path = np.append(0, rng.normal(size=times.size - 1)) * strength
        values: dict[str, Any] = {"force" if kind == "force" else "displacement": path}
        # A spline through such uneven points would mostly be rejected.
        values["interpolation"] = "linear" if path[-1] > path[1] else "pchip"
        return acts(times=times * (duration * rng.uniform(1, 1.2) / times[-1]), **values, **where)
    cycles = {} if course == "sine" else {"cycles": _log(rng, 0.6, 20)}
    return acts(amplitude=strength, frequency=frequency, **cycles, **where)
