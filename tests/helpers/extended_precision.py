"""An independent chain and its tangent map by a kick-drift splitting in 80-bit numbers."""

import numpy as np

from lmpchain import Chain
from lmpchain.integrators.methods import Splitting

REAL = np.longdouble


def tangent_map(
    chain: Chain,
    displacement: np.ndarray,
    velocity: np.ndarray,
    steps: np.ndarray,
    splitting: Splitting,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the displacement and velocity (M,) after these steps, s, and derivatives (2M, 2M)."""
    size = chain.movable
    delta = REAL(chain.exponent)
    constant, rest = (
        x.astype(REAL)[: size + 1, None] for x in (chain.contacts.constant, chain.contacts.force)
    )
    mass = chain.masses.astype(REAL)[:size, None]
    overlap = np.where(constant > 0, (rest / np.where(constant > 0, constant, 1)) ** (1 / delta), 0)
    x = displacement[:size, None].astype(REAL)
    v = velocity[:size, None].astype(REAL)
    dx, dv = np.split(np.eye(2 * size, dtype=REAL), 2)

    def shortening(u: np.ndarray) -> np.ndarray:
        still = np.zeros((1, u.shape[1]), dtype=REAL)
        return -np.diff(np.concatenate((still, u, still)), axis=0)

    for step in steps:
        for kick, drift in zip(splitting.kicks, (*splitting.drifts, 0.0), strict=True):
            o = np.maximum(overlap + shortening(x), 0)
            v = v - REAL(kick) * REAL(step) * np.diff(constant * o**delta - rest, axis=0) / mass
            pull = delta * constant * o ** (delta - 1) * shortening(dx)
            dv = dv - REAL(kick) * REAL(step) * np.diff(pull, axis=0) / mass
            x = x + REAL(drift) * REAL(step) * v
            dx = dx + REAL(drift) * REAL(step) * dv
    return x[:, 0], v[:, 0], np.concatenate((dx, dv))
