"""Fig. 5 of the paper: the velocity of the grains after 100 us at ten, one and a tenth times the gravity.

Lines are the native engine, circles LAMMPS, both solving Eq. (1). The strike numbers say why the three
differ: only at 10 g is this strike anywhere near gentle.
"""

import argparse
from pathlib import Path

import numpy as np

import lmpchain
from lmpchain.plotting import COLOURS, figure, save

HERE = Path(__file__).parent
SCENES = {"10 g": "fig5_10g.toml", "g": "fig5_1g.toml", "g / 10": "fig5_0.1g.toml"}


def main() -> None:
    """Run the three scenes in both engines and draw them."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("-o", "--output", default=HERE / "pictures" / "fig5.png")
    arguments = parser.parse_args()
    picture = figure(8, 9)
    for axes, (name, file) in zip(picture.subplots(3, 1, sharex=True), SCENES.items(), strict=True):
        scene = lmpchain.Scene.from_toml(HERE / "scenes" / file)
        native = lmpchain.simulate(scene, "native", tolerance=1e-8)
        lammps = lmpchain.simulate(scene, "lammps", tolerance=1e-6)
        unit = scene.excitation.velocity
        apart = np.abs(lammps.velocity - native.velocity).max() / unit
        axes.axhline(0, color="0.8", lw=0.8)
        axes.plot(native.grains, native.velocity[-1] / unit, color=COLOURS["native"], label="native")
        axes.plot(lammps.grains, lammps.velocity[-1] / unit, "o", mfc="none", color=COLOURS["lammps"], label="LAMMPS")
        axes.set_title(
            f"gravity {name}: strike number {scene.strike_number:.3g}; engines agree to {apart:.0e}", loc="left"
        )
        axes.set(ylabel=r"velocity / $v_0$", xlim=(1, 45))
        print(
            f"gravity {name}: peak at grain {native.grains[native.velocity[-1].argmax()]}, engines agree to {apart:.1g}"
        )
    axes.set_xlabel("grain, from the top")
    picture.axes[0].legend(frameon=False)
    picture.suptitle("120 glass beads, strike 0.857 mm/s, t = 100 µs: Eq. (1)")
    save(picture, arguments.output)
    print(f"picture: {arguments.output}")


if __name__ == "__main__":
    main()
