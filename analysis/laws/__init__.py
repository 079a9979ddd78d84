"""Laws for where methods and theories fail that only the maps need, and what measures them."""
