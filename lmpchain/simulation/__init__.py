"""From a scene and an engine to a trajectory: engine selection, run folders, checkpoints."""
