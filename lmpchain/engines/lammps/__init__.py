"""Eq. (1) in LAMMPS: `pair_style granular` without damping, on heights."""
