"""What engines share that move grains in steps, those of LAMMPS and of the native engine.

`time_stepping` is their engine: it proposes steps, with `step_choice`, and starts runs. `compiled`
is the engine that moves grains by compiled loops. `run` moves an answer and the auxiliary runs
beside it, whose steps are those of `auxiliary_runs`. `monitor` estimates the error of the answer:
`estimate` is the formula that makes an error of the distances of runs; `round_off` and
`amplification` add rounding and what a scene makes of errors.
"""
