"""Time of whole calls: making a scene, `simulate`, `simulate_many`, and another code's call.

The paper's column is struck with 1e-6 and 8.57e-4 m/s. The rows are those of `speed.md`, whose
header names the columns, and those of the README. Calls are made alternately, each with a scene of
its own; those with "auto" and `simulate_many` are timed afterwards. The least time of many calls
counts, and kernels are compiled beforehand. The other code is numbalsoda's DOP853 if it is
installed, else SciPy's. Its whole call makes the arrays of the chain, the right-hand side and the
solution at the samples, without an estimate of its error. It computes in microseconds and in the
speed of the strike, so that one absolute tolerance fits both displacements and velocities. Its
tolerance is the loosest whose true error is within ours. Its force is the plain one, or, where that
loses too many digits, one that keeps them.
"""

import argparse
import importlib.util
import time
from collections.abc import Callable, Mapping
from functools import partial

import numba
import numpy as np
from scipy.integrate import solve_ivp

import lmpchain

SPEEDS = {"1 µm/s": 1e-6, "0.857 mm/s": 8.57e-4}
TOLERANCES = (1e-3, 1e-6, 1e-9, 1e-12)
TOGETHER = 64  # Number of scenes of `simulate_many`.
UNIT = 1e-6  # Unit of time of the other code, s.
MOST_STEPS = 10**5  # Largest number of steps of the other code.
Solution = tuple[np.ndarray, np.ndarray]
# A function of the strike velocity and of the other code's tolerance.
Call = Callable[[float, float], Solution]


def paper(velocity: float, last_digits: int = 0) -> lmpchain.Scene:
    """Return the scene of the paper, or one that differs in the last digits of the strike."""
    chain = lmpchain.Chain(grains=120, diameter=1e-3)
    strike = lmpchain.Impulse(velocity=velocity * (1 + 1e-12 * last_digits))
    return lmpchain.Scene(chain=chain, excitation=strike, duration=100e-6)


@numba.njit(inline="always")
def plain(x: float) -> float:
    """Return ``(1 + x)^(3/2) - 1``."""
    return (1.0 + x) * np.sqrt(1.0 + x) - 1.0


@numba.njit(inline="always")
def exact(x: float) -> float:
    """Return ``(1 + x)^(3/2) - 1`` to full precision for small x."""
    return x * (3.0 + x * (3.0 + x)) / ((1.0 + x) * np.sqrt(1.0 + x) + 1.0)


def rate_of(law: Callable[[float], float]) -> Callable[..., None]:
    """Return the compiled right-hand side with this force."""

    @numba.njit(fastmath=True)
    def rate(y, dy, strength, length):  # type: ignore[no-untyped-def]
        grains = y.size // 2
        above = 0.0
        for n in range(grains):  # All grains except the last, which is fixed.
            below = y[n + 1] if n + 1 < grains else 0.0
            push = strength[n] * law(max((y[n] - below) * length[n], -1.0))
            dy[n] = y[grains + n]
            dy[grains + n] = above - push
            above = push

    return rate


