"""A delay line: bead diameters that delay a pulse by a given time with little loss.

A soft push travels down steel beads under a load. Of 20 beads in the middle each may have 0.8 to
1.8 times the diameter of the others; the delay wanted is 10 times what a pulse takes from bead to
bead. Long waves take sqrt(m / k) for each bead, which says how large equal beads would have to be:
these delay, but reflect. Random search has as many seconds of the processor, and only tries pieces
that delay long waves by the time wanted.
"""

import sys
import time
from pathlib import Path

import numpy as np
from scipy.optimize import brentq

sys.path.insert(0, str(Path(__file__).parents[1]))
from figures import arguments, finish, one_above_two, random_search, say

from lmpchain import Chain, Force, Scene
from lmpchain.design import ArrivalTime, PeakForce, Seen, Slopes, optimise
from lmpchain.design.gradients import looks_of
from lmpchain.design.parameters import changed
from lmpchain.integrators.adjoint import DifferentiableRun
from lmpchain.integrators.methods import SPLITTINGS

BEADS = 100
PIECE = slice(25, 45)
END = 60
SIZE = 1e-2
LOAD = 100.0
DELAY = 10.0
CHAIN = Chain(
    grains=BEADS,
    diameter=np.full(BEADS, SIZE),
    material="steel",
    gravity=0.0,
    top_load=LOAD,
    bottom="wall",
)
# Travel time of a long wave from bead to bead, s.
UNIT = float(np.sqrt(CHAIN.masses[0] / CHAIN.linear_stiffness[0]))
SCENE = Scene(
    chain=CHAIN,
    excitation=Force(grain=1, shape="half-sine", amplitude=2.0, duration=20 * UNIT),
    duration=105 * UNIT,
    samples=106,
)
LOW = np.full(BEADS, SIZE)
HIGH = np.full(BEADS, SIZE)
LOW[PIECE] = 0.8 * SIZE
HIGH[PIECE] = 1.8 * SIZE
PRECISION = 0.1  # Error of the delay, in UNIT, with the same weight as the whole peak.


class Late:
    """The squared relative error of the delay plus the squared relative loss of the peak."""

    dense = True

    def __init__(self, arrival: ArrivalTime, peak: PeakForce, at: float, rise: float):
        self.arrival = arrival
        self.peak = peak
        self.at = at
        self.rise = rise

    def grains(self, scene: Scene) -> list[int]:
        """Return the grains of both objectives."""
        return sorted({*self.arrival.grains(scene), *self.peak.grains(scene)})

    def __call__(self, seen: Seen) -> Slopes:
        """Return the sum and its derivatives."""
        late = self.arrival(seen)
        peak = self.peak(seen)
        off = (late.value - self.at) / (PRECISION * UNIT)
        lost = 1 - (peak.value - LOAD) / self.rise
        by_late = 2 * off / (PRECISION * UNIT)
        by_peak = -2 * lost / self.rise
        parts = (by_late * a + by_peak * b for a, b in zip(late[1:], peak[1:], strict=True))
        return Slopes(off**2 + lost**2, *parts)


def seen_at_the_end(scene: Scene) -> Seen:
    """Return the motion of the beads at the end."""
    looks = looks_of(scene, PeakForce(END))
    run = DifferentiableRun(
        scene, SPLITTINGS["rkn4"], 1.0 / scene.highest_frequency, looks, np.array([END, END + 1])
    )
    return Seen(scene, run.time, run.grains, run.displacement, run.velocity)


def delay_of_long_waves(diameters: np.ndarray) -> float:
    """Return the additional travel time of long waves over that in equal beads, in UNIT."""
    made = CHAIN.replace(diameter=diameters)
    # Each bead has half a contact on either side.
    stiffness = 2 / (1 / made.linear_stiffness[:-1] + 1 / made.linear_stiffness[1:])
    return float((np.sqrt(made.masses[1:-1] / stiffness) / UNIT - 1).sum())


