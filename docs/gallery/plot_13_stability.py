"""
Where methods fail on a scene
=============================

The longest stable steps, the smallest error in double precision, the predictability time, the
error of linear theory.
"""

import lmpchain
from lmpchain.stability import stability

chain = lmpchain.Chain(grains=12, diameter=1e-3)
scene = lmpchain.Scene(
    chain=chain, excitation=lmpchain.Impulse(velocity=1e-3), duration=3e-5, samples=21
)
found = stability(scene)
picture = found.plot()

# %%
print(found.table())
