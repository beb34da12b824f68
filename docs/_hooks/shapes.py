"""Shapes of arrays in annotations, as they are written: `Float[Array, "nbody 3"]`, not names that griffe takes them for."""

import ast
from typing import Any

import griffe


class Shapes(griffe.Extension):
    """Griffe reads strings in annotations as annotations; those of jaxtyping are shapes."""
