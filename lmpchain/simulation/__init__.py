"""A scene and an engine in, a trajectory out: the front door, the choice of the engine, run folders and checkpoints."""
