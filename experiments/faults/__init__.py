"""Numerical trouble, measured: each module is an experiment with a function `run(directory)`."""

import jax

# Both precisions are compared.
jax.config.update("jax_enable_x64", True)
