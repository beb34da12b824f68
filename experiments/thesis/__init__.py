"""Nie 1988 again: each module is one of the thesis's results or claims, computed with kanejax; `python -m experiments.thesis`."""

import jax

# The thesis computes in double precision.
jax.config.update("jax_enable_x64", True)
