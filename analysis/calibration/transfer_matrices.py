"""Measure WARM_UP, the initial fraction of every random chain that transfer matrices ignore.

The share of modes below some frequencies of Dyson's solvable chains, found in many short ones, is
held against his exact result; the Lyapunov exponent against that of chains a hundred times as long.
A share is supported if what the top of the chains adds is below half of what their scatter makes of
sixteen (the default), in the root mean square, and that scatter within a tenth of the least.

    python analysis/calibration/transfer_matrices.py           # a minute
    python analysis/calibration/transfer_matrices.py --quick   # seconds
"""

from __future__ import annotations

import math
from unittest import mock

import numpy as np
from common import Row, command
from scipy.stats import gamma

from lmpchain.disorder import density_of_states, lyapunov, transfer_matrix
from lmpchain.disorder.transfer_matrix import WARM_UP
from lmpchain.theory import dyson

SHARES = (0.0, 0.01, 0.03, 0.1, 0.2, 0.4)
SHAPES = (1.0, 3.0, 10.0)
FREQUENCIES = np.array([0.1, 0.3, 0.7, 1.2])  # Relative to the band edge of the mean chain.
CHAINS = 16
HARDLY = 0.5
NEARLY = 1.1


def main(quick: bool = False) -> list[Row]:
    """Return the row of the constant."""
    lengths, chains = ((100,), 500) if quick else ((100, 1000), 10_000)
    biases: dict[float, list[float]] = {share: [] for share in SHARES}
    scatters: dict[float, list[float]] = {share: [] for share in SHARES}
    for shape in SHAPES:
        ratios = gamma(shape, scale=1 / shape)
        frequency = 2 * FREQUENCIES
        states = dyson.integrated(frequency, shape, shape)
        growth = lyapunov(
            frequency, ratios=ratios, grains=100 * lengths[-1], chains=chains // 50, seed=1
        ).exponent
        for grains in lengths:
            many = chains * lengths[0] // grains
            for share in SHARES:
                with mock.patch.object(transfer_matrix, "WARM_UP", share):
                    modes = density_of_states(
                        frequency, ratios=ratios, grains=grains, chains=many, seed=2
                    )
                    found = lyapunov(frequency, ratios=ratios, grains=grains, chains=many, seed=2)
                for value, true, error in (
                    (modes.integrated, states, modes.error),
                    (found.exponent, growth, found.error),
                ):
                    of_few = error * math.sqrt(many / CHAINS)
                    biases[share] += ((value - true) / of_few).tolist()
                    scatters[share] += of_few.tolist()
    bias = {share: float(np.sqrt(np.mean(np.square(biases[share])))) for share in SHARES}
    wide = {share: float(np.exp(np.mean(np.log(scatters[share])))) for share in SHARES}
    least = min(wide.values())
    good = [share for share in SHARES if bias[share] < HARDLY and wide[share] < NEARLY * least]
    listed = ", ".join(
        f"{share:g}: {bias[share]:.2g}, {wide[share] / least:.2f}" for share in SHARES
    )
    says = f"what the top adds over the scatter, and that over the least, by share: {listed}"
    return [
        Row(
            "WARM_UP",
            WARM_UP,
            min(good, default=math.nan),
            min(good, default=1.0),
            max(good, default=0.0),
            says,
        )
    ]


if __name__ == "__main__":
    command(main, __doc__)
