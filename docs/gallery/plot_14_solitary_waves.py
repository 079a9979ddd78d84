"""
Solitary waves of the lattice
=============================

Without a load, by the largest velocity of a grain; under one, by the speed over that of sound.
"""

from lmpchain.theory import dimer_soliton, soliton

picture = soliton.solve(velocity=1.0).plot()

# %%
picture_under_load = soliton.solve(speed=1.2).plot()

# %%
# Alternating heavy and light grains: solitary waves exist at certain mass ratios only.
wave = dimer_soliton.solve(0.35)
print(f"mass ratio {wave.mass_ratio:.6f}")
picture_of_dimer = wave.plot()
