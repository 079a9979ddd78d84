"""What an answer depends on, grain by grain, and how uncertain it is for uncertain grains."""
