"""Time stepping, shared by the native engine and LAMMPS.

`time_stepping` has the base class of both engines, which proposes steps (`step_choice`) and starts
runs, and the engine of compiled loops. `run` moves an answer and its auxiliary runs forward.
`auxiliary_runs` chooses the steps of the auxiliary runs and estimates the truncation error from
their distances. `monitor` adds the rounding error (`rounding`) and its amplification by the scene.
"""
