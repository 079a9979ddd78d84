"""Measure linear theory's predictions of contact openings, and of waves in resonance.

Opening and FEW.

LOOKS.opening: the lowest strain that a look sees, over that of sixteen times as many evaluations of
the same linear solution; of a hundred contacts that open 99 must be seen, and few that do not. FEW:
long runs, with and without resonances in their estimate; it is supported from the most grains in
which they bring three quarters of estimates closer to the truth, the nonlinear motion by the native
engine at a tolerance of 1e-9, up to twice as many: more pairs take more time, and say 20 times too
much of a driven column of 50 grains.

    python analysis/calibration/linear_openings.py           # two minutes
    python analysis/calibration/linear_openings.py --quick   # seconds
"""

from __future__ import annotations

import math
from unittest import mock

import numpy as np
from common import Row, command, quantile
from linear_model_error import held
from scenes import drawn

from lmpchain import Scene
from lmpchain.engines.linear import model_error
from lmpchain.engines.linear.engine import Modes
from lmpchain.engines.linear.model_error import FEW, LOOKS
from lmpchain.errors import InputError

FINER = 16  # Ratio of the numbers of evaluations.
# Range of the lowest strain in which a coarse evaluation first reports an opening.
AROUND = (0.96, 1.04)
BISECTIONS = 10
ALL = {"kinds": ("gravity", "load"), "driven": 0.0, "grains": (2, 3, 5, 12)}


def lowest(scene: Scene, per_radian: float) -> float:
    """Return the lowest strain of the linear solution at this many evaluations per radian."""
    times = np.linspace(
        0, scene.duration, math.ceil(per_radian * scene.duration * scene.linear_frequency) + 1
    )
    u = Modes().solve(scene, {}).at(times)[0]
    contacts = scene.chain.contacts
    still = np.zeros((len(times), 1))
    closer = -np.diff(np.hstack((still, u, still)), axis=1)
    return float((closer[:, contacts.pressed] / contacts.overlap[contacts.pressed]).min())


def seen(scene: Scene) -> float:
    """Return the ratio of the lowest evaluated strain to the true one.

    It says that a contact opens from `opening` on.
    """
    deepest, low, high = lowest(scene, FINER * LOOKS.resolved), *AROUND
    for _ in range(BISECTIONS):
        middle = (low + high) / 2
        opens = (
            Modes()
            .look(scene.replace(excitation=scene.excitation.scaled(-middle / deepest)))
            .remark
        )
        low, high = (low, middle) if opens else (middle, high)
    return -LOOKS.opening / high


def _open(scenes: list[Scene]) -> Row:
    """Return the row of `opening`: the part of the lowest strain that evaluations may miss."""
    parts = []
    for scene in scenes:
        try:
            parts.append(seen(scene))
        except InputError:  # The strike is beyond the range of a law.
            continue
    least = min(parts)
    one = quantile(parts, 0.01)
    half = quantile(parts, 0.5)
    says = (
        f"lowest strain that a look sees over the true one, {len(parts)} scenes: half {half:.4f}, "
        f"1 % {one:.4f}"
    )
    return Row(
        "LOOKS.opening", LOOKS.opening, -one, -one, -one + 0.02, f"{says}, least {least:.4f}"
    )


def _few(count: int) -> Row:
    """Return the row of FEW.

    Up to how many grains resonances bring estimates closer to the truth.
    """
    closer: dict[int, float] = {}
    for grains in (2, 4, 8, 12, 20):
        ranges = {
            "kinds": ("gravity", "load"),
            "exponents": (1.5, 2.0, 3.0),
            "samples": 101,
            "grains": (grains,),
        }
        off: tuple[list[float], list[float]] = [], []
        with mock.patch.object(model_error, "FEW", 2 * FEW):
            for x in held(drawn(count, 73, strength=(-3.0, -0.5), spans=(60.0, 300.0), **ranges)):
                rest = max(x.found.shifted, x.found.strayed)
                for way, logarithms in zip((max(rest, x.found.resonant), rest), off, strict=True):
                    logarithms.append(abs(math.log(way / x.true)))
        closer[grains] = quantile(off[1], 0.75) - quantile(off[0], 0.75)
    last = max((grains for grains, gain in closer.items() if gain > 0.05), default=0)
    listed = ", ".join(f"{grains}: {math.exp(gain):.2f}" for grains, gain in closer.items())
    says = (
        "factor by which three quarters of estimates are closer with resonances, by grains: "
        f"{listed}"
    )
    return Row("FEW (waves)", FEW, last, last, 2 * FEW, says)


def main(quick: bool = False) -> list[Row]:
    """Return a row for each constant."""
    count = 10 if quick else 60
    looked = drawn(count, 70, strength=(-1.0, 0.3), spans=(5.0, 60.0), **ALL)
    return [_open(looked), _few(count // 2)]


if __name__ == "__main__":
    command(main, __doc__)
