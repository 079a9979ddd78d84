"""
A chain, a scene, a plan and a motion
=====================================

What a notebook shows of each: overlaps and sizes, the strike, the engines to choose from, and the
motion over time and
depth.
"""

import lmpchain

chain = lmpchain.Chain(grains=60, diameter=1e-3, impurity=[{"grain": 30, "diameter": 0.7e-3}])
picture = chain.plot()

# %%
scene = lmpchain.Scene(
    chain=chain, excitation=lmpchain.Impulse(velocity=1e-4), duration=80e-6, samples=161
)
picture_of_scene = scene.plot()

# %%
picture_of_plan = lmpchain.plan(scene, tolerance=1e-6).plot()

# %%
picture_of_motion = lmpchain.simulate(scene, "native").plot()
