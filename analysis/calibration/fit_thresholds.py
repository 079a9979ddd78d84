"""Measure the thresholds of fits for solitary waves, SOLITARY, and weak strikes, WEAK_STRIKE.

Exact solitary waves of several exponents and speeds, under a load and without, run through uniform
chains, recorded at few and many samples; so do strikes of loaded chains that are too weak to make
one. SOLITARY is supported, for the scatter of the height and for the errors of speed and width,
from the largest values that a solitary wave has to the smallest of what is none (the larger of
them: one is enough to tell). WEAK_STRIKE: the strike number at which linear theory errs by a
hundredth in the largest velocity at a grain, from the first to the deepest.

    python analysis/calibration/fit_thresholds.py           # a minute
    python analysis/calibration/fit_thresholds.py --quick   # seconds
"""

from __future__ import annotations

from unittest import mock

import numpy as np
from common import Row, command

from lmpchain import Chain, Impulse, LmpchainError, Scene, Trajectory, simulate
from lmpchain.measure.fit import solitary
from lmpchain.measure.fit.overview import WEAK_STRIKE
from lmpchain.measure.fit.solitary import SOLITARY
from lmpchain.theory import soliton

# Number of grains, and the grains on which the wave is centred at the start and at the end.
GRAINS = 80
START = 20.0
END = 60.0
TOO_LITTLE = 0.01  # Relative error of peak velocities.
DEPTHS = slice(1, 60)


def told(trajectory: Trajectory) -> tuple[float, float] | None:
    """Return the scatter of the height, and the deviations of speed and width from the exact wave.

    None if nothing passes.
    """
    with mock.patch.object(solitary, "SOLITARY", np.inf):
        try:
            fit = solitary.fit_soliton(trajectory)
        except LmpchainError:
            return None
    apart = np.abs(np.array([fit.speed, fit.width]) / fit.expected[1:] - 1).max()
    return float(np.ptp(fit.velocity) / fit.amplitude), float(apart)


def solitary_waves(quick: bool) -> list[tuple[float, float]]:
    """Return the fits of exact solitary waves."""
    found = []
    for exponent in (1.5,) if quick else (1.3, 1.5, 2.0, 3.0):
        for speed in (0.0, 1.3) if quick else (0.0, 1.1, 1.3, 2.0, 4.0):
            chain = Chain(
                grains=GRAINS,
                diameter=1e-3,
                gravity=0.0,
                exponent=exponent,
                top_load=1e-3 if speed else 0.0,
            )
            size: dict[str, float] = {"speed": speed} if speed else {"velocity": 0.01}
            wave = soliton.solve(exponent, **size)
            profile = wave.on(chain, START)
            sound = np.sqrt(chain.linear_stiffness[0] / chain.masses[0]) if speed else 1.0
            pace = (
                wave.speed * sound
                if speed
                else float(soliton.nesterenko_speed(0.01, exponent)) * _unit(chain)
            )
            for samples in (81, 641):
                duration = (END - START) / pace
                scene = Scene(chain=chain, excitation=profile, duration=duration, samples=samples)
                if one := told(simulate(scene, "native", 1e-8)):
                    found.append(one)
    return found


def _unit(chain: Chain) -> float:
    """Return the unit of speed in the sonic vacuum, grains/s."""
    delta = chain.exponent
    rate = chain.contact_constants[0] / chain.masses[0]
    return float(rate ** (1 / (delta + 1)))


def other_waves(quick: bool) -> list[float]:
    """Return the excess over the larger threshold of strikes without a solitary wave."""
    found = []
    for number in (0.01, 0.3) if quick else (0.01, 0.03, 0.1, 0.3, 1.0):
        for load in (1e-3,) if quick else (1e-3, 1.0):
            chain = Chain(grains=GRAINS, diameter=1e-3, gravity=0.0, top_load=load)
            omega = float(np.sqrt(chain.linear_stiffness[0] / chain.masses[0]))
            strike = Impulse(velocity=number * chain.equilibrium_overlap[0] * omega)
            scene = Scene(
                chain=chain, excitation=strike, duration=GRAINS * 0.8 / omega, samples=641
            )
            if one := told(simulate(scene, "native", 1e-8)):
                found.append(max(one))
    return found


def weak(quick: bool) -> Row:
    """Return the row of WEAK_STRIKE."""
    chain = Chain(grains=120, diameter=1e-3)
    errors = {}
    for number in np.geomspace(0.05, 2.0, 5 if quick else 17):
        strike = Impulse(velocity=float(number) * chain.length_scale / chain.time_scale)
        scene = Scene(chain=chain, excitation=strike, duration=2e-4, samples=2001)
        true, linear = (
            np.abs(simulate(scene, e, 0.99).velocity).max(0)[DEPTHS]
            for e in ("native", "chebyshev")
        )
        errors[float(number)] = np.abs(linear / true - 1)
    numbers = np.log(list(errors))
    places = [
        np.exp(np.interp(np.log(TOO_LITTLE), np.log(each), numbers))
        for each in np.array(list(errors.values())).T
    ]
    says = (
        "strike number at which a peak velocity is off by 1 %: median, least and most of "
        f"{len(places)} depths"
    )
    return Row(
        "WEAK_STRIKE",
        WEAK_STRIKE,
        float(np.median(places)),
        float(min(places)),
        float(max(places)),
        says,
    )


def main(quick: bool = False) -> list[Row]:
    """Return a row for each constant."""
    waves = solitary_waves(quick)
    others = other_waves(quick)
    rows = []
    for name, column in (("SOLITARY (height)", 0), ("SOLITARY (speed, width)", 1)):
        low = max(one[column] for one in waves)
        says = (
            f"most of {len(waves)} solitary waves; of {len(others)} other waves the larger of the "
            "two is more"
        )
        rows.append(Row(name, SOLITARY, low, low, min(others, default=np.inf), says))
    return [*rows, weak(quick)]


if __name__ == "__main__":
    command(main, __doc__)
