"""Time stepping, shared by the native engine and LAMMPS.

`time_stepping` has the base class of both engines, which proposes steps (`step_choice`) and starts
runs, and the engine of compiled loops. `run` advances the main run and its auxiliary runs.
`auxiliary_runs` chooses the steps of the auxiliary runs and estimates the truncation error from
the differences between runs. `monitor` adds the rounding error, which `rounding` estimates, and
its amplification by the scene.
"""
