"""What one reads off a trajectory: pure functions of arrays, which never run an engine."""
