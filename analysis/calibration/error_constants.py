"""Measure the error constant of every integrator: the error at omega h = 1 of the paper's scene.

Each method runs at ever shorter steps of one length; where its error falls with its order, error /
(omega h)^order times 60 / (omega T) is the constant. The truth is the Taylor series in extended
precision. The interval spans the paper's scenes whose contacts stay closed: a strike of 1e-6 m/s,
and those of Fig. 5 at 10 g and at g. Beside it stands what other gentle scenes have (columns and
loaded chains, all ends and exponents, strains below 0.3): the constant of the paper's scene is
small because its wave travels where the column is softest, so that little of it is at the highest
frequency.

    python analysis/calibration/error_constants.py           # half a minute
    python analysis/calibration/error_constants.py --quick   # seconds
"""

from __future__ import annotations

import math

import numpy as np
from common import Case, Row, answer, command, quantile, with_reach
from scenes import drawn

from lmpchain import Chain, Impulse, Scene
from lmpchain.engines.native import Native
from lmpchain.integrators.methods import METHODS

# Errors have the order of the method between this multiple of the rounding error and this largest
# error.
CLEAR = 300.0
LARGEST = 3e-3
REACHES = 2.0 ** -np.arange(-2.0, 6.0)  # Values of omega h.


def paper(velocity: float, gravity: float) -> Scene:
    """Return the paper's struck column: omega T is 64 at gravity 1."""
    chain = Chain(grains=120, diameter=1e-3, gravity=gravity)
    return Scene(chain=chain, excitation=Impulse(velocity=velocity), duration=100e-6, samples=6)


def constants(case: Case, name: str) -> list[float]:
    """Return error / (omega h)^order at omega T = 60, for steps at which it is constant."""
    method = METHODS[name]
    scene = case.scene
    found = []
    engine = Native(name, adaptive=False)
    proposed = engine.propose(scene, 1e-3)
    for reach in REACHES[0.45 * method.stability_limit > REACHES]:
        run = answer(engine, scene, with_reach(scene, proposed, reach))
        if run is None:
            continue
        error = case.error(run.motion)
        floor = 1e-16 * (2 + math.sqrt(run.evaluations)) + case.reference.error
        if CLEAR * floor < error < LARGEST:
            h = run.candidate.step * scene.highest_frequency
            found.append(
                error / h**method.order / max(1.0, scene.highest_frequency * scene.duration / 60)
            )
    return found


def main(quick: bool = False) -> list[Row]:
    """Return a row for each integrator."""
    papers = [Case(paper(*strike)) for strike in ((1e-6, 9.81), (8.57e-4, 98.1), (8.57e-4, 9.81))]
    ranges = {
        "kinds": ("gravity", "load", "both"),
        "strength": (-4.0, -1.5),
        "grains": (12, 30, 60),
    }
    gentle = drawn(
        4 if quick else 60,
        1,
        lambda scene: scene.largest_strain < 0.3,
        spans=(20.0, 60.0),
        **ranges,
    )
    others = [case for case in map(Case, gentle) if case.known]
    rows = []
    for name, method in METHODS.items():
        here, there = (
            [float(np.median(found)) for case in cases if (found := constants(case, name))]
            for cases in (papers, others)
        )
        low, middle, high = (quantile(there, part) for part in (0.05, 0.5, 0.95))
        says = (
            f"paper's scenes {', '.join(f'{c:.2g}' for c in here)}; others: "
            f"median {middle:.2g}, 5 to 95 % {low:.1g} to {high:.1g}"
        )
        rows.append(
            Row(
                f"{name}.error_constant",
                method.error_constant,
                quantile(here, 0.5),
                min(here),
                max(here),
                says,
            )
        )
    return rows


if __name__ == "__main__":
    command(main, __doc__)
