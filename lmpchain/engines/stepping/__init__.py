"""What engines share that move grains in steps, those of LAMMPS and of the native engine.

`time_stepping` has their engine, which proposes steps, with `step_choice`, and starts runs; and the
one that moves grains by compiled loops. `run` moves an answer and auxiliary runs, whose
steps `auxiliary_runs` chooses and by whose distances it estimates the truncation error. `monitor`
adds `rounding`, and what a scene makes of it.
"""
