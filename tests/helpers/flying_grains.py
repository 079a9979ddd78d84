"""Few unlike grains that all move, for comparisons with plain NumPy."""

from typing import Any

import numpy as np
from helpers.example_chains import random_column

from lmpchain import Chain, Drive, Force, Profile, Scene


def unlike(grains: int, **options: Any) -> Chain:
    """Return grains of random diameters under gravity and a load."""
    return random_column(grains, 2, 0.3, 2e-3, **{"gravity": 30.0, "top_load": 0.02} | options)


def flying(
    chain: Chain, seed: int, sizes: tuple[float, float], radians: float, samples: int
) -> Scene:
    """Return a scene whose displacements and velocities have these sizes at random.

    The units are the largest overlap at rest, and its product with the highest frequency.
    """
    scale = chain.contacts.overlap.max() or 1e-7
    stiff = chain.contacts.stiffness_at(np.full(chain.grains + 1, scale))
    edge = chain.band_edge or float(np.sqrt(stiff.max() / chain.masses.min()))
    speeds = np.random.default_rng(seed).uniform(-1, 1, (2, chain.grains))
    u, v = speeds * [[sizes[0] * scale], [sizes[1] * scale * edge]]
    u[chain.movable :] = v[chain.movable :] = 0
    profile = Profile(displacement=u, velocity=v)
    return Scene(chain=chain, excitation=profile, duration=radians / edge, samples=samples)


def forcings(chain: Chain, radians: float, **points: Any) -> dict[str, Drive | Force]:
    """Return motions and forces for a run of this many radians of the fastest motion.

    Bursts end within the run. `points` are options of the curves through samples.
    """
    duration = radians / chain.band_edge
    frequency = 0.4 * chain.band_edge / (2 * np.pi)
    size, held = float(chain.contacts.overlap.max()), float(chain.contacts.force.max())
    sine = {"amplitude": size, "frequency": frequency}
    push = {"amplitude": held, "frequency": frequency}
    burst = {"cycles": 0.43 * frequency * duration}
    times = np.array([0.0, 0.21, 0.44, 0.76, 1.1]) * duration
    bump = np.array([0.0, 1.0, -0.5, 0.8, 0.3])
    curve = {"times": times, "displacement": size * bump} | points
    half = {"shape": "half-sine", "amplitude": held, "duration": 0.43 * duration}
    return {
        "sine of grain 1": Drive(**sine),
        "burst of grain 1": Drive(**sine, **burst),
        "samples of grain 1": Drive(**curve),
        "sine of the wall": Drive(**sine, grain=0),
        "burst of the wall": Drive(**sine, **burst, grain=0),
        "samples of the wall": Drive(**curve, grain=0),
        "sine on grain 3": Force(**push, grain=3),
        "burst on grain 1": Force(**push, **burst, grain=1),
        "half-sine on the last grain": Force(**half, grain=chain.grains),
        "samples on grain 2": Force(times=times, force=held * bump, grain=2, **points),
    }
