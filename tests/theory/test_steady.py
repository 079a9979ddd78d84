"""Steady answers to a sinusoidal drive against dense linear systems of all bodies."""

from typing import Any

import numpy as np
import pytest

from lmpchain import Chain, Drive, Force, InputError, Law
from lmpchain.theory.steady import displacements, drive_stiffness

KINDS: dict[str, Any] = {
    "gravity": 0.0,
    "top_load": 2.0,
    "diameter": 1e-3 * np.array([1.0, 1.3, 0.9, 1.1]),
}
DAMPED = {"viscoelastic": [1e-8, 2e-8, 3e-8], "drag": [1e3, 3e3, 2e3, 5e3]}
GROUND = Law("s*u", s=[1e5, 0.0, 3e5, 2e5])


@pytest.mark.parametrize(("top", "bottom"), [("wall", "wall"), ("free", "fixed"), ("free", "wall")])
@pytest.mark.parametrize("ground", [{}, {"ground": GROUND}])
@pytest.mark.parametrize("damping", [{}, {"damping": DAMPED}])
def test_steady_answers_solve_the_equations_of_all_bodies(
    top: str, bottom: str, ground: dict[str, Any], damping: dict[str, Any]
) -> None:
    chain = Chain(grains=4, top=top, bottom=bottom, **damping, **ground, **KINDS)
    frequency = 0.4 * chain.band_edge / (2 * np.pi)
    w = 2 * np.pi * frequency
    springs = chain.contacts.stiffness * (1 + 1j * w * chain.contact_viscosity)
    matrix = np.zeros((6, 6), complex)
    for n, spring in enumerate(springs):
        matrix[n : n + 2, n : n + 2] += spring * np.array([[1, -1], [-1, 1]])
    by_hand = -chain.masses * w**2
    own = by_hand + 1j * w * chain.masses * chain.drag + chain.ground_stiffness
    sine = {"amplitude": 1e-9, "frequency": frequency}
    drives: list[Drive | Force] = [Drive(grain=int(top == "free"), **sine)]
    drives += [Force(grain=3, amplitude=1e-4, frequency=frequency)]
    drives += [Drive(end="bottom", **sine)] if not ground else []
    for drive in drives:
        body = 3 if isinstance(drive, Force) else drive.body(chain)
        # Neither drag nor the ground acts on a driven grain.
        inertia = own.copy()
        if isinstance(drive, Drive) and 1 <= body <= 4:
            inertia[body - 1] = by_hand[body - 1]
        whole = matrix + np.diag([0.0, *inertia, 0.0])
        u = np.zeros(6, complex)
        free = [n for n in range(1, chain.movable + 1) if n != body or isinstance(drive, Force)]
        push = np.zeros(6, complex)
        if isinstance(drive, Force):
            push[body] = 1e-4
        else:
            u[body] = 1e-9
        u[free] = np.linalg.solve(whole[np.ix_(free, free)], (push - whole @ u)[free])
        found = displacements(chain, drive)
        assert np.abs(found - u).max() < 1e-12 * np.abs(u).max()
        exact = 1e-4 / u[3] if isinstance(drive, Force) else (whole @ u)[body] / 1e-9
        assert abs(drive_stiffness(chain, drive) - exact) < 1e-11 * abs(exact)


def test_a_driven_grain_above_a_held_one_moves_alone() -> None:
    chain = Chain(grains=2, diameter=1e-3, top_load=1.0)
    base = Drive(end="bottom", amplitude=1e-9, frequency=1e3)
    still = Drive(amplitude=1e-9, frequency=1e3)
    assert abs(displacements(chain, base)[2]) == pytest.approx(1e-9, rel=1e-12)
    with pytest.raises(InputError, match="in time"):
        displacements(chain.replace(ground=Law("s*sin(t)*u", s=1.0)), still)
