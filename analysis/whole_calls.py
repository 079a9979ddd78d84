"""What a whole call takes: making a scene, `simulate`, `simulate_many`, and a peer's whole call on the same scene.

The paper's column is struck with 1e-6 (weak) and 8.57e-4 m/s (strong). Calls are interleaved, each with a scene of its
own, and the least of many counts; kernels are compiled beforehand. The peer is numbalsoda's DOP853 if it is installed,
else SciPy's: its whole call makes the arrays of the chain, the right-hand side and the solution at the samples, without
an estimate of its error; its tolerances are the loosest whose true error is within the tolerance.
"""

import argparse
import importlib.util
import time
from collections.abc import Callable, Mapping

import numba
import numpy as np
from scipy.integrate import solve_ivp

import lmpchain

SPEEDS = {"weak": 1e-6, "strong": 8.57e-4}
TOLERANCES = (1e-3, 1e-6, 1e-9, 1e-12)
TOGETHER = 64  # scenes of `simulate_many`
Solution = tuple[np.ndarray, np.ndarray]


def paper(velocity: float, last_digits: int = 0) -> lmpchain.Scene:
    """Return the scene of the paper, or one that differs from it in the last digits of the strike."""
    chain = lmpchain.Chain(grains=120, diameter=1e-3)
    strike = lmpchain.Impulse(velocity=velocity * (1 + 1e-12 * last_digits))
    return lmpchain.Scene(chain=chain, excitation=strike, duration=100e-6)


@numba.njit(cache=True, fastmath=True)
def rate(y: np.ndarray, dy: np.ndarray, strength: np.ndarray, length: np.ndarray) -> None:
    """Fill the derivative of displacements and velocities of all grains but the last, which is held."""
    grains = y.size // 2
    above = 0.0
    for n in range(grains):
        below = y[n + 1] if n + 1 < grains else 0.0
        s = max(1.0 + (y[n] - below) * length[n], 0.0)
        push = strength[n] * (s * np.sqrt(s) - 1.0)
        dy[n] = y[grains + n]
        dy[grains + n] = above - push
        above = push


def column(velocity: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the start of the paper's column, and F_n / m and 1 / eps_n of the contacts below its grains."""
    grains, d, g = 120, 1e-3, 9.81
    mass = 2426 * np.pi / 6 * d**3
    constant = 62e9 / (1 - 0.2**2) * np.sqrt(d) / 3
    force = mass * g * np.arange(1, grains)
    start = np.zeros(2 * (grains - 1))
    start[grains - 1] = velocity
    return start, force / mass, (constant / force) ** (2 / 3)


def scipy_call(velocity: float, tolerance: float) -> Solution:
    """Solve with SciPy's DOP853 from nothing."""
    start, strength, length = column(velocity)
    dy = np.empty_like(start)

    def slope(_: float, y: np.ndarray) -> np.ndarray:
        rate(y, dy, strength, length)
        return dy.copy()

    scale = np.repeat([velocity * 1e-6, velocity], start.size // 2)
    limits = {"rtol": max(tolerance, 3e-14), "atol": tolerance * scale}
    times = np.linspace(0.0, 1e-4, 101)
    found = solve_ivp(slope, (0.0, 1e-4), start, method="DOP853", t_eval=times, **limits)
    return found.y[: start.size // 2].T, found.y[start.size // 2 :].T


def numbalsoda_calls() -> Callable[[float, float], Solution]:
    """Return a whole call of numbalsoda's DOP853."""
    from numbalsoda import dop853, lsoda_sig

    @numba.cfunc(lsoda_sig)
    def slope(t, y, dy, p):  # type: ignore[no-untyped-def]
        count = 119
        values = numba.carray(p, (2 * count,))
        rate(numba.carray(y, (2 * count,)), numba.carray(dy, (2 * count,)), values[:count], values[count:])

    address, times = slope.address, np.linspace(0.0, 1e-4, 101)

    def call(velocity: float, tolerance: float) -> Solution:
        start, strength, length = column(velocity)
        atol = tolerance * velocity * 1e-6  # one number for all
        found, _ = dop853(address, start, times, np.concatenate((strength, length)), rtol=tolerance, atol=atol)
        return found[:, : start.size // 2], found[:, start.size // 2 :]

    return call


def error(found: Solution, truth: lmpchain.Trajectory) -> float:
    """Return the largest error of displacement and velocity, relative to their largest."""
    pairs = zip(found, (truth.displacement[:, :-1], truth.velocity[:, :-1]), strict=True)
    return max(float(np.abs(x - y).max() / np.abs(y).max()) for x, y in pairs)


def loosest(call: Callable[[float, float], Solution], velocity: float, tolerance: float) -> float:
    """Return the loosest tolerance of the peer, in factors of two, that meets this one; NaN if none does."""
    truth = lmpchain.simulate(paper(velocity), "native", 2e-13)
    for power in range(12, -24, -1):
        asked = tolerance * 2.0**power
        if asked < 0.1 and error(call(velocity, asked), truth) <= tolerance:
            return asked
    return float("nan")


def least(calls: Mapping[str, Callable[[int], object]], repeats: int) -> dict[str, float]:
    """Return the least time of each call, ms; they take turns."""
    found = dict.fromkeys(calls, float("inf"))
    for turn in range(repeats):
        for name, call in calls.items():
            began = time.perf_counter()
            call(turn)
            found[name] = min(found[name], 1e3 * (time.perf_counter() - began))
    return found


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--repeats", type=int, default=100)
    repeats = parser.parse_args().repeats
    there = importlib.util.find_spec("numbalsoda") is not None
    peer, name = (numbalsoda_calls(), "numbalsoda") if there else (scipy_call, "scipy")
    print(f"least of {repeats} calls, ms; over: {name}'s whole call over making the scene and simulate together")
    print(f"{'':8}{'tolerance':>10}{'scene':>8}{'simulate':>10}{'adds':>8}{'many':>8}{name:>12}{'over':>7}")
    for strike, velocity in SPEEDS.items():
        for tolerance in TOLERANCES:
            asked = loosest(peer, velocity, tolerance)
            inside: list[float] = []

            def answer(turn: int, velocity: float = velocity, tolerance: float = tolerance) -> None:
                cost = lmpchain.simulate(paper(velocity, turn), "native", tolerance).cost
                inside.append(1e3 * (cost.integration_s + cost.estimate_s))  # noqa: B023

            calls = {
                "scene": lambda turn, velocity=velocity: paper(velocity, turn),
                "both": answer,
                "peer": lambda _, velocity=velocity, asked=asked: peer(velocity, asked),
            }
            for call in calls.values():
                call(0)
            inside.clear()
            took = least(calls, repeats)
            several = [paper(velocity, turn) for turn in range(TOGETHER)]
            many = least({"many": lambda _: lmpchain.simulate_many(several, tolerance)}, 5)["many"] / TOGETHER  # noqa: B023
            alone = took["both"] - took["scene"]
            print(
                f"{strike:8}{tolerance:10.0e}{took['scene']:8.3f}{alone:10.3f}{alone - min(inside):8.3f}{many:8.3f}"
                f"{took['peer']:12.3f}{took['peer'] / took['both']:7.2f}",
                flush=True,
            )


if __name__ == "__main__":
    main()
