"""Measure the longest steps in struck chains: TRUSTED, FIRST_STEP.safe_strain, and `limit`.

Loaded chains of 12 grains are struck from v0* = 0.01 to 1e4, and the longest step with which they
hold is found by bisection (`blow_up`): a run breaks where a grain has more energy than there is. It
is compared with the law, `limit`. TRUSTED must lie below the smallest ratio of Verlet over 300
periods, FIRST_STEP.safe_strain below the largest strain to which the whole limit holds.

    python analysis/calibration/stability_limits.py           # two minutes
    python analysis/calibration/stability_limits.py --quick   # seconds
"""

from __future__ import annotations

import math

import numpy as np
from common import Row, command

from lmpchain import Chain, Impulse, Scene
from lmpchain.engines.stepping.step_choice import FIRST_STEP
from lmpchain.integrators.methods import METHODS
from lmpchain.stability.pre_run import TRUSTED
from lmpchain.stability.step_limit import blow_up, limit

NUMBERS = np.geomspace(1e-2, 1e4, 7)
# Documented by `limit`: breakdown of runs of a hundred periods, relative to the law.
DOCUMENTED = {
    "verlet": (0.93, 1.0), "kahan-li6": (0.88, 1.0), "dop853": (0.68, 1.02), "rkn4": (1.3, 1.6),
    "rkn6": (2.5, 3.1),
    "kahan-li8": (1.0, 1.5), "gear4": (1.2, 2.4),
}  # fmt: skip


def loaded(strike_number: float, periods: float, grains: int = 12, exponent: float = 1.5) -> Scene:
    """Return a struck, loaded chain with a duration in periods of its band edge."""
    chain = Chain(grains=grains, diameter=1e-3, gravity=0.0, top_load=1e-3, exponent=exponent)
    strike = Impulse(velocity=strike_number * chain.length_scale / chain.time_scale)
    return Scene(
        chain=chain, excitation=strike, duration=periods * 2 * math.pi / chain.band_edge, samples=11
    )


def main(quick: bool = False) -> list[Row]:
    """Return a row for each constant, and for each range in the docstring of `limit`."""
    long = 60 if quick else 300
    numbers = (1.0, 100.0) if quick else NUMBERS
    chains = ((12, 1.5),) if quick else ((12, 1.5), (3, 1.5))
    runs = [loaded(number, long, *chain) for chain in chains for number in numbers]
    ratios = [blow_up(scene, "verlet") / limit(scene, "verlet") for scene in runs]
    strong = [
        (scene, ratio)
        for scene, ratio in zip(runs, ratios, strict=True)
        if scene.largest_strain > FIRST_STEP.safe_strain
    ]
    low = min(ratio for _, ratio in strong)
    least = {n: min(ratio for scene, ratio in strong if scene.chain.grains == n) for n, _ in chains}
    listed = ", ".join(f"{ratio:.3g} of {n} grains" for n, ratio in least.items())
    rows = [
        Row(
            "TRUSTED",
            TRUSTED,
            low,
            0.7 * low,
            low,
            f"smallest step at which Verlet broke within {long} periods, "
            f"over `limit`: {listed}; supported down to 30 % less",
        ),
    ]
    strains = [0.03, 0.3] if quick else [0.01, 0.03, 0.1, 0.2, 0.3, 0.5, 1.0]
    weak = {}
    for strain in strains:
        scene = loaded(1.0, long)
        scene = loaded(strain / scene.largest_strain, long)
        weak[scene.largest_strain] = blow_up(scene, "verlet") / limit(scene, "verlet")
    good = [strain for strain, ratio in weak.items() if ratio > 0.97]
    listed = ", ".join(f"{strain:.2g}: {ratio:.3f}" for strain, ratio in weak.items())
    rows.append(
        Row(
            "FIRST_STEP.safe_strain (limit)",
            FIRST_STEP.safe_strain,
            max(good, default=math.nan),
            0.0,
            max(good, default=math.nan),
            f"strain up to which Verlet holds within 3 % of `limit`: {listed}",
        )
    )
    for name in ("verlet", "rkn6") if quick else METHODS:
        each = [
            blow_up(scene, name) / limit(scene, name)
            for scene in (loaded(number, 100) for number in numbers)
        ]
        least, most = DOCUMENTED[name]
        rows.append(
            Row(
                f"limit: {name}",
                least,
                min(each),
                0.8 * min(each),
                max(each),
                f"runs break at {min(each):.3g} to {max(each):.3g} of `limit`; said are {least} to "
                f"{most}",
            )
        )
    return rows


if __name__ == "__main__":
    command(main, __doc__)
