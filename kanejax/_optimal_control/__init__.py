"""Optimal control of any system in discrete time: Newton's method on all stages at once. It knows nothing of robots."""
