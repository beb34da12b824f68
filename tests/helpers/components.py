"""Gradients component by component, as references for reverse mode."""

from collections.abc import Callable
from typing import Any

import jax
import numpy as np


def gradient(slope: Callable[[Any], Any], point: Any) -> Any:
    """From a scalar function's slopes along unit directions, which have the structure of `point`: one program for all of them."""
    leaves, structure = jax.tree.flatten(point)
    found = [np.zeros(x.shape) for x in leaves]
    for leaf, slopes in enumerate(found):
        for component in np.ndindex(slopes.shape):
            unit = [np.zeros(x.shape) for x in leaves]
            unit[leaf][component] = 1.0
            slopes[component] = slope(jax.tree.unflatten(structure, unit))
    return jax.tree.unflatten(structure, found)
