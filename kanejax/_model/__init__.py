"""The model: a static tree of bodies and joints, and the parameters on it."""
