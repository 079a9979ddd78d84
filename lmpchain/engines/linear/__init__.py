"""Solutions of the linearised chain, Eq. (3), and of the homogeneous and continuous ones, as engines."""
