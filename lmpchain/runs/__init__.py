"""Run folders: a run on the disk that survives what happens to machines."""
