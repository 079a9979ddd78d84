"""A scene and an engine in, a trajectory out; engine selection, run folders, checkpoints."""
