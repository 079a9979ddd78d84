"""Laws for the limits of methods and theories that only the maps use, and their measurement."""