def of_delay(shape: np.ndarray) -> np.ndarray:
    """Return diameters, scaled by a factor, with this delay of long waves; raise if impossible."""

    def with_factor(factor: float) -> np.ndarray:
        diameters = np.full(BEADS, SIZE)
        diameters[PIECE] = np.clip(factor * shape, 0.8, 1.8) * SIZE
        return diameters

    return with_factor(
        brentq(lambda factor: delay_of_long_waves(with_factor(factor)) - DELAY, 0.5, 3.0)
    )


def main() -> None:
    """Search with both methods, and draw the pulses, the beads and the search."""
    given = arguments(__file__, __doc__)
    starts, runs = (1, 40) if given.quick else (6, 200)
    plain = seen_at_the_end(SCENE)
    threshold = ArrivalTime(END, 0.5 * float(plain.velocity[:, 0].max()))
    peak = PeakForce(END, sharpness=1e4)  # The peak of a pulse of 2 N in addition to the load.
    begin = threshold(plain).value
    rise = peak(plain).value - LOAD
    wanted = Late(threshold, peak, begin + DELAY * UNIT, rise)
    equal = changed(SCENE, {"diameters": of_delay(np.ones(20))})
    began = time.process_time()
    found = optimise(
        equal,
        wanted,
        ["diameters"],
        {"diameters": (LOW, HIGH)},
        starts=starts,
        runs=runs,
        tolerance=1e-3,
    )
    took = time.process_time() - began
    least, best, tried = random_search(
        lambda rng: changed(SCENE, {"diameters": of_delay(rng.uniform(0.8, 1.8, 20))}),
        lambda scene: wanted(seen_at_the_end(scene)).value,
        took,
    )
    cases = {
        "equal": SCENE,
        "larger piece": equal,
        f"random, best of {tried}": best,
        f"optimised, {found.runs} runs": found.scene,
    }
    picture, pulses, beads, search = one_above_two()
    for (name, scene), colour in zip(
        cases.items(), ("0.5", "#009E73", "#E69F00", "#0072B2"), strict=True
    ):
        seen = seen_at_the_end(scene)
        late = (threshold(seen).value - begin) / UNIT
        left = (peak(seen).value - LOAD) / rise
        kind = name.split(",")[0]
        if scene is not SCENE:
            say(f"delay over that wanted, {kind}", late / DELAY)
            say(f"peak over that of equal beads, {kind}", left)
        pulses.plot(
            seen.time / UNIT,
            1e3 * seen.velocity[:, 0],
            color=colour,
            label=f"{name}: {100 * left:.1f} %",
        )
        beads.step(np.arange(1, BEADS + 1), 1e3 * scene.chain.diameters, where="mid", color=colour)
    pulses.axvline(begin / UNIT + DELAY, ymax=0.6, color="0.8", zorder=0)
    pulses.set_title("Pulse; the line marks the wanted time of half its height")
    pulses.set(
        xlabel="time over that of a long wave from bead to bead",
        ylabel=f"velocity of bead {END} (mm/s)",
    )
    pulses.set_xlim(begin / UNIT - 10, SCENE.duration / UNIT)
    pulses.set_ylim(top=11)
    pulses.legend(title="peak force above the load", loc="upper left")
    beads.set(xlabel="bead", ylabel="diameter (mm)", xlim=(PIECE.start - 5, PIECE.stop + 6))
    found.plot(search)
    search.axhline(least, color="#E69F00", ls="--", label="random, best")
    search.set(yscale="log", xlabel="runs of each start", ylabel="least objective so far")
    search.set_title("Search by gradients, one line per start")
    search.legend(search.lines[-1:], ["random, best"], loc=(0.3, 0.68))
    beads.set_title("Piece between equal beads")
    say(
        "delay by the speed of long waves over that wanted",
        delay_of_long_waves(found.values["diameters"]) / DELAY,
    )
    say("runs with gradients", found.runs)
    say("random pieces tried", tried)
    say("time of each", took, "s")
    finish(picture, given.output)


if __name__ == "__main__":
    main()
