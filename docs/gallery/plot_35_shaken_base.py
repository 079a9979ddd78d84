"""
A column on a shaker
====================

The base of a damped column under gravity is shaken: its apparent mass and loss factor by frequency,
and the motion of the grains when the base accelerates by more than gravity.
"""

import matplotlib.pyplot as plt
import numpy as np

import lmpchain
from lmpchain.measure import harmonic

plt.style.use("tableau-colorblind10")
column = lmpchain.Chain(
    grains=10,
    material="steel",
    diameter=1e-2,
    bottom="wall",
    damping=lmpchain.Damping(viscoelastic=2e-5),
)


def shaker(frequency, acceleration):
    """Return the motion of the base with a frequency, Hz, and a peak acceleration, m/s2."""
    amplitude = acceleration / (2 * np.pi * frequency) ** 2
    return lmpchain.Drive(end="bottom", amplitude=amplitude, frequency=frequency)


def response(frequency, acceleration):
    """Return the drive point of the base."""
    scene = lmpchain.Scene(
        chain=column,
        excitation=shaker(frequency, acceleration),
        duration=64 / frequency,
        samples=64 * 24 + 1,
    )
    return harmonic.drive_point(lmpchain.simulate(scene, "native", tolerance=1e-8))


# %%
# Below its first resonance the column moves as one body: the apparent mass is its mass. Weak
# shaking agrees with the exact response of the linear column; strong shaking shifts the resonance.
frequencies = np.geomspace(400.0, 3000.0, 16)
picture, (above, below) = plt.subplots(2, figsize=(7, 6), sharex=True, layout="constrained")
for share, marker in ((1e-3, "o"), (0.5, "s")):
    points = [response(frequency, share * column.gravity) for frequency in frequencies]
    masses = np.array([point.apparent_mass for point in points])
    losses = np.array([point.loss_factor for point in points])
    errors = [point.apparent_mass_error for point in points]
    label = f"shaken by {share:g} g"
    above.errorbar(frequencies, 1e3 * abs(masses), 1e3 * np.array(errors), fmt=marker, label=label)
    below.plot(frequencies, losses, marker, label=label)
fine = np.geomspace(400.0, 3000.0, 400)
linear = np.array([lmpchain.theory.steady.drive_stiffness(column, shaker(f, 1.0)) for f in fine])
above.plot(fine, 1e3 * abs(linear) / (2 * np.pi * fine) ** 2, "k-", lw=1, label="linear column")
below.plot(fine, linear.imag / abs(linear.real), "k-", lw=1)
above.axhline(1e3 * column.masses.sum(), color="k", ls=":", lw=1, label="mass of the grains")
above.set(xscale="log", yscale="log", ylabel="apparent mass (g)", title="(a)")
below.set(xlabel="frequency (Hz)", yscale="log", ylabel="loss factor", title="(b)")
above.legend()

# %%
# At three times gravity the grains leave the base and each other, and come back. The base is grey.
# Heights are above those at rest, one above the other.
strong = shaker(80.0, 3 * column.gravity)
scene = lmpchain.Scene(chain=column, excitation=strong, duration=0.045, samples=1001)
run = lmpchain.simulate(scene, "native", tolerance=1e-6)
picture_of_bounces, axes = plt.subplots(figsize=(7, 5), layout="constrained")
time = 1e3 * run.time
step = 2e-4
axes.fill_between(time, -1e3 * step, -1e3 * strong.motion(run.time)[0], color="0.8", label="base")
for grain in range(10, 0, -3):
    height = (10 - grain + 1) * step - run.displacement[:, grain - 1]
    axes.plot(time, 1e3 * height, lw=1, label=f"grain {grain}")
axes.set(xlabel="time (ms)", ylabel="height above rest, shifted (mm)", ylim=(-1e3 * step, None))
axes.legend(ncols=5, loc="upper left", fontsize="small")
