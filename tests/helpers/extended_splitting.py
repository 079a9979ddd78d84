"""Kick-drift splittings in extended precision, derived from Eq. (1) alone.

Differences of their results check derivatives. The chain is derived here from its diameters and
moduli, so that one number can be changed at a time.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from helpers.forcing import Curve
from numpy.typing import NDArray

from lmpchain import Scene
from lmpchain.integrators.methods import Splitting

Array = NDArray[np.longdouble]
WIDE = np.longdouble


def parameters(scene: Scene) -> dict[str, Array]:
    """Return all parameters that may be changed."""
    chain = scene.chain
    excitation = scene.excitation
    u, v = scene.initial()
    made = {
        "masses": chain.masses,
        "contact_constants": chain.contact_constants,
        "wall_constants": chain.wall_constants,
        "diameters": chain.diameters,
        "youngs_modulus": chain.by_grain("youngs_modulus"),
        "top_load": [chain.top_load],
        "gravity": [chain.gravity],
        "displacement": u,
        "velocity": v,
    }
    if excitation.does_work and excitation.times is None:
        made["amplitude"] = [excitation.amplitude]
        if excitation.frequency is not None:
            made["frequency"] = [excitation.frequency]
    elif excitation.does_work:
        made[excitation.kind] = getattr(excitation, excitation.strength[1])
    return {name: np.array(value, dtype=WIDE) for name, value in made.items()}


def _hertz(scene: Scene, young: Array, d: Array) -> Array:
    """Return Hertz's constants of all contacts, with a wall at either end."""
    chain = scene.chain
    poisson = chain.by_grain("poissons_ratio").astype(WIDE)
    modulus = young / (1 - poisson**2)
    walls = []
    for wall, grain in ((chain.top_material, modulus[0]), (chain.bottom_material, modulus[-1])):
        walls.append(
            grain
            if wall is None
            else WIDE(wall.youngs_modulus) / (1 - WIDE(wall.poissons_ratio) ** 2)
        )
    modulus = np.array([walls[0], *modulus, walls[1]])
    together = modulus[:-1] * modulus[1:] / (modulus[:-1] + modulus[1:])
    radius = np.array([d[0] / 2, *(d[:-1] * d[1:] / (d[:-1] + d[1:]) / 2), d[-1] / 2])
    mean = np.array([d[0], *((d[:-1] + d[1:]) / 2), d[-1]])
    return WIDE(4) / 3 * together * np.sqrt(radius) * mean ** (WIDE(3) / 2 - WIDE(chain.exponent))


def made_of(scene: Scene, changed: dict[str, Array]) -> dict[str, Any]:
    """Return the properties of a chain with some parameters changed, and derived values."""
    chain = scene.chain
    now = parameters(scene)
    before = {name: value.copy() for name, value in now.items()}
    now |= changed
    natural = _hertz(scene, now["youngs_modulus"], now["diameters"])
    original = _hertz(scene, before["youngs_modulus"], before["diameters"])
    if "masses" not in chain.given() and "masses" not in changed:
        own = [odd.grain - 1 for odd in chain.impurity if odd.mass]
        factor = (now["diameters"] / before["diameters"]) ** 3
        factor[own] = 1
        now["masses"] = before["masses"] * factor
    if "contact_constants" not in chain.given() and "contact_constants" not in changed:
        now["contact_constants"] = before["contact_constants"] * (natural / original)[1:-1]
    if "wall_constants" not in chain.given() and "wall_constants" not in changed:
        follow = now["contact_constants"][[0, -1]] / before["contact_constants"][[0, -1]]
        ratio = natural / original
        now["wall_constants"] = (
            before["wall_constants"] * follow * (ratio[[0, -1]] / ratio[[1, -2]])
        )
    return now


