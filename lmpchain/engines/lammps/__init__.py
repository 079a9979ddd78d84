"""Eq. (1) in LAMMPS by heights of grains, with `pair_style granular`."""
