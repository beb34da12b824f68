"""Optimal motions of a model: what is asked for, how it becomes a problem of optimal control, and what comes back."""
