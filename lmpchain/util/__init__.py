"""What every room needs and none owns: arrays, checked input, files, templates, MPI, compiled loops, pictures."""
