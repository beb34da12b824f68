"""The sweeps over the links of a tree that all of the dynamics is made of."""
