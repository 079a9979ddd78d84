"""A filter: three repeated masses that block one band and transmit a higher one.

Packets of waves of 0.45 and of 0.8 of the highest frequency travel down a uniform chain under a
load, to twelve cells of three grains, whose masses may be a quarter to three times those of the
others. What passes of the one, less what passes of the other, shall be least: by gradients of two
runs, and, on its own, by transfer matrices over both spectra.
"""

import sys
from pathlib import Path

import numpy as np
from scipy.optimize import minimize

sys.path.insert(0, str(Path(__file__).parents[1]))
from figures import arguments, finish, say

from lmpchain import Chain, Packet, Profile, Scene
from lmpchain.design import Energy
from lmpchain.design.gradients import at_step
from lmpchain.integrators.methods import SPLITTINGS
from lmpchain.theory import bands, scattering
from lmpchain.util.plotting import figure

GRAINS = 500
FIRST = 230
CELL = 3
CELLS = 12
STOP = 0.45
PASS = 0.8
WIDTH = 16.0
GRAIN = 130
LEAST = 0.25
MOST = 3.0
PLAIN = Chain(grains=GRAINS, diameter=1e-3, gravity=0.0, top_load=1.0)
MASS = float(PLAIN.masses[0])
STIFFNESS = float(PLAIN.linear_stiffness[0])
EDGE = 2 * np.sqrt(STIFFNESS / MASS)
# Number of points of a spectrum that resolves the resonances of the cells.
LAST = FIRST + CELL * CELLS
FINE = 2**14


def with_cells(factors: np.ndarray) -> Chain:
    """Return the chain with the masses of its cells multiplied by these factors."""
    masses = np.full(GRAINS, MASS)
    masses[FIRST:LAST] *= np.tile(factors, CELLS)
    return PLAIN.replace(masses=masses, contact_constants=PLAIN.contact_constants)


class Way:
    """A packet of waves with its transmission by a run and by transfer matrices."""

    def __init__(self, share: float):
        packet = Packet(
            frequency=share * EDGE / (2 * np.pi),
            width=WIDTH,
            grain=GRAIN,
            amplitude=1e-5 * PLAIN.length_scale,
        )
        u, v = packet.initial(PLAIN)
        q = 2 * np.pi * np.fft.rfftfreq(FINE)[1:-1]
        self.weight = np.abs(np.fft.rfft(v, FINE)[1:-1]) ** 2
        self.frequency = EDGE * np.sin(q / 2)
        self.weight = self.weight / self.weight.sum()
        speed = EDGE / 2 * np.sqrt(1 - share**2)
        self.scene = Scene(
            chain=PLAIN,
            excitation=Profile(displacement=u, velocity=v),
            duration=470 / speed,
            samples=2,
        )
        self.whole = self._energy(self.scene, range(1, GRAINS + 1), ())[0]

    def _energy(self, scene: Scene, grains: range, names: tuple[str, ...]):
        return at_step(
            scene, Energy(list(grains)), names, SPLITTINGS["rkn6"], 1.0 / scene.highest_frequency
        )

    def passed(self, factors: np.ndarray) -> tuple[float, np.ndarray]:
        """Return the transmitted energy fraction and its derivatives by the factors, by a run."""
        scene = self.scene.replace(chain=with_cells(factors))
        value, by_name, _ = self._energy(scene, range(LAST + 1, GRAINS + 1), ("masses",))
        by_factor = MASS * by_name["masses"][FIRST:LAST].reshape(CELLS, CELL).sum(0)
        return value / self.whole, by_factor / self.whole

    def by_formula(self, factors: np.ndarray) -> float:
        """Return the transmitted fraction by transfer matrices."""
        return float(
            scattering.transmission(with_cells(factors), self.frequency).transmitted @ self.weight
        )


def main() -> None:
    """Optimise the masses with both methods, and draw the transmission and the gap."""
    given = arguments(__file__, __doc__)
    stop = Way(STOP)
    through = Way(PASS)
    history = []

    def value(factors: np.ndarray) -> tuple[float, np.ndarray]:
        (low, by_low) = stop.passed(factors)
        (high, by_high) = through.passed(factors)
        history.append((low, high))
        return low - high, by_low - by_high

    begin = np.array([0.6, 1.0, 1.4])
    box = [(LEAST, MOST)] * CELL
    options = {"maxfun": 60}
    found = minimize(value, begin, jac=True, bounds=box, method="L-BFGS-B", options=options).x
    formula = minimize(
        lambda f: stop.by_formula(f) - through.by_formula(f), begin, bounds=box, method="L-BFGS-B"
    ).x
    gap = bands.gaps(bands.Cell(found * MASS, np.full(CELL, STIFFNESS)))[0] / EDGE
    for name, way in (("stopped", stop), ("passing", through)):
        say(f"{name} packet, share that passes", way.passed(found)[0])
        say(f"{name} packet, share by transfer matrices", way.by_formula(found))
    for number, (by_run, by_formula) in enumerate(zip(found, formula, strict=True), 1):
        say(f"mass {number}", by_run)
        say(f"mass {number} by transfer matrices", by_formula)
    say("gap from", gap[0])
    say("gap to", gap[1])
    say("pairs of runs", len(history))
    picture = figure(7.5, 4.0)
    left, right = picture.subplots(1, 2)
    near = np.linspace(0.02, 0.998, 1500)
    for name, factors, style in (
        ("at first", begin, {"color": "0.7"}),
        ("optimised", found, {"color": "#0072B2"}),
    ):
        left.plot(
            near,
            scattering.transmission(with_cells(factors), EDGE * near).transmitted,
            label=name,
            lw=1,
            **style,
        )
    left.axvspan(*gap, color="#E69F00", alpha=0.25, lw=0, label="gap of the cells")
    for way, colour, name in (
        (stop, "#D55E00", "spectrum to stop (scaled)"),
        (through, "#009E73", "spectrum to pass (scaled)"),
    ):
        shown = 0.5 * way.weight / way.weight.max()
        left.fill_between(way.frequency / EDGE, shown, color=colour, alpha=0.4, lw=0, label=name)
    for share in () if given.quick else (0.2, 0.3, 0.38, STOP, 0.5, 0.6, 0.7, 0.75, PASS, 0.85):
        left.plot(share, Way(share).passed(found)[0], "o", ms=4, mfc="none", color="k")
    left.plot([], [], "o", ms=4, mfc="none", color="k", label="runs of packets")
    left.set_title("Transmission of twelve cells")
    right.set_title("Search by gradients of two runs")
    right.locator_params(axis="x", integer=True)
    left.set(
        xlabel="frequency / band edge",
        ylabel="share of the energy that passes",
        ylim=(0, 1.05),
    )
    picture.legend(*left.get_legend_handles_labels(), loc="outside lower center", ncols=3)
    for part, name, colour in zip(
        np.transpose(history), ("stopped", "passing"), ("#D55E00", "#009E73"), strict=True
    ):
        right.plot(np.arange(1, part.size + 1), part, ".-", color=colour, label=name)
    right.set(xlabel="pair of runs", ylabel="share of the energy that passes", ylim=(0, 1.05))
    right.legend()
    finish(picture, given.output)


if __name__ == "__main__":
    main()
