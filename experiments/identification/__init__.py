"""Identification of robots: each module is an experiment with a function `run(directory)`."""

import jax

# Regressors and their condition numbers are studied in double precision.
jax.config.update("jax_enable_x64", True)
