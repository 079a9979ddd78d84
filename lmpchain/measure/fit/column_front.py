"""Front of a struck column before the echo from below."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ...chain.chain import Chain
from ...errors import InputError
from ...theory.domain import chi
from ...trajectory.trajectory import Trajectory
from ..front import Front, track
from ..recorded import Field

# Least drop behind a front, relative to the largest motion, if the trajectory error is unknown.
QUIET = 1e-6


def front_before_echo(
    trajectory: Trajectory, field: Field, first: int, last: int | None = None
) -> Front:
    """Track the front down to the grains that an echo reaches."""
    estimate = trajectory.error_estimate
    chain = trajectory.scene.chain
    if not np.isfinite(estimate.solver):
        trajectory = replace(trajectory, error_estimate=replace(estimate, solver=QUIET))
    if last is None:
        # Some widths of the front, in grains.
        last = int(chain.grains - 3 - 2.5 * np.cbrt(chain.grains))
    return track(trajectory, field).between(first, last)


def bottom(grains: int, delta: float) -> tuple[float, float]:
    """Return the arrival time of the front at the bottom and its width there, in units of tau."""
    power = 1.5 / delta - 0.5
    depth = grains - 0.5
    return float(chi(depth, delta)), float(np.cbrt(depth**power / (8 * power)))


def is_uniform(chain: Chain) -> bool:
    """Return whether the grains of a chain (two or more) and its contacts are equal."""
    return all(
        np.ptp(values) <= 1e-9 * values[0] for values in (chain.masses, chain.contact_constants)
    )


def strike_at_top(trajectory: Trajectory) -> float:
    """Return the velocity of the strike, m/s; raise `InputError` for any other scene."""
    scene = trajectory.scene
    chain = scene.chain
    excitation = scene.excitation
    faults = []
    if not chain.gravity or chain.top_load:
        faults.append(("gravity", "takes a column under gravity alone, without a top load"))
    if chain.top != "free":
        faults.append(("top", "takes a free top, not a wall"))
    if chain.law.power_of("the front of a column") >= 3:
        faults.append(
            ("exponent", "takes one below 3: from there on waves are dispersed at the top")
        )
    if chain.grains == 1:
        faults.append(("grains", "takes several: a single one has no wave"))
    elif not is_uniform(chain):
        faults.append(("material", "takes equal grains, as the column of the paper has"))
    if not excitation.strikes_top or not scene.strike_velocity:
        faults.append(("excitation", "takes a strike on grain 1: an impulse other than 0"))
    if faults:
        raise InputError(faults)
    return scene.strike_velocity
