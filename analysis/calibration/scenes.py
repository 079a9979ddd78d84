"""Random scenes for the calibration: all exponents, ends, loads and excitations."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from lmpchain import Chain, Displacement, Drive, Impulse, InputError, Packet, Profile, Scene

EXPONENTS = (1.0, 1.1, 1.25, 1.5, 1.5, 1.5, 1.5, 2.0, 2.5, 3.0)
KINDS = ("gravity", "gravity", "load", "both", "vacuum")


def draw(
    rng: np.random.Generator,
    exponents: Sequence[float] = EXPONENTS,
    kinds: Sequence[str] = KINDS,
    strength: tuple[float, float] = (-4.0, 4.0),
    grains: Sequence[int] = (2, 3, 5, 12, 30, 60),
    spans: tuple[float, float] = (2.0, 20.0),
    driven: float = 0.15,
    samples: int = 11,
) -> Scene:
    """Draw a valid scene.

    Parameters
    ----------
    strength : pair of float
        Decades between which the strike number lies, where there is one.
    spans : pair of float
        Between which the duration lies, in units of 1 / frequency of the contact that is struck.
    driven : float
        Part of the scenes that are driven at a free top.
    """
    while True:
        try:
            chain = _chain(
                rng, float(rng.choice(exponents)), str(rng.choice(kinds)), int(rng.choice(grains))
            )
            return _excited(rng, chain, strength, spans, driven, samples)
        except InputError:
            continue


def drawn(
    count: int, seed: int, keep: Callable[[Scene], bool] = lambda scene: True, **ranges: object
) -> list[Scene]:
    """Draw this number of random scenes that pass the filter."""
    rng = np.random.default_rng(seed)
    found = []
    while len(found) < count:
        scene = draw(rng, **ranges)  # type: ignore[arg-type]
        if keep(scene):
            found.append(scene)
    return found


def trains(count: int, seed: int) -> list[Scene]:
    """Return long uniform chains in which a packet or driven wave makes at most two passages."""
    rng = np.random.default_rng(seed)
    found = list[Scene]()
    while len(found) < count:
        try:
            found.append(_train(rng, packet=len(found) % 2 == 0))
        except InputError:
            continue
    return found


def _train(rng: np.random.Generator, packet: bool) -> Scene:
    chain = Chain(
        grains=int(10 ** rng.uniform(2, 3.3)),
        diameter=10 ** rng.uniform(-3.5, -2),
        gravity=rng.choice((0.0, 9.81)),
        top_load=10 ** rng.uniform(-2, 1),
        exponent=rng.choice((1.1, 1.5, 2.0, 3.0)),
    )
    hop = np.sqrt(chain.linear_stiffness[0] / chain.masses[0])
    ratio = 10 ** rng.uniform(-1.5, -0.1)
    height = 10 ** rng.uniform(-5, -2.5) * chain.equilibrium_overlap[0] / (2 * ratio)
    wave: dict[str, float] = {"frequency": ratio * hop / np.pi, "amplitude": height}
    width = rng.uniform(0.3, 1.0) * chain.grains / 13
    excitation = Packet(**wave, grain=chain.grains // 2, width=width) if packet else Drive(**wave)
    duration = chain.grains * 10 ** rng.uniform(-1.5, 0.3) / hop
    return Scene(chain=chain, excitation=excitation, duration=duration, samples=41)


def _chain(rng: np.random.Generator, exponent: float, kind: str, grains: int) -> Chain:
    top = "wall" if rng.random() < 0.25 else "free"
    ends = ("fixed", "wall", "free") if kind == "vacuum" else ("fixed", "fixed", "wall")
    even = rng.random() < 0.6
    diameter = 10 ** rng.uniform(-3.5, -2)
    return Chain(
        grains=grains,
        material=str(rng.choice(["glass", "steel", "ptfe"])),
        diameter=diameter if even else diameter * rng.uniform(0.7, 1.4, grains),
        gravity=9.81 * 10 ** rng.uniform(-2, 2) if kind in ("gravity", "both") else 0.0,
        top_load=10 ** rng.uniform(-4, 1) if kind in ("load", "both") else 0.0,
        exponent=exponent,
        top=top,
        bottom=str(rng.choice(ends)),
    )


def _units(rng: np.random.Generator, chain: Chain, grain: int) -> tuple[float, float]:
    """Return the units of length and frequency.

    Of the contact at this grain, or in the vacuum of a strike of random speed.
    """
    if chain.compressed:
        contact = min(grain, chain.grains - 1) - 1
        stiffness = chain.linear_stiffness[contact]
        mass = chain.masses[contact]
        return float(chain.equilibrium_overlap[contact]), float(np.sqrt(stiffness / mass))
    speed = 10 ** rng.uniform(-4, -0.5)
    delta = chain.exponent
    length = (chain.masses.mean() * speed**2 / chain.contact_constants.mean()) ** (1 / (delta + 1))
    return float(length), float(speed / length)


def _excited(
    rng: np.random.Generator,
    chain: Chain,
    strength: tuple[float, float],
    spans: tuple[float, float],
    driven: float,
    samples: int,
) -> Scene:
    drive = chain.top == "free" and rng.random() < driven
    grain = 1 if drive or rng.random() < 0.6 else int(rng.integers(1, chain.movable + 1))
    length, omega = _units(rng, chain, grain)
    number = 10 ** rng.uniform(*strength) if chain.compressed else 1.0
    what = rng.random()
    excitation: Drive | Impulse | Displacement | Profile
    if drive:
        frequency = omega / (2 * np.pi) * 10 ** rng.uniform(-1, 0.3)
        excitation = Drive(amplitude=length * min(number, 10.0), frequency=frequency)
    elif what < 0.6 or not chain.compressed:
        excitation = Impulse(velocity=number * length * omega, grain=grain)
    elif what < 0.8:
        excitation = Displacement(
            displacement=rng.choice([-1.0, 1.0]) * min(number, 50.0) * length, grain=grain
        )
    else:
        velocity = rng.normal(size=chain.grains) * min(number, 10.0) * length * omega
        velocity[chain.movable :] = 0.0
        excitation = Profile(velocity=velocity)
    duration = rng.uniform(*spans) / omega
    return Scene(chain=chain, excitation=excitation, duration=duration, samples=samples)
