"""
Shocks: dispersive, steady, in a vacuum; a rarefaction
======================================================

A piston, or a step of compression (the Riemann problem), sends them down a chain of steel beads.
"""

import lmpchain
from lmpchain.measure import planar, self_similar, shock
from lmpchain.util.plotting import figure, letter_panels

chain = lmpchain.Chain(
    grains=600,
    material="steel",
    diameter=9.5e-3,
    gravity=0.0,
    top_load=10.0,
    top="wall",
    bottom="wall",
)
piston = lmpchain.Drive(shape="piston", velocity=0.07, rise=2e-4, grain=0)


def run(chain: lmpchain.Chain, excitation: lmpchain.Drive | lmpchain.Riemann, duration: float):
    """Run a scene, and measure its wave."""
    scene = lmpchain.Scene(chain=chain, excitation=excitation, duration=duration, samples=1601)
    return shock.find(lmpchain.simulate(scene, "native", 1e-5))


# %%
# Without damping, a train of solitary waves spreads: a dispersive shock.
train = run(chain, piston, 9e-3)
for name, edges in train.predictions.items():
    print(f"{name}: {edges.leading:.0f} and {edges.trailing:.0f} grains/s")
print(f"measured: {train.leading.speed:.0f} and {train.trailing.speed:.0f} grains/s")
print(f"a solitary wave as high as the leading one: {train.solitary:.0f} grains/s")
space_time = train.plot_map()

# %%
# With viscous contacts, a shock of one width; without a load, solitary waves that drift apart.
viscous = chain.replace(grains=300, damping=lmpchain.Damping(viscoelastic=5e-6))
steady = run(viscous, piston, 4.4e-3)
print(f"{steady.leading.speed:.1f} grains/s, Rankine-Hugoniot {steady.rankine_hugoniot[1]:.1f}")
vacuum = run(chain.replace(grains=300, top_load=0.0), piston, 6e-3)
print(f"the leading wave over the piston: {vacuum.leading.velocity / 0.07:.3f}")

# %%
# A step to less compression opens into a rarefaction, whose edges move at the speeds of sound.
less = -0.5 * chain.equilibrium_overlap[0] / 9.5e-3
step = lmpchain.Riemann(velocity=(0, 0), strain=(less, 0), grain=350)
opening = run(chain.replace(top="free"), step, 4e-3)
picture = figure(9, 9)
panels = picture.subplots(2, 2).ravel()
for ax, wave in zip(panels, (train, steady, vacuum, opening), strict=True):
    wave.plot(ax)
letter_panels(panels)

# %%
# Over distance divided by time, the profiles of a rarefaction at all times approach one curve, the
# simple wave of gas dynamics; those of a dispersive shock keep its two edges.
steps = lmpchain.Scene(
    chain=chain.replace(top="free"), excitation=step, duration=4e-3, samples=1601
)
picture_of_rarefaction = self_similar.view(lmpchain.simulate(steps, "native", 1e-5)).plot()
pistons = lmpchain.Scene(chain=chain, excitation=piston, duration=9e-3, samples=1601)
compressed = lmpchain.simulate(pistons, "native", 1e-5)
picture_of_shock = self_similar.view(compressed).plot()

# %%
# Near one ratio of distance to time, the waves of a dispersive shock are closed orbits of a planar
# ordinary differential equation: dots are measured, lines are orbits between crest and trough. The
# distance between crests and the mean follow from the orbit.
waves = planar.orbits(compressed)
for row in (0, len(waves.orbits) // 2):
    print(f"measured {waves.spacing[row]:.2f} ± {waves.spacing_error[row]:.2f} grains, ", end="")
    print(f"orbit {waves.orbit_spacing[row]:.2f} ± {waves.orbit_spacing_error[row]:.2f} grains")
picture_of_orbits = waves.plot()
