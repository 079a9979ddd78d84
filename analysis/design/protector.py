"""A shock protector of 20 steel beads: diameters that let least force through to a wall, within a given length.

The first bead strikes at 1 m/s; it and the wall are as they are. The other 19 may have half to one and a half times
its diameter, and all together no more length than 20 equal ones. Random search has as many seconds of the processor.
The protectors of Fraternali, Porter and Daraio (arXiv:0802.1451), found by an evolutionary algorithm, change materials
and order as well; they are not compared with.
"""

import sys
import time
from pathlib import Path

import numpy as np
from matplotlib.patches import Circle

sys.path.insert(0, str(Path(__file__).parents[1]))
from figures import arguments, finish, say

from lmpchain import Chain, Impulse, InputError, Scene
from lmpchain.design import PeakForce, optimise
from lmpchain.design.changes import changed
from lmpchain.design.gradients import looks_of
from lmpchain.integrators.adjoint import DifferentiableRun
from lmpchain.integrators.splittings import SPLITTINGS
from lmpchain.util.plotting import figure

BEADS, SIZE = 20, 1e-2
CHAIN = Chain(grains=BEADS, diameter=np.full(BEADS, SIZE), material="steel", gravity=0.0, bottom="wall")
SCENE = Scene(chain=CHAIN, excitation=Impulse(velocity=1.0), duration=1.5e-3, samples=151)
LOW, HIGH = np.full(BEADS, 0.5 * SIZE), np.full(BEADS, 1.5 * SIZE)
LOW[0] = HIGH[0] = SIZE
PEAK = PeakForce(BEADS)


def spare_length(by_name):
    """Return what is left of the length, over it, and its derivatives."""
    return 1 - by_name["diameters"].sum() / (BEADS * SIZE), {"diameters": np.full(BEADS, -1 / (BEADS * SIZE))}


def wall_force(scene: Scene) -> tuple[np.ndarray, np.ndarray]:
    """Return the force on the wall over time."""
    looks = looks_of(scene, PEAK)
    run = DifferentiableRun(scene, SPLITTINGS["rkn4"], 1.0 / scene.highest_frequency, looks, np.array([BEADS]))
    return run.time, scene.chain.contacts.constant[BEADS] * np.maximum(run.displacement[:, 0], 0.0) ** 1.5


def random_search(seconds: float) -> tuple[float, Scene, int]:
    """Return the least peak of random beads that fit, in so many seconds of the processor, and how many were tried."""
    rng, best, tried = np.random.default_rng(2), (np.inf, SCENE), 0
    end = time.process_time() + seconds
    while time.process_time() < end:
        diameters = np.clip(rng.uniform(LOW, HIGH), LOW, HIGH)
        if diameters.sum() > BEADS * SIZE:
            diameters[1:] *= (BEADS * SIZE - SIZE) / diameters[1:].sum()
            diameters = np.clip(diameters, LOW, HIGH)
        try:
            scene = changed(SCENE, {"diameters": diameters})
        except InputError:
            continue
        best, tried = min(best, (wall_force(scene)[1].max(), scene), key=lambda one: one[0]), tried + 1
    return *best, tried


def main() -> None:
    """Search both ways and draw the forces on the wall and the beads."""
    given = arguments(__file__, __doc__)
    starts, runs = (2, 15) if given.quick else (8, 150)
    began = time.process_time()
    found = optimise(
        SCENE, PEAK, ["diameters"], {"diameters": (LOW, HIGH)}, [spare_length], starts=starts, runs=runs, tolerance=1e-3
    )
    took = time.process_time() - began
    random_peak, random_scene, tried = random_search(took)
    equal = wall_force(SCENE)[1].max()
    least = wall_force(found.scene)[1].max()
    say("equal beads", equal, "N")
    say("optimised", least, "N")
    say("optimised over equal", least / equal)
    say("random search over equal", random_peak / equal)
    say("runs with gradients", found.runs)
    say("random beads tried", tried)
    say("time of each", took, "s")
    picture = figure(10.0, 7.0)
    above, below = picture.subplots(2, 2)
    cases = {"equal": SCENE, f"random, best of {tried}": random_scene, f"optimised, {found.runs} runs": found.scene}
    for (name, scene), colour in zip(cases.items(), ("0.5", "#E69F00", "#0072B2"), strict=True):
        at, force = wall_force(scene)
        above[0].plot(1e3 * at, force, color=colour, label=f"{name}: {force.max():.0f} N")
        below[0].plot(np.arange(1, BEADS + 1), 1e3 * scene.chain.diameters, ".-", color=colour)
    above[0].set(xlabel="time, ms", ylabel="force on the wall, N")
    above[0].legend(frameon=False)
    below[0].set(xlabel="bead, the wall is below the last", ylabel="diameter, mm", xticks=range(2, BEADS + 1, 2))
    found.plot(above[1])
    above[1].axhline(random_peak, color="#E69F00", ls="--")
    above[1].set(ylabel="least peak force so far, N", xlabel="runs of each start")
    centre = np.cumsum(found.scene.chain.diameters) - found.scene.chain.diameters / 2
    below[1].set_aspect("equal")
    for x, d in zip(centre, found.scene.chain.diameters, strict=True):
        below[1].add_patch(Circle((1e3 * x, 0), 500 * d, fc="#56B4E9", ec="0.3"))
    below[1].set(xlim=(-2, 1e3 * centre[-1] + 12), ylim=(-30, 30), xlabel="mm", yticks=[])
    below[1].axvline(1e3 * found.scene.chain.diameters.sum(), color="0.3", lw=3)
    below[1].set_title("optimised, struck from the left", fontsize=9)
    finish(picture, given.output)


if __name__ == "__main__":
    main()
