"""A conservative finite-volume solver of Eq. (27), public as `lmpchain.theory.continuum.solve`."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from ..util.arrays import Array
from .domain import exponents, real, require, whole


@dataclass(frozen=True, eq=False)
class Field:
    """The solution of `solve` at the grains.

    Attributes
    ----------
    tau : (T,) array
        Times.
    h : (N,) array
        Depth n - 1/2 of grain n.
    displacement : (T, N) array
        Displacements phi of the grains.
    velocity : (T, N) array
        Velocities dphi/dtau of the grains.
    """

    tau: Array
    h: Array
    displacement: Array
    velocity: Array


def solve(
    tau: ArrayLike,
    grains: int,
    displacement: Callable[[Array], ArrayLike] | None = None,
    velocity: Callable[[Array], ArrayLike] | None = None,
    drive: Callable[[float], tuple[float, float]] | None = None,
    delta: float = 1.5,
    cells: int = 3,
) -> Field:
    """Solve Eq. (27), phi_tautau = (h^xi phi_h)_h, for a column of N grains with grain N fixed.

    No flux passes the free top h = 0, so momentum is conserved up to rounding errors; phi is 0 at
    h = N - 1/2. The flux through a face at f between the cell centres a and b is
    ``eta f (phi_b - phi_a) / (b^eta - a^eta)``. It is exact for the term h^eta with which regular
    solutions begin at the top, where the factor h^xi would be less accurate. Time is integrated by
    velocity Verlet at 0.9 of the stability limit. The error is of second order in the width of the
    cells, 1/cells.

    Parameters
    ----------
    tau : (T,) array_like
        Times, ascending and not negative.
    grains : int
        Number of grains N.
    displacement : callable, optional
        Function phi(h) at tau = 0 of an array of depths; by default 0.
    velocity : callable, optional
        Function dphi/dtau(h) at tau = 0 of an array of depths; by default 0. ``lambda h: h < 1``
        is the velocity after a unit impulse on grain 1.
    drive : callable, optional
        Function of tau that returns the prescribed phi and dphi/dtau of grain 1, at h = 1/2.
    delta : float
        Exponent of the contact force.
    cells : int
        Number of cells per grain, odd.

    Returns
    -------
    Field
        The solution at the grains.

    Raises
    ------
    InputError
        If an argument is outside its domain.

    Examples
    --------
    >>> field = solve([0.0, 20.0], 60, velocity=lambda h: h < 1)
    >>> f"{field.displacement[1, 0]:.3f}"  # C tau^(-1/5) is 0.634
    '0.635'
    """
    tau = real(tau, "tau")
    grains = int(whole("grains", grains, 2))
    cells = int(whole("cells", cells, 1))
    ascending = tau.ndim == 1 and tau.size and tau[0] >= 0 and (np.diff(tau) >= 0).all()
    require(
        ("tau", ascending, "must be a list that ascends from 0 or more"),
        ("tau", np.isfinite(tau), "must be finite"),
        ("cells", cells % 2, "must be odd"),
    )
    eta = exponents(delta).eta
    width = 1 / cells
    middle = cells // 2
    # The next cell is centred on grain N and fixed.
    moving = (grains - 1) * cells + middle
    centre = real(np.arange(moving + 1) + 0.5) * width
    face = np.arange(1, moving + 1) * width
    # Flux divided by phi_b - phi_a, for a cell of this width.
    rate = eta * face / np.diff(centre**eta) / width
    # Gershgorin's bound on the frequencies, and the limit omega h = 2 of velocity Verlet.
    longest = 0.9 * 2 / np.sqrt(2 * (rate[:-1] + rate[1:]).max(initial=rate[0]))

    def begin(key: str, start: Callable[[Array], ArrayLike] | None) -> Array:
        if start is None:
            return np.zeros(moving)
        values = start(centre[:-1])
        if np.asarray(values).dtype == bool:
            # A condition on the depth has the value 1 where it is true.
            values = np.asarray(values, float)
        return np.broadcast_to(real(values, key), moving).copy()

    phi = begin("displacement", displacement)
    speed = begin("velocity", velocity)
    record = np.zeros((2, tau.size, grains))

    def hold(time: float) -> None:
        if drive is not None:
            phi[middle], speed[middle] = drive(time)

    def push() -> Array:
        return np.diff(rate * np.diff(phi, append=0.0), prepend=0.0)

    start = 0.0
    hold(start)
    pull = push()
    for sample, end in enumerate(tau):
        steps = int(np.ceil((end - start) / longest))
        step = (end - start) / max(steps, 1)
        for i in range(1, steps + 1):
            speed += step / 2 * pull
            phi += step * speed
            hold(start + i * step)
            pull = push()
            speed += step / 2 * pull
        hold(end)
        record[:, sample, :-1] = phi[middle::cells], speed[middle::cells]
        start = end
    return Field(tau, real(np.arange(grains) + 0.5), *record)
