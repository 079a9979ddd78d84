"""numbalsoda: Hairer's DOP853 and LSODA in compiled code, called from compiled code."""

from __future__ import annotations

from functools import partial
from importlib.metadata import version
from time import perf_counter

import numba
import numpy as np
from numbalsoda import dop853, lsoda, lsoda_sig
from problem import TOLERANCES, Answer, Code, Problem, fill_rate

from lmpchain import RunFailed

MOST_STEPS = 10**7
LSODA_GRAINS = 1000  # LSODA always allocates a dense 2 M x 2 M matrix.
LSODA_LEAST = 3e-14  # Smallest tolerance at which LSODA does not fail.


@numba.cfunc(lsoda_sig)
def _rate(t, y, rate, table):
    moving = int(table[0])
    size = 2 * moving
    fill_rate(
        numba.carray(y, (size,)),
        numba.carray(rate, (size,)),
        numba.carray(table, (2 + 3 * moving,)),
    )


RATE = _rate.address


@numba.njit
def _dop853(y, table, end, tolerance):
    return dop853(RATE, y, np.array([0.0, end]), table, tolerance, tolerance, MOST_STEPS)


@numba.njit
def _lsoda(y, table, end, tolerance):
    return lsoda(RATE, y, np.array([0.0, end]), table, tolerance, tolerance, MOST_STEPS)


def _solve(run, problem: Problem, tolerance: float) -> Answer:
    table = problem.table()
    y = problem.start
    run(np.zeros(2), np.array([1.0, 0.0, 1.0, 1.0, 0.0]), 0.01, 0.1)  # One grain, to compile only.
    begin = perf_counter()
    states, success = run(y, table, problem.duration, tolerance)
    seconds = perf_counter() - begin
    if not success:
        raise RunFailed("numbalsoda gave up")
    return problem.answer(states[-1], seconds, int(table[1]))


def codes(problem: Problem) -> list[Code]:
    """Return both integrators.

    `numbalsoda.solve_ivp` runs the same DOP853 but keeps every step: it was slower than `dop853` in
    short chains and than SciPy's `ode` in long ones.
    """
    codes = [Code("numbalsoda DOP853", version("numbalsoda"), TOLERANCES, partial(_solve, _dop853))]
    if problem.scene.chain.grains <= LSODA_GRAINS:
        tight = [tolerance for tolerance in TOLERANCES if tolerance > LSODA_LEAST]
        codes.append(
            Code("numbalsoda LSODA", version("numbalsoda"), tight, partial(_solve, _lsoda))
        )
    return codes
