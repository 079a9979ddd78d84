"""Steady response of a linear chain to a sinusoidal drive, with or without damping."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_banded

from ..chain.chain import Chain
from ..scene.acting import Drive, Force
from ..util.lazy import listed

__dir__ = listed(__name__)


def dynamic_stiffness(chain: Chain, omega: float) -> NDArray[np.complex128]:
    """Return ``K (1 + i w A)`` of all contacts, walls included, at one frequency.

    Parameters
    ----------
    chain : Chain
        A compressed chain.
    omega : float
        Frequency w, rad/s.

    Returns
    -------
    (N+1,) complex array
        Dynamic stiffness of every contact, N/m.

    Examples
    --------
    >>> lossy = {"viscoelastic": 1e-6}
    >>> chain = Chain(grains=3, diameter=1e-3, gravity=0.0, top_load=1.0, damping=lossy)
    >>> k = dynamic_stiffness(chain, 1e5)[1]
    >>> round(float(k.imag / k.real), 12)
    0.1
    """
    return chain.contacts.stiffness * (1 + 1j * omega * chain.contact_viscosity)


def displacements(chain: Chain, drive: Drive | Force) -> NDArray[np.complex128]:
    """Return the amplitudes u of the response ``Im(u exp(i w t))`` of the linearised chain.

    The amplitudes solve ``(K (1 + i w A) - m w^2 + i w gamma m) u = f``, with the times A and the
    rates gamma of `Damping`.

    Parameters
    ----------
    chain : Chain
        A compressed chain.
    drive : Drive or Force
        A sinusoidal motion or force, with its amplitude and frequency.

    Returns
    -------
    (N+2,) complex array
        Amplitudes of the top wall, the grains and the bottom wall, m.

    Examples
    --------
    >>> chain = Chain(grains=3, diameter=1e-3, gravity=0.0, top_load=1.0)
    >>> answer = displacements(chain, Drive(amplitude=1e-9, frequency=1e3))
    >>> abs(answer).round(12).tolist()
    [0.0, 1e-09, 5e-10, 0.0, 0.0]
    """
    chain.refuse_ground_without_modes("the steady answer")
    omega = 2 * np.pi * drive.frequency
    stiffness = dynamic_stiffness(chain, omega)
    answer = np.zeros(chain.grains + 2, complex)
    if isinstance(drive, Drive):
        answer[drive.body(chain)] = drive.amplitude
    free = np.arange(drive.driven, chain.movable)
    if not free.size:
        return answer
    inertia = chain.masses[free] * (omega**2 - 1j * omega * chain.drag[free])
    bands = np.zeros((3, free.size), complex)
    bands[1] = stiffness[free] + stiffness[free + 1] + chain.ground_stiffness[free] - inertia
    bands[0, 1:] = -stiffness[free[1:]]
    bands[2, :-1] = bands[0, 1:]
    pull = np.zeros(free.size, complex)
    if isinstance(drive, Force):
        pull[drive.grain - 1] = drive.amplitude
    elif drive.from_below:
        pull[-1] = stiffness[chain.movable] * drive.amplitude
    else:
        pull[0] = stiffness[free[0]] * drive.amplitude
    answer[free + 1] = solve_banded((1, 1), bands, pull)
    return answer


def drive_stiffness(chain: Chain, drive: Drive | Force) -> complex:
    """Return the dynamic stiffness of the linearised chain at the driven body, N/m.

    It is the external force over the displacement of the body, including the inertia of a driven
    grain. Divided by ``-w^2`` it is the apparent mass, and divided by ``i w`` the impedance.

    Parameters
    ----------
    chain : Chain
        A compressed chain.
    drive : Drive or Force
        A sinusoidal motion or force, with its amplitude and frequency.

    Returns
    -------
    complex
        Dynamic stiffness, N/m.

    Examples
    --------
    >>> lossy = {"viscoelastic": 1e-6}
    >>> chain = Chain(grains=4, diameter=1e-2, bottom="wall", damping=lossy)
    >>> slow = drive_stiffness(chain, Drive(end="bottom", amplitude=1e-9, frequency=1.0))
    >>> f"{-slow.real / (2 * np.pi) ** 2 / chain.masses.sum():.6f} of the mass"
    '1.000000 of the mass'
    """
    u = displacements(chain, drive)
    if isinstance(drive, Force):
        return complex(drive.amplitude / u[drive.grain])
    assert drive.frequency is not None
    omega = 2 * np.pi * drive.frequency
    # Contact n has the index n + 1. There is none above the top wall and below the bottom wall.
    force = np.pad(dynamic_stiffness(chain, omega) * (u[:-1] - u[1:]), 1)
    body = drive.body(chain)
    mass = chain.masses[body - 1] if 1 <= body <= chain.grains else 0.0
    pull = force[body + 1] - force[body] - mass * omega**2 * u[body]
    return complex(pull / drive.amplitude)
