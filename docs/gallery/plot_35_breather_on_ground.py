"""
A breather on a ground, and a bilinear chain
============================================

In a periodic potential one grain can swing for ever while its neighbours hardly move: its frequency
lies below the band of waves. Contacts that are softer in tension than in compression give a motion
that is periodic, but no sine.
"""

# %%
# Bonds of stiffness k on the ground law ``g sin(q u) / q`` of Frenkel and Kontorova. The dashed
# curves are the breather by harmonic balance: a sum of cosines in time, odd multiples of one
# frequency, solved for with scipy. The native run starts from it and repeats it.
import matplotlib.pyplot as plt
import numpy as np
from scipy.optimize import fsolve

import lmpchain
from lmpchain import laws

plt.style.use("tableau-colorblind10")
k, grains, middle = 1e5, 21, 10
g = 4 * k
period_of_ground = 1e-5
q = 2 * np.pi / period_of_ground
chain = lmpchain.Chain(
    grains=grains,
    diameter=1e-3,
    gravity=0.0,
    law=laws.fput(k=k),
    ground=laws.frenkel_kontorova(g, period_of_ground),
)
m = chain.masses[0]
low = np.sqrt(g / m)
frequency = 0.8 * low
odd = np.arange(1, 16, 2)
phase = 2 * np.pi * np.arange(64) / 64
cosines = np.cos(odd[:, None] * phase)


def residual(amplitudes):
    """Return what is left of the equation of motion, projected on the cosines, (grains * odd,)."""
    a = amplitudes.reshape(grains, odd.size)
    ground = np.sin(a @ cosines) @ cosines.T * 2 / phase.size
    # Grain 1 is free above; the last grain is held.
    bonds = np.diff(a, axis=0, prepend=a[:1], append=0 * a[:1])
    left = (odd * frequency) ** 2 * a + (k * np.diff(bonds, axis=0) - g * ground) / m
    left[-1] = a[-1]
    return left.ravel() / low**2


guess = np.zeros((grains, odd.size))
guess[middle, 0] = 2.0
guess[[middle - 1, middle + 1], 0] = 0.3
breather = fsolve(residual, guess.ravel(), xtol=1e-13).reshape(grains, odd.size)

turns = 40
duration = turns * 2 * np.pi / frequency
scene = lmpchain.Scene(
    chain=chain,
    excitation=lmpchain.Profile(displacement=breather.sum(axis=1) / q),
    duration=duration,
    samples=turns * 48 + 1,
)
run = lmpchain.simulate(scene, "native", tolerance=1e-8)
exact = breather @ np.cos(odd[:, None] * frequency * run.time)
error = np.abs(q * run.displacement - exact.T).max()
print(f"after {turns} periods the phases differ from harmonic balance by {error:.0e} rad at most")

# %%
# A grain on one contact that is four times softer in tension: half a sine of each stiffness, so the
# period is ``pi (m / k)^(1/2) (1 + 2)``.
ball = lmpchain.Chain(grains=2, diameter=1e-3, gravity=0.0, law=laws.bilinear(0.25, k=k))
unit = np.sqrt(ball.masses[0] / k)
period = np.pi * unit * 3
swing = lmpchain.Scene(
    chain=ball,
    excitation=lmpchain.Impulse(velocity=1e-3),
    duration=4 * period,
    samples=401,
)
motion = lmpchain.simulate(swing, "native", tolerance=1e-9)
into = motion.time % period
half = np.pi * unit
sines = np.where(
    into < half, np.sin(into / unit), -2 * np.sin(np.maximum(into - half, 0) / (2 * unit))
)
print(f"bilinear: within {np.abs(motion.displacement[:, 0] / (1e-3 * unit) - sines).max():.0e}")

picture, (left, right) = plt.subplots(1, 2, figsize=(7.2, 3.2), layout="constrained")
late = run.time > run.time[-1] * (1 - 3 / turns)
turn = run.time * frequency / (2 * np.pi)
for away, style in ((0, "C0"), (1, "C1"), (2, "C2")):
    grain = middle + away
    label = "middle" if away == 0 else f"{away} away"
    left.plot(turn[late], q * run.displacement[late, grain], style, lw=2.5, label=label)
    left.plot(
        turn[late], exact[grain, late], "k--", lw=1, label="harmonic balance" if away == 2 else None
    )
left.set(xlabel="time in periods", ylabel="phase $q u$ (rad)", ylim=(-3, 5.2), title="(a)")
left.legend(loc="upper center", ncols=2)
right.plot(motion.time / period, motion.displacement[:, 0] * 1e9, lw=2.5, label="run")
right.plot(motion.time / period, 1e6 * unit * sines, "k--", lw=1, label="half sines")
right.set(xlabel="time in periods", ylabel="displacement (nm)", ylim=(-8, 7), title="(b)")
right.legend(loc="upper center", ncols=2)
