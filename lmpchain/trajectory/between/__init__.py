"""The motion between samples: compiled, from what is known at these."""
