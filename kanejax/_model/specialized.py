"""Models of which parameters are constants: the fastest code, compiled for one mechanism."""

from collections.abc import Iterable
from typing import Any, NamedTuple, final

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer

from kanejax._errors import UnknownNameError
from kanejax._model.model import Model, leaf_shapes
from kanejax._model.prepared import Prepared, prepare
from kanejax._model.tree import OnTree, Tree

# Entries of rotations as near as rounding leaves them to -1, 0 and 1 are taken for exactly that.
ROUNDING = {jnp.dtype(jnp.float32): 2e-6, jnp.dtype(jnp.float64): 1e-12}


@final
@jax.tree_util.register_static
class Constants:
    """A model and its prepared parameters, None in place of those that are not frozen. Equal only to itself."""

    def __init__(self, model: Model, prepared: Prepared) -> None:
        self.model, self.prepared = model, prepared

    def join(self, kept: Prepared, like: jax.Array) -> Prepared:
        """All parameters, for states of the data type and batch of `like`.

        Those of the links stay in float64, and become known numbers where the recursions are unrolled.
        """
        links, gravity, *rest = self.prepared
        trailing = (1,) * (like.ndim - 1)
        known = None if gravity is None else tuple(float(g) for g in gravity)
        columns = (None if x is None else jnp.asarray(x, like.dtype).reshape(x.shape + trailing) for x in rest)
        return eqx.combine(kept, Prepared(links, known, *columns), is_leaf=lambda x: x is None)  # type: ignore[arg-type]


class PartlyPrepared(NamedTuple):
    """Prepared parameters, None in place of those that are constants; and these."""

    kept: Prepared
    constants: Constants


@final
class Specialized(eqx.Module, OnTree):
    """A model with frozen parameters, accepted in place of a model by the equations of motion (`inverse_dynamics`,
    `forward_dynamics`, `mass_matrix`, forces), `kinetic_energy`, `coordinate_rates`, `tangent_gradient` and the simulations.

    Attributes:
        kept: the leaves that are not frozen, by name: to differentiate, to batch and to `replace`.
        tree: as of the model.
        dtype: data type of the leaves.
    """

    kept: dict[str, jax.Array]
    tree: Tree = eqx.field(static=True)
    dtype: Any = eqx.field(static=True)
    _constants: Constants = eqx.field(static=True)

    def replace(self, **leaves: Any) -> "Specialized":
        """The same with other values of kept leaves, converted to its data type.

        Raises:
            UnknownNameError: a leaf is not kept; the message lists those that are.
            ValueError: a shape does not fit the tree.
        """
        for name in leaves:
            if name not in self.kept:
                raise UnknownNameError("kept leaf", name, self.kept)
        changed = self._constants.model.replace(**leaves)
        return eqx.tree_at(lambda s: s.kept, self, self.kept | {name: getattr(changed, name) for name in leaves})

    def prepare(self) -> PartlyPrepared:
        """What the recursions need: constants, and what depends on leaves that were kept."""
        constants = self._constants
        if not self.kept:
            return PartlyPrepared(jax.tree.map(lambda _: None, constants.prepared), constants)
        names = list(self.kept)
        model = eqx.tree_at(lambda m: [getattr(m, name) for name in names], constants.model, [self.kept[name] for name in names])
        frozen = jax.tree.map(lambda x: x is not None, constants.prepared, is_leaf=lambda x: x is None)
        return PartlyPrepared(jax.tree.map(lambda x, is_frozen: None if is_frozen else x, prepare(model), frozen), constants)


def specialize(model: Model, keep: Iterable[str] = ()) -> Specialized:
    """Freeze parameters of a model as constants.

    Products with zeros and ones among them, such as those of axes and placements along the coordinate directions, are
    left out of the compiled code. Each specialized model compiles anew, compile time grows with the number of links, and
    compiled functions keep it in memory.

    Args:
        model: the mechanism.
        keep: names of leaves that stay parameters, such as ("mass", "com", "central_inertia") for identification.

    Raises:
        UnknownNameError: a model has no such leaf; the message lists those it has.
        ValueError: a leaf is traced or batched; specialize outside of `jax.jit`, `jax.vmap` and `jax.grad`.
    """
    if any(isinstance(leaf, Tracer) for leaf in jax.tree.leaves(model)):
        raise ValueError("a model under jit, vmap or grad has no values to freeze; specialize it outside of them")
    shapes = leaf_shapes(model.tree)
    for name in (keep := tuple(keep)):
        if name not in shapes:
            raise UnknownNameError("leaf of a model", name, shapes)
    with jax.ensure_compile_time_eval():
        values = _values(model)
        # What depends on a kept leaf is not a number where that is none.
        depends = _values(model.replace(**{name: jnp.full(shapes[name], jnp.nan) for name in keep}))
    known = jax.tree.map(lambda x, y: None if np.any(np.isnan(y) & ~np.isnan(x)) else x, values, depends)
    return Specialized({name: getattr(model, name) for name in keep}, model.tree, model.dtype, Constants(model, known))


def _values(model: Model) -> Prepared:
    prepared = jax.tree.map(lambda x: np.asarray(x, np.float64), prepare(model))
    rotation = prepared.links.rotation
    whole = np.round(rotation)
    snapped = np.where(np.abs(rotation - whole) < ROUNDING[model.dtype], whole, rotation)
    return prepared._replace(links=prepared.links._replace(rotation=snapped))
