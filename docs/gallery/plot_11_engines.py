"""
Engines against a reference
===========================

The same scene in several engines, and their true errors over time.
"""

import warnings

import lmpchain
from lmpchain.benchmark.comparison import compare
from lmpchain.benchmark.reference import reference

chain = lmpchain.Chain(grains=60, diameter=1e-3)
scene = lmpchain.Scene(
    chain=chain, excitation=lmpchain.Impulse(velocity=8.57e-4), duration=6e-5, samples=61
)
with warnings.catch_warnings():
    warnings.simplefilter("ignore")  # linear theory does not hold here
    runs = [lmpchain.simulate(scene, engine, 1e-6) for engine in ("native", "lammps", "chebyshev")]
comparison = compare(runs, reference(scene))
picture = comparison.plot()

# %%
print(comparison.table())
