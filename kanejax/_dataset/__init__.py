"""Data sets of simulated trajectories: what is drawn at random, how it is simulated in chunks, and the store it goes to."""
