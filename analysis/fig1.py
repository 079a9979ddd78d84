"""Fig. 1 of the paper: the velocity of the grains while a strong pulse passes by.

Lines are the native engine, circles LAMMPS. The panel below shows how far the two are apart, beside
what they expect. The pulse is not a pure soliton: its peak breathes as it crosses from grain to grain,
and the contacts 1, 2 and 3 open behind it.
"""

import argparse
from pathlib import Path

import numpy as np

import lmpchain
from lmpchain.plotting import COLOURS, figure, save

HERE = Path(__file__).parent
MOMENTS = (88.4e-6, 89.8e-6, 91.8e-6)  # s; the paper's interval, and the highest peak in between


def main() -> None:
    """Run the scene in both engines and draw it."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("-o", "--output", default=HERE / "pictures" / "fig1.png")
    arguments = parser.parse_args()
    scene = lmpchain.Scene.from_toml(HERE / "scenes" / "fig1.toml")
    native = lmpchain.simulate(scene, "native", tolerance=1e-8)
    lammps = lmpchain.simulate(scene, "lammps", tolerance=1e-6)
    expected = native.error_estimate.total + lammps.error_estimate.total

    picture = figure(8, 6)
    wave, apart = picture.subplots(2, 1, sharex=True, height_ratios=(3, 1))
    shades = ("#56B4E9", "#0072B2", "#009E73")
    for moment, shade in zip(MOMENTS, shades, strict=True):
        row = int(np.abs(native.time - moment).argmin())
        label = f"{native.time[row] * 1e6:.1f} µs"
        wave.plot(native.grains, native.velocity[row] * 1e3, color=shade, label=f"native, {label}")
        wave.plot(lammps.grains, lammps.velocity[row] * 1e3, "o", mfc="none", color=shade, label=f"LAMMPS, {label}")
        difference = np.abs(lammps.velocity[row] - native.velocity[row]) / np.abs(native.velocity).max()
        apart.semilogy(native.grains, np.maximum(difference, 1e-12), color=shade)
    wave.set(ylabel="velocity downward (mm/s)", xlim=(1, 40))
    wave.legend(frameon=False, loc="upper left")
    apart.axhline(expected, color=COLOURS["lammps"], ls="--", label=f"expected: {expected:.1g}")
    apart.set(xlabel="grain, from the top", ylabel="|LAMMPS - native| / $v_0$")
    apart.legend(frameon=False, loc="upper right")
    picture.suptitle(f"120 glass beads, strike {scene.excitation.velocity * 1e3:g} mm/s (strong)")
    save(picture, arguments.output)
    agreement = np.abs(lammps.velocity - native.velocity).max() / scene.excitation.velocity
    print(f"LAMMPS and native agree to {agreement:.1g} of the strike; picture: {arguments.output}")


if __name__ == "__main__":
    main()
