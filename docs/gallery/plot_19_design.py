"""
Sensitivity, a fit and an optimum
=================================

What the force at a contact depends on, grain by grain; gravity found again from a noisy trace; and
the ball between
two others that passes most of the motion on.
"""

import numpy as np

import lmpchain
from lmpchain import design

chain = lmpchain.Chain(grains=12, diameter=1e-3)
scene = lmpchain.Scene(
    chain=chain, excitation=lmpchain.Impulse(velocity=1e-3), duration=3e-5, samples=61
)
picture = design.sensitivity(scene, "peak_force:6").plot()

# %%
t = lmpchain.simulate(scene, "native", 1e-9)
seen = t.velocity[:, [7]] + np.random.default_rng(1).normal(0.0, 2e-6, (t.time.size, 1))
trace = design.Traces(t.time, [8], seen, "velocity", 2e-6)
found = design.fit(trace, scene.replace(chain=chain.replace(gravity=9.0)), ["gravity"])
print(f"gravity: {found.values['gravity'].item():.2f} m/s2")
picture_of_fit = found.plot()

# %%
balls = lmpchain.Chain(
    grains=3, diameter=1e-2, masses=[1e-3, 2e-3, 9e-3], gravity=0.0, bottom="free"
)
# with gaps between them
thrown = lmpchain.Profile(displacement=[0.0, 4e-5, 8e-5], velocity=[1.0, 0.0, 0.0])
collision = lmpchain.Scene(chain=balls, excitation=thrown, duration=4e-4, samples=2)
bounds = {"masses": ([1e-3, 1.2e-3, 9e-3], [1e-3, 8e-3, 9e-3])}
best = design.optimise(collision, design.Momentum([3]), ["masses"], bounds, maximise=True, starts=2)
print(f"mass between 1 and 9 g: {1e3 * best.values['masses'][1]:.3f} g")
picture_of_optimum = best.plot()
picture_of_optimum.set_ylabel("momentum of the last ball (kg m/s)")
