"""
A ground, and a stiffness in time
=================================

A spring between every grain and the ground opens a gap below the band of waves. If its stiffness
oscillates in time, a grain is driven by parametric resonance, within the tongues of Mathieu's
equation.
"""

# %%
# Grains between springs have the frequencies ``w^2 = (g + 4 k sin^2(q/2)) / m`` for a phase q a
# grain. A slow drive below the gap does not travel; a fast one does, with the phase of theory.
import matplotlib.pyplot as plt
import numpy as np
from scipy.special import mathieu_a, mathieu_b

import lmpchain
from lmpchain.theory import bands

host = {"diameter": 1e-3, "gravity": 0.0, "top_load": 1.0}
plain = lmpchain.Chain(grains=2, **host)
k = plain.linear_stiffness[0]
m = plain.masses[0]
ground = lmpchain.laws.klein_gordon(0.5 * k)
chain = lmpchain.Chain(grains=2, **host, ground=ground)
low, high = np.sqrt(np.array([0.5, 4.5]) * k / m)

q = np.linspace(0, np.pi, 200)
cell = bands.Cell([m], [k], ground=0.5 * k)
driven = low + (high - low) * np.array([-0.2, 0.1, 0.3, 0.5, 0.7, 0.9])
phase = np.zeros(driven.size)
decay = np.zeros(driven.size)
for n, w in enumerate(driven):
    long = lmpchain.Chain(grains=150, **host, ground=ground)
    drive = lmpchain.Drive(amplitude=1e-3 * long.length_scale, frequency=w / (2 * np.pi))
    scene = lmpchain.Scene(
        chain=long, excitation=drive, duration=120 * long.time_scale, samples=1001
    )
    run = lmpchain.simulate(scene, "native", tolerance=1e-5)
    late = run.time > 0.5 * run.time[-1]
    # A smooth window leaves out what the beginning of the drive has excited.
    turns = np.hanning(late.sum()) * np.exp(-1j * w * run.time[late])
    amplitude = turns @ run.displacement[late, 2:6]
    ratio = amplitude[1:] / amplitude[:-1]
    phase[n] = -np.angle(ratio).mean()
    decay[n] = -np.log(np.abs(ratio)).mean()

# %%
# A single grain on a ground whose stiffness is ``k (1 + a cos W t)``: the growth rate over a
# period of W from two runs, and the edges of the tongues from Mathieu's characteristic values.
free = lmpchain.Chain(grains=1, exponent=1, top="wall", bottom="wall", **host, masses=[m])
springs = free.contacts.stiffness.sum()
values = np.linspace(0.3, 5.5, 40)
depths = np.linspace(0.0, 2.0, 13)[1:]
growth = np.zeros((depths.size, values.size))
for i, depth in enumerate(depths):
    for j, value in enumerate(values):
        w = np.sqrt(4 * 1.5 * springs / (m * value))
        a = depth * m * w**2 / springs
        law = lmpchain.laws.mathieu(0.5 * springs, depth=a, frequency=w / (2 * np.pi))
        on = free.replace(ground=law)
        period = 2 * np.pi / w
        starts = [
            lmpchain.Displacement(displacement=1e-12),
            lmpchain.Impulse(velocity=1e-12 * w),
        ]
        scenes = [
            lmpchain.Scene(chain=on, excitation=start, duration=period, samples=2)
            for start in starts
        ]
        u, v = (lmpchain.simulate(scene, "native", tolerance=1e-8) for scene in scenes)
        trace = u.displacement[1, 0] / 1e-12 + v.velocity[1, 0] / (1e-12 * w)
        growth[i, j] = np.arccosh(max(abs(trace) / 2, 1.0))

picture, (left, right) = plt.subplots(1, 2, figsize=(7.2, 3.2), layout="constrained")
left.plot(q, bands.branches(cell, q).frequency[0] / (2e3 * np.pi), label="theory")
moves = driven > low
left.plot(phase[moves], driven[moves] / (2e3 * np.pi), "o", mfc="none", label="driven chain")
left.axhspan(0, low / (2e3 * np.pi), color="0.9", lw=0)
left.set(xlabel="phase a grain (rad)", ylabel="frequency (kHz)", ylim=(0, None), title="(a)")
left.legend()
mesh = right.pcolormesh(values, depths, growth, cmap="cividis")
for edge, order in ((mathieu_b, 1), (mathieu_a, 1), (mathieu_b, 2), (mathieu_a, 2)):
    right.plot(edge(order, depths), depths, "w--", lw=1)
right.set(
    xlabel="a, (2 natural / modulation frequency)²",
    ylabel="q, depth of modulation",
    xlim=(values[0], values[-1]),
    title="(b)",
)
picture.colorbar(mesh, label="growth a period, natural log")

# %%
# Below the gap the amplitude falls from grain to grain by what theory says.
kappa = 2 * np.arcsinh(np.sqrt((0.5 * k - m * driven[0] ** 2) / (4 * k)))
print(f"decay a grain below the gap: {decay[0]:.4f}, in theory {kappa:.4f}")
