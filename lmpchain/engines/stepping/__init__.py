"""What engines share that move grains in steps, those of LAMMPS and of the native engine.

`step_choice` chooses a step for a tolerance. `companion_run` moves the answer and auxiliary runs
beside it, at the steps that `companions` names. `estimate` is the formula that makes an error of
their distances; `round_off` and `amplification` add rounding and what a scene makes of errors.
"""
