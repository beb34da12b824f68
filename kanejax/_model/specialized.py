"""Models whose parameters are constants: the fastest code, compiled for one mechanism."""

from typing import final

import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer

from kanejax._model.links import LinkParameters
from kanejax._model.model import Model
from kanejax._model.prepared import Prepared, prepare
from kanejax._model.tree import Tree

# Entries of rotations within rounding of -1, 0 and 1 are taken for exactly that.
ROUNDING = 1e-12


@final
@jax.tree_util.register_static
class Specialized:
    """A model with all parameters frozen, accepted in place of a model by the functions of the dynamics.

    It has no leaves: nothing to differentiate, batch or change. Two of them are equal only if they are the same object.
    """

    def __init__(self, tree: Tree, dtype: np.dtype, prepared: Prepared) -> None:
        self.tree = tree
        self.dtype = dtype
        self._prepared = prepared

    @property
    def nq(self) -> int:
        """Number of generalized coordinates."""
        return self.tree.nq

    @property
    def nv(self) -> int:
        """Number of generalized speeds."""
        return self.tree.nv

    @property
    def nbody(self) -> int:
        """Number of bodies, the world not counted."""
        return self.tree.nbody

    def constants(self, like: jax.Array) -> Prepared:
        """Parameters as constants, for states of the data type and batch of `like`.

        Those of the links stay in float64, and become known numbers where the recursions are unrolled.
        """
        links, gravity, *rest = self._prepared
        trailing = (1,) * (like.ndim - 1)
        columns = (jnp.asarray(x, like.dtype).reshape(x.shape + trailing) for x in rest)
        return Prepared(links, tuple(float(g) for g in gravity), *columns)  # type: ignore[arg-type]


def specialize(model: Model) -> Specialized:
    """Freeze all parameters of a model as constants.

    Products with zeros and ones among them, such as those of axes and placements along the coordinate directions, are
    left out of the compiled code. Each specialized model compiles anew, and compile time grows with the number of links.

    Raises:
        ValueError: a leaf is traced or batched; specialize outside of `jax.jit`, `jax.vmap` and `jax.grad`.
    """
    if any(isinstance(leaf, Tracer) for leaf in jax.tree.leaves(model)):
        raise ValueError("a model under jit, vmap or grad has no values to freeze; specialize it outside of them")
    with jax.ensure_compile_time_eval():
        prepared = jax.tree.map(lambda x: np.asarray(x, np.float64), prepare(model))
    links = LinkParameters(*(_snapped(x) if name == "rotation" else x for name, x in prepared.links._asdict().items()))
    return Specialized(model.tree, model.dtype, prepared._replace(links=links))


def _snapped(x: np.ndarray) -> np.ndarray:
    whole = np.round(x)
    return np.where(np.abs(x - whole) < ROUNDING, whole, x)