def _motion(scene: Scene, now: dict[str, Any]) -> Callable[[Any], tuple[Any, Any]] | None:
    """Return the imposed displacement or force, and its rate, as functions of time."""
    excitation = scene.excitation
    if not excitation.does_work:
        return None
    if excitation.times is None:
        turn = 8 * np.arctan(WIDE(1))
        size = now["amplitude"][0]
        cycles = excitation.cycles
        if "frequency" not in now:
            end = WIDE(excitation.duration)
            omega = turn / 2 / WIDE(excitation.duration)
        else:
            omega = turn * now["frequency"][0]
            end = WIDE(np.inf) if cycles is None else cycles / now["frequency"][0]
        part = WIDE(0) if cycles is None else omega / (2 * WIDE(cycles))

        def wave(t: Any) -> tuple[Any, Any]:
            if t >= end:
                return WIDE(0), WIDE(0)
            if not part:
                return size * np.sin(omega * t), size * omega * np.cos(omega * t)
            hann = np.sin(part * t) ** 2
            rate = part * np.sin(2 * part * t)
            return size * np.sin(omega * t) * hann, size * (
                omega * np.cos(omega * t) * hann + np.sin(omega * t) * rate
            )

        return wave
    curve = Curve(excitation, now[excitation.kind], WIDE)
    knots = curve.knots
    pieces = curve.pieces[::-1]

    def spline(t: Any) -> tuple[Any, Any]:
        at = min(max(int(np.searchsorted(knots, t, side="right")) - 1, 0), knots.size - 2)
        s = t - knots[at]
        (a, b, c, d) = pieces[:, at]
        return ((a * s + b) * s + c) * s + d, (3 * a * s + 2 * b) * s + c

    return spline


def run(
    scene: Scene, method: Splitting, steps: int, looks: int, changed: dict[str, Array]
) -> tuple[Array, Array, Any]:
    """Return the displacement and velocity (looks+1, N) at equal intervals, and the chain."""
    chain = scene.chain
    now = made_of(scene, changed)
    m = now["masses"]
    delta = WIDE(chain.exponent)
    k = np.concatenate(
        (now["wall_constants"][:1], now["contact_constants"], now["wall_constants"][1:])
    )
    carried = now["top_load"][0] + now["gravity"][0] * np.concatenate(([WIDE(0)], np.cumsum(m)))
    carried = np.where(k > 0, carried, 0)
    overlap = np.where(k > 0, carried / np.where(k > 0, k, 1), 0) ** (1 / delta)
    x = now["displacement"].copy()
    v = now["velocity"].copy()
    free = np.ones(chain.grains, dtype=WIDE)
    free[chain.movable :] = 0
    motion = _motion(scene, now)
    driven = scene.excitation.driven
    wall = scene.excitation.kind == "drive" and not driven
    if driven:
        free[0] = 0
        v[0] = 0
    h = WIDE(scene.duration) / (looks * steps)
    offsets = np.concatenate(([WIDE(0)], np.cumsum(np.array(method.drifts, dtype=WIDE))))
    offsets[-1] = 1
    seen = [(x.copy(), v.copy())]

    def kick(fraction: float, t: Any) -> None:
        if driven:
            x[0] = motion(t)[0]
        r = -np.diff(x, prepend=motion(t)[0] if wall else WIDE(0), append=WIDE(0))
        s = np.where(carried > 0, r / np.where(carried > 0, overlap, 1), r)
        with np.errstate(all="ignore"):
            held = np.where(s > -1, np.expm1(delta * np.log1p(np.maximum(s, -1))), -1)
        f = np.where(carried > 0, carried * held, k * np.maximum(r, 0) ** delta)
        pull = f[:-1] - f[1:]
        if motion and not driven and not wall:
            pull[scene.excitation.grain - 1] += motion(t)[0]
        v[:] += WIDE(fraction) * h * free * pull / m

    for look in range(looks):
        for step in range(steps):
            begun = (look * steps + step) * h
            for stage, (b, a) in enumerate(zip(method.kicks, (*method.drifts, 0.0), strict=True)):
                kick(b, begun + offsets[stage] * h)
                x[:] += WIDE(a) * h * v
        seen.append((x.copy(), v.copy()))
        if driven:
            x[0] = seen[-1][0][0]
            seen[-1][1][0] = motion((look + 1) * steps * h)[1]
    if driven:
        seen[0][0][0], seen[0][1][0] = motion(WIDE(0))
    return (
        np.array([u for u, _ in seen]),
        np.array([v for _, v in seen]),
        now | {"constants": k, "carried": carried},
    )
