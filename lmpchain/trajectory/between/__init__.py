"""Motion between the samples of a trajectory, compiled: largest values, fronts and their errors."""
