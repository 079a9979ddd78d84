"""Many scenes in one go."""
