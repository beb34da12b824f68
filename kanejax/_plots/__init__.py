"""Figures of matplotlib: one style, and one way to draw joints, their units and their limits, for notebooks and reports alike."""