def column(velocity: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the start of the paper's column, and F_n / m and 1 / eps_n of the contacts.

    Lengths are in units of `velocity` times `UNIT`, times in `UNIT`.
    """
    grains = 120
    d = 1e-3
    g = 9.81
    mass = 2426 * np.pi / 6 * d**3
    constant = 62e9 / (1 - 0.2**2) * np.sqrt(d) / 3
    force = mass * g * np.arange(1, grains)
    start = np.zeros(2 * (grains - 1))
    start[grains - 1] = 1.0
    return start, force / mass * UNIT / velocity, (constant / force) ** (2 / 3) * UNIT * velocity


def in_si(found: np.ndarray, velocity: float) -> Solution:
    """Convert states of the other code to displacements and velocities, m and m/s, (T, M) each."""
    grains = found.shape[1] // 2
    return found[:, :grains] * (velocity * UNIT), found[:, grains:] * velocity


def scipy_calls(law: Callable[[float], float]) -> Call:
    """Return a function that makes a whole call of SciPy's DOP853."""
    rate = rate_of(law)

    def call(velocity: float, tolerance: float) -> Solution:
        start, strength, length = column(velocity)
        dy = np.empty_like(start)

        def slope(_: float, y: np.ndarray) -> np.ndarray:
            rate(y, dy, strength, length)
            return dy.copy()

        times = np.linspace(0.0, 1e-4, 101) / UNIT
        limits = {"rtol": max(tolerance, 3e-14), "atol": tolerance}
        found = solve_ivp(slope, (0.0, times[-1]), start, method="DOP853", t_eval=times, **limits)
        return in_si(found.y.T, velocity)

    return call


def numbalsoda_calls(law: Callable[[float], float]) -> Call:
    """Return a function that makes a whole call of numbalsoda's DOP853."""
    from numbalsoda import dop853, lsoda_sig

    rate = rate_of(law)

    @numba.cfunc(lsoda_sig)
    def slope(t, y, dy, p):  # type: ignore[no-untyped-def]
        count = 119
        values = numba.carray(p, (2 * count,))
        rate(
            numba.carray(y, (2 * count,)),
            numba.carray(dy, (2 * count,)),
            values[:count],
            values[count:],
        )

    address = slope.address
    times = np.linspace(0.0, 1e-4, 101) / UNIT

    def call(velocity: float, tolerance: float) -> Solution:
        start, strength, length = column(velocity)
        limits = {"rtol": tolerance, "atol": tolerance, "mxstep": MOST_STEPS}
        found, _ = dop853(address, start, times, np.concatenate((strength, length)), **limits)
        return in_si(found, velocity)

    return call


def error(found: Solution, truth: lmpchain.Trajectory) -> float:
    """Return the largest error of displacement and velocity, relative to their largest."""
    pairs = zip(found, (truth.displacement[:, :-1], truth.velocity[:, :-1]), strict=True)
    return max(float(np.abs(x - y).max() / np.abs(y).max()) for x, y in pairs)


def loosest(call: Call, velocity: float, tolerance: float) -> float:
    """Return the peer's loosest tolerance that meets this one, by factors of two; else NaN."""
    truth = lmpchain.simulate(paper(velocity), "native", 2e-13)
    for power in range(12, -24, -1):
        asked = tolerance * 2.0**power
        if asked < 0.1 and error(call(velocity, asked), truth) <= tolerance:
            return asked
    return float("nan")


def least(calls: Mapping[str, Callable[[int], object]], repeats: int) -> dict[str, float]:
    """Return the least time of each call, ms; calls are made alternately."""
    found = dict.fromkeys(calls, float("inf"))
    for turn in range(repeats):
        for name, call in calls.items():
            began = time.perf_counter()
            call(turn)
            found[name] = min(found[name], 1e3 * (time.perf_counter() - began))
    return found


def simulate_together(scenes: list[lmpchain.Scene], tolerance: float, _: int) -> None:
    """Run scenes as a batch."""
    lmpchain.simulate_many(scenes, tolerance)


def main() -> None:
    """Print the rows of the page, and of the README."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--repeats", type=int, default=100)
    repeats = parser.parse_args().repeats
    there = importlib.util.find_spec("numbalsoda") is not None
    made, name = (numbalsoda_calls, "numbalsoda") if there else (scipy_calls, "scipy")
    peers = [made(law) for law in (plain, exact)]
    print(f"least of {repeats} calls, ms, as in speed.md; the other code is {name}\n")
    calls_us: dict[tuple[str, float], tuple[float, float]] = {}
    for strike, velocity in SPEEDS.items():
        for tolerance in TOLERANCES:
            able = ((peer, loosest(peer, velocity, tolerance)) for peer in peers)
            # The plain force is used if it is accurate enough.
            peer, asked = next(pair for pair in able if pair[1] > 0)
            inside: dict[str, list[float]] = {"native": [], "auto": []}

            def answer(
                engine: str, turn: int, velocity: float = velocity, tolerance: float = tolerance
            ) -> None:
                cost = lmpchain.simulate(paper(velocity, turn), engine, tolerance).cost
                inside[engine].append(1e3 * (cost.integration_s + cost.estimate_s))  # noqa: B023

            calls: dict[str, Callable[[int], object]] = {
                "scene": lambda turn, velocity=velocity: paper(velocity, turn),
                "native": partial(answer, "native"),
                "peer": lambda _, velocity=velocity, asked=asked, peer=peer: peer(velocity, asked),
            }
            for call in calls.values():
                call(0)
            took = least(calls, repeats) | least({"auto": partial(answer, "auto")}, repeats)
            several = [paper(velocity, turn) for turn in range(TOGETHER)]
            together = partial(simulate_together, several, tolerance)
            many = least({"many": together}, 5)["many"] / TOGETHER
            alone, auto = (took[engine] - took["scene"] for engine in inside)
            adds = alone - min(inside["native"]), auto - min(inside["auto"])
            numbers = took["scene"], alone, *adds, many, took["peer"]
            cells = [
                f"{strike}, {tolerance:.0e}" if tolerance == TOLERANCES[0] else f"{tolerance:.0e}",
                *(f"{number:.3f}" for number in numbers),
                f"{took['peer'] / took['native']:.1f}",
            ]
            print(f"| {' | '.join(cells)} |".replace("e-0", "e-"), flush=True)
            whole = round(took["scene"], 3) + round(alone, 3)
            calls_us[strike, tolerance] = 1e3 * whole, 1e3 * round(took["peer"], 3)
    print("\nthe rows of the README, us\n")
    for label, digits, which in (
        ("a whole call: the scene, its 101 samples and their estimate", 2, 0),
        (f"a whole call of {name}, without an estimate", 3, 1),
    ):
        values = [calls_us["0.857 mm/s", tolerance][which] for tolerance in TOLERANCES]
        print("|", label, "|", " | ".join(f"{float(f'{v:.{digits}g}'):,.0f}" for v in values), "|")


if __name__ == "__main__":
    main()
