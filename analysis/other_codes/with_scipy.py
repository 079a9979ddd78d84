"""SciPy's DOP853 with a compiled right-hand side: `solve_ivp` steps in Python, `ode` in C."""

from __future__ import annotations

from functools import partial
from time import perf_counter

import numba
import numpy as np
import scipy
from problem import TOLERANCES, Answer, Code, Problem, fill_rate
from scipy.integrate import ode, solve_ivp

from lmpchain import RunFailed

LEAST = 2.3e-14  # Relative tolerance below which solve_ivp warns and uses this value.


@numba.njit
def _rate(t, y, table):
    rate = np.empty_like(y)
    fill_rate(y, rate, table)
    return rate


def _solve_ivp(y, table, end, tolerance):
    rtol = max(tolerance, LEAST)
    solution = solve_ivp(
        _rate, (0, end), y, method="DOP853", rtol=rtol, atol=tolerance, args=(table,)
    )
    return solution.y[:, -1], solution.success


def _ode(y, table, end, tolerance):
    solver = ode(_rate).set_integrator("dop853", rtol=tolerance, atol=tolerance, nsteps=10**7)
    return solver.set_initial_value(y).set_f_params(table).integrate(end), solver.successful()


def _solve(run, problem: Problem, tolerance: float) -> Answer:
    table = problem.table()
    y = problem.start
    _rate(0.0, y, table)  # This call compiles.
    table[1] = 0
    begin = perf_counter()
    state, success = run(y, table, problem.duration, tolerance)
    seconds = perf_counter() - begin
    if not success:
        raise RunFailed("SciPy gave up")
    return problem.answer(state, seconds, int(table[1]))


def codes(problem: Problem) -> list[Code]:
    """Return both interfaces as codes."""
    both = {"solve_ivp": _solve_ivp, "ode": _ode}
    return [Code(f"SciPy {name} DOP853", scipy.__version__, TOLERANCES, partial(_solve, run))
            for name, run in both.items()]  # fmt: skip
