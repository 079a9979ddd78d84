"""
Energies: solitary waves of a strike, two that meet, power, wavenumbers
=======================================================================

How much of a strike leaves in solitary waves, and what becomes of waves, each in one call.
"""

import numpy as np

import lmpchain
from lmpchain import patterns
from lmpchain.measure import collision, power, solitary, wavenumbers
from lmpchain.theory import soliton
from lmpchain.util.plotting import figure

# %%
# A bead of ten times the mass strikes a row: a train of solitary waves, each an exact one.
mass = np.full(200, 1e-6)
mass[0] *= 10
row = lmpchain.Chain(
    grains=200,
    diameter=1e-3,
    gravity=0.0,
    bottom="free",
    masses=mass,
    contact_constants=[1e9] * 199,
)
strike = lmpchain.Impulse(velocity=0.1)
scene = lmpchain.Scene(chain=row, excitation=strike, duration=3.1e-4, samples=3001)
train = solitary.find(lmpchain.simulate(scene, "native", 1e-6))
picture = train.plot()
for share, off in zip(train.share, train.speed / train.exact_speed - 1, strict=True):
    print(f"{share:.3%} of the energy, speed off the exact one by {off:.0e}")

# %%
# Under a load two equal waves meet head-on, and go on a little ahead.
level = {"diameter": 1e-3, "gravity": 0.0, "top_load": 1.0}
chain = lmpchain.Chain(grains=500, **level)
wave = soliton.solve(speed=1.05)
pair = wave.on(chain, 125) + wave.on(chain, 375, downward=False)
scene = lmpchain.Scene(chain=chain, excitation=pair, duration=240 * chain.time_scale, samples=4001)
met = collision.find(lmpchain.simulate(scene, "native", 1e-8))
picture_of_collision = met.plot()
print(f"{met.shift[0]:.4f} ± {met.shift_error[0]:.1g} grains, in Toda's chain {met.toda[0]:.4f}")

# %%
# A force on a lead, an impurity, ends that absorb: the power behind it, in its steady state.
impurity = [{"grain": 30, "diameter": 1.6e-3}]
piece = lmpchain.Chain(grains=60, bottom="wall", impurity=impurity, **level)
endless = patterns.absorbing(piece, bottom=60, top=60)
push = lmpchain.Force(grain=80, amplitude=0.3, frequency=0.15 / piece.time_scale)
scene = lmpchain.Scene(chain=endless, excitation=push, duration=150 / push.frequency, samples=3001)
passed = power.through(lmpchain.simulate(scene, "native", 1e-5), 100)
picture_of_power = passed.plot()
print(f"{passed.share:.2%} of the power, {passed.linear_share:.2%} in linear theory")

# %%
# Energy by wavenumber along a chain of random masses, after a strike on its end. The axis ends at
# 0.5 % of the energy; the grains next to the strike hold more.
masses = np.exp(np.random.default_rng(1).normal(0, 0.5, 400)) * 1e-6
rough = lmpchain.Chain(grains=400, masses=masses, contact_constants=[1e9] * 399, **level)
time = np.sqrt(masses.mean() / np.median(rough.linear_stiffness))
scene = lmpchain.Scene(
    chain=rough, excitation=lmpchain.Impulse(velocity=1e-4), duration=250 * time, samples=3
)
split = wavenumbers.bands(
    lmpchain.simulate(scene, "native"), np.pi * np.array([0, 0.1, 0.2, 0.4, 1])
)
picture_of_bands = figure(7, 4)
axes = split.plot(picture_of_bands.subplots())
axes.set(ylim=(0, 5e-3 * split.total[-1]))
