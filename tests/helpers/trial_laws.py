"""Scenes with random laws by formula, each from a seed, with the law also as terms.

One to three pieces a law, with kinks anywhere, pulls, bonds, softening and stiffening, parameters
for all contacts or for each, 1 to 12 grains, every end, gravity, loads, damping, strikes, drives,
moving walls and forces.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from helpers.extrapolated_midpoint import TERMS, Term

from lmpchain import Chain, Damping, Drive, Force, Impulse, InputError, Law, Scene

PIECES = (
    *("power", "power", "shifted", "spring", "cubic", "toda", "bilinear", "tanh"),
    *("pull", "sine", "soft", "square", "log", "stiffened", "ramp", "gap", "bend"),
)


def _log(rng: np.random.Generator, low: float, high: float) -> float:
    return float(np.exp(rng.uniform(np.log(low), np.log(high))))


def law_trial(rng: np.random.Generator) -> Scene:
    """Draw a scene with a law by formula, and add its terms to `TERMS`."""
    while True:
        try:
            return _drawn(rng)
        except InputError:  # There is no equilibrium, or several, or an infinite stiffness.
            continue


def _piece(
    rng: np.random.Generator, n: int, grains: int, unit: tuple[float, float]
) -> tuple[str, dict[str, Any], list[Term]]:
    """Draw formula, parameters and terms of one piece; parameter names end with n.

    The unit is a stiffness, N/m, and a length, m.
    """
    stiffness, length = unit

    def many(value: float) -> Any:
        if grains < 2 or rng.random() > 0.15:
            return value
        return value * np.linspace(0.8, 1.25, grains - 1)[rng.permutation(grains - 1)]

    k = many(stiffness * _log(rng, 0.3, 3))
    s = float(length * rng.uniform(-1.5, 1.5))
    b = many(_log(rng, 0.1, 2) / length)
    r = many(float(rng.uniform(0.1, 0.9)))
    exponents = (1.0, 1.5, 1.5, 2.0, 2.5, 3.0, rng.uniform(1, 3), rng.uniform(0.4, 1))
    p = float(rng.choice(exponents))
    names = {key: f"{key}{n}" for key in "kabsrp"}
    match rng.choice(PIECES).item():
        case "power":
            a = k * length ** (1 - p)
            text, values, terms = "a*max(o, 0)**p", {"a": a, "p": p}, [Term("one-sided", a, p=p)]
        case "shifted":
            p = max(p, 1.0)
            a = k * length ** (1 - p)
            text, values = "a*max(o - s, 0)**p", {"a": a, "s": s, "p": p}
            terms = [Term("one-sided", a, e=s, p=p)]
        case "spring":
            text, values, terms = "k*o", {"k": k}, [Term("power", k)]
        case "cubic":
            a, c = 0.8 * r / length, r**2 / length**2
            text, values = "k*(o - a*o**2 + b*o**3)", {"k": k, "a": a, "b": c}
            terms = [Term("power", x, p=q) for x, q in ((k, 1), (-k * a, 2), (k * c, 3))]
        case "toda":
            text, values = "k*(exp(b*o) - 1)/b", {"k": k, "b": b}
            terms = [Term("exp", k / b, b)]
        case "bilinear":
            text, values = "k*(max(o, 0) + r*min(o, 0))", {"k": k, "r": r}
            terms = [Term("one-sided", k), Term("one-sided", -k * r, sign=-1.0)]
        case "tanh":
            text, values, terms = "k*tanh(b*o)/b", {"k": k, "b": b}, [Term("tanh", k / b, b)]
        case "pull":
            a, reach = k * length, abs(s) + 0.1 * length
            text = "1.5*k*max(o, 0) - r*a*min(1, max(0, 1 + o/s))"
            values = {"k": k, "a": a, "s": reach, "r": r}
            pull = r * a / reach
            terms = [Term("one-sided", 1.5 * k), Term("one-sided", -pull, e=-reach)]
            terms.append(Term("one-sided", pull))
        case "sine":
            text, values = "k*(o + r*sin(b*o)/b)", {"k": k, "r": r, "b": b}
            terms = [Term("power", k), Term("sine", k * r / b, b)]
        case "soft":
            text, values = "k*o/sqrt(1 + (b*o)**2)", {"k": k, "b": b}
            terms = [Term("soft", k, b)]
        case "square":
            a = k / length
            text, values = "a*o*abs(o)", {"a": a}
            terms = [Term("one-sided", a, p=2.0), Term("one-sided", -a, p=2.0, sign=-1.0)]
        case "log":
            text, values = "k*log(1 + b*max(o - s, 0))/b", {"k": k, "b": b, "s": s}
            terms = [Term("log", k / b, b, s)]
        case "stiffened":
            a = k * length**-0.5
            text, values = "a*max(o, 0)**1.5*(1 + b*o)", {"a": a, "b": b}
            terms = [Term("one-sided", a, p=1.5), Term("one-sided", a * b, p=2.5)]
        case "ramp":
            text, values = "k*step(o - s)*(o - s)", {"k": k, "s": s}
            terms = [Term("one-sided", k, e=s)]
        case "gap":
            s = abs(s)
            text, values = "k*(max(o, 0) + min(o + s, 0))", {"k": k, "s": s}
            terms = [Term("one-sided", k), Term("one-sided", -k, e=-s, sign=-1.0)]
        case _:
            text, values = "k*(o + r*(abs(o - s) - abs(s)))", {"k": k, "r": r, "s": s}
            terms = [Term("power", k), Term("power", -k * r * abs(s), p=0)]
            terms += [Term("one-sided", k * r, e=s, sign=sign) for sign in (1.0, -1.0)]
    for key in values:
        text = _renamed(text, key, names[key])
    return text, {names[key]: value for key, value in values.items()}, terms


def _renamed(text: str, key: str, new: str) -> str:
    """Return a formula with a parameter renamed."""
    words = "".join(c if c.isalnum() or c == "_" else " " for c in text)
    for at in range(len(text) - 1, -1, -1):
        alone = words[at] == key and (words[:at][-1:] + words[at + 1 :][:1]).strip() == ""
        if alone:
            text = text[:at] + new + text[at + 1 :]
    return text


def _drawn(rng: np.random.Generator) -> Scene:
    grains = int(rng.integers(1, 13))
    unit = _log(rng, 1e2, 1e6), _log(rng, 1e-7, 1e-5)
    pieces = [
        _piece(rng, n, grains, unit) for n in range(rng.choice([1, 1, 1, 2, 2, 3], shuffle=False))
    ]
    terms = [term for _, _, found in pieces for term in found]
    parameters = {key: value for _, values, _ in pieces for key, value in values.items()}
    law = Law(" + ".join(text for text, _, _ in pieces), **parameters)
    pressed = rng.choice(["gravity", "load", "load", "both", "vacuum"]).item()
    ends = ["fixed", "wall", *["free"] * 2 * (pressed == "vacuum")]
    mass = _log(rng, 1e-7, 1e-4)
    force = unit[0] * unit[1]
    fields: dict[str, Any] = {
        "grains": grains,
        "diameter": 1e-2,
        "masses": mass * (rng.uniform(0.3, 1, grains) if rng.random() < 0.4 else np.ones(grains)),
        "gravity": force / mass / grains * _log(rng, 1e-3, 3) * (pressed in ("gravity", "both")),
        "top_load": force * _log(rng, 1e-2, 3) * (pressed in ("load", "both")),
        "top": "wall" if rng.random() < 0.3 else "free",
        "bottom": rng.choice(ends).item() if grains > 1 else "wall",
        "law": law,
    }
    omega = float(np.sqrt(unit[0] / mass))
    below_one = any(np.min(term.p) < 1 and term.kind == "one-sided" for term in terms)
    if rng.random() < 0.3:
        damping: dict[str, Any] = {"drag": _log(rng, 1e-3, 1) * omega}
        if rng.random() < 0.7 and not below_one:
            damping["viscoelastic"] = _log(rng, 1e-3, 1) / omega
        fields["damping"] = Damping(**damping)
    chain = Chain(**fields)
    size = _log(rng, 1e-4, 3)
    speed = float(rng.choice([-1.0, 1.0])) * size * unit[1] * omega
    grain = int(rng.integers(1, chain.movable + 1))
    frequency = omega * _log(rng, 0.1, 2)
    kinds = ["impulse"] * 5 + ["force", "half-sine"]
    kinds += ["drive"] if chain.top == "wall" or grains > 1 else []
    excitation: Any
    match rng.choice(kinds).item():
        case "impulse":
            excitation = Impulse(velocity=speed, grain=grain)
        case "force":
            push = mass * speed * omega
            excitation = Force(amplitude=push, frequency=frequency / 2 / np.pi, grain=grain)
        case "half-sine":
            push = mass * speed * omega
            excitation = Force(
                shape="half-sine", amplitude=push, duration=np.pi / frequency, grain=grain
            )
        case _:
            excitation = Drive(
                amplitude=speed / omega,
                frequency=frequency / 2 / np.pi,
                grain=0 if chain.top == "wall" else 1,
            )
    samples = int(rng.integers(2, 22))
    once = Scene(chain=chain, excitation=excitation, duration=1 / omega, samples=samples)
    angle = _log(rng, 2, 200)
    TERMS[law] = terms
    return once.replace(duration=angle / max(once.highest_frequency, omega))
