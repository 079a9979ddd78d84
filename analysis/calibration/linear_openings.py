"""Measure what linear theory says of contacts that may open, and of waves in resonance: OPEN, GRAZES and FEW.

OPEN: the lowest strain that a look sees, over that of sixteen times as many evaluations of the same linear solution; a
contact that opens must not be missed. GRAZES: chains of springs, for which an opening is all that linear theory leaves
out, struck so that one opens by a few percent: the error of eigenmodes against the Taylor series in extended precision;
supported between a quarter of them and the most. FEW: the bounds of long runs of few grains, without their resonances:
it is supported from the most grains in which an estimate would be below a third of the truth without them, the truth
being the nonlinear motion by the native engine at a tolerance of 1e-9.

    python analysis/calibration/linear_openings.py           # two minutes
    python analysis/calibration/linear_openings.py --quick   # seconds
"""

from __future__ import annotations

import math

import numpy as np
from common import Case, Row, answer, command, quantile
from linear_model_error import LOW, SLOWS, SMALL, held, slowed, strayed
from scenes import drawn

from lmpchain import Scene
from lmpchain.engines.linear.engine import Modes
from lmpchain.engines.linear.model_error import GRAZES, OPEN, RESOLVED, STRAYS, fastest
from lmpchain.engines.linear.resonance import FEW
from lmpchain.errors import InputError

FINER = 16  # evaluations over those of a look
DEEPER = (1.0, 1.03)  # lowest strains of contacts that graze
ALL = {"kinds": ("gravity", "load"), "driven": 0.0, "grains": (2, 3, 5, 12)}


def lowest(scene: Scene, per_radian: float) -> float:
    """Return the lowest strain of any contact along the linear solution, with so many evaluations a radian."""
    times = np.linspace(0, scene.duration, math.ceil(per_radian * scene.duration * fastest(scene)) + 1)
    u = Modes().solve(scene, {}).at(times)[0]
    contacts = scene.chain.contacts
    still = np.zeros((len(times), 1))
    closer = -np.diff(np.hstack((still, u, still)), axis=1)
    return float((closer[:, contacts.pressed] / contacts.overlap[contacts.pressed]).min())


def _open(scenes: list[Scene]) -> Row:
    """Return the row of OPEN: what looks may miss of the lowest strain."""
    seen = [lowest(scene, RESOLVED) / deepest for scene in scenes if (deepest := lowest(scene, FINER * RESOLVED)) < 0]
    least, most = min(seen), quantile(seen, 0.5)
    says = f"lowest strain seen over the true one, {len(seen)} scenes: half {most:.4f}, 1 % {quantile(seen, 0.01):.4f}"
    return Row("OPEN", OPEN, -quantile(seen, 0.01), -1.0, -least, f"{says}, least {least:.4f}")


def _grazes(scenes: list[Scene]) -> Row:
    """Return the row of GRAZES: the error that a contact makes that opens a little."""
    errors = []
    rng = np.random.default_rng(72)
    for scene in scenes:
        try:
            grazing = scene.replace(excitation=scene.excitation.scaled(-rng.uniform(*DEEPER) / lowest(scene, 32.0)))
        except InputError:
            continue
        case = Case(grazing)
        if case.known and (run := answer(Modes(), grazing, Modes().candidate(grazing, 1.0))):
            errors.append(case.error(run.motion))
    low, middle, most = quantile(errors, 0.25), quantile(errors, 0.5), max(errors)
    says = (
        f"error where a contact opens by {100 * (DEEPER[1] - 1):.0f} % at most, {len(errors)} scenes: half {middle:.2g}"
    )
    return Row("GRAZES", GRAZES, middle, low, most, f"{says}, quarter {low:.2g}, most {most:.2g}")


def _few(count: int) -> Row:
    """Return the row of FEW: in how many grains resonances are missed by the rest of the estimate."""
    missed: dict[int, list[bool]] = {}
    for grains in (2, 4, 8, 12, 20):
        ranges = {"kinds": ("gravity", "load"), "exponents": (1.5, 2.0, 3.0), "samples": 101, "grains": (grains,)}
        for x in held(drawn(count, 73, strength=(-3.0, -0.5), spans=(60.0, 300.0), **ranges)):
            if x.true < SMALL:
                without = max(x.found._leads, STRAYS * strayed(x.found)) + SLOWS * slowed(x.found)
                missed.setdefault(grains, []).append(without < x.true / LOW)
    parts = {grains: float(np.mean(found)) for grains, found in missed.items()}
    last = max((grains for grains, part in parts.items() if part > 0), default=0)
    listed = ", ".join(f"{grains}: {100 * part:.1f}" for grains, part in parts.items())
    says = f"% of {sum(map(len, missed.values()))} estimates below a third of the truth without, by grains: {listed}"
    return Row("FEW (waves)", FEW, last, last, math.inf, says)


def main(quick: bool = False) -> list[Row]:
    """Return a row for each constant."""
    count = 10 if quick else 60
    seen = drawn(2 * count, 70, strength=(-1.0, 0.3), spans=(5.0, 60.0), **ALL)
    springs = drawn(count, 71, strength=(-2.0, 0.0), exponents=(1.0,), spans=(2.0, 20.0), samples=101, **ALL)
    return [_open(seen), _grazes(springs), _few(count // 2)]


if __name__ == "__main__":
    command(main, __doc__)
