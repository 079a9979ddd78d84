"""Laws of failure of methods and theories that only the maps need, and their measurement."""
