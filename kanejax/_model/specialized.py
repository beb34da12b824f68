"""Models of which parameters are constants: the fastest code, compiled for one mechanism."""

from collections.abc import Iterable
from typing import Any, NamedTuple, final

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer

from kanejax._errors import UnknownNameError
from kanejax._model.links import LinkParameters, Rows
from kanejax._model.model import Model, leaf_shapes
from kanejax._model.prepared import Prepared, prepare
from kanejax._model.tree import OnTree, Tree

# Entries of rotations as near as rounding leaves them to -1, 0 and 1 are taken for exactly that; so are zeros of positions and
# moments, relative to their size.
ROUNDING = {jnp.dtype(jnp.float32): 2e-6, jnp.dtype(jnp.float64): 1e-12}

# Parameters that are the number 0 where none of them differs from it: what is multiplied by them is not computed.
MAY_VANISH = ("armature", "damping", "stiffness", "coordinate_reference", "coulomb_friction")


@final
@jax.tree_util.register_static
class Constants:
    """A model and its prepared parameters, None in place of those that are not frozen. Equal only to itself."""

    def __init__(self, model: Model, prepared: Prepared) -> None:
        self.model: Model = model
        self.prepared: Prepared = prepared

    def join(self, kept: Prepared, like: jax.Array) -> Prepared:
        """All parameters, for states of the data type and batch of `like`.

        Those of the links stay in float64, and become known numbers where the recursions are unrolled.
        """
        trailing = (1,) * (like.ndim - 1)

        def column(name: str, x: np.ndarray | None) -> Any:
            if x is None or (name in MAY_VANISH and not np.any(x)):
                return x if x is None else 0.0
            return jnp.asarray(x, like.dtype).reshape(x.shape + trailing)

        gravity = self.prepared.gravity
        columns = {name: column(name, getattr(self.prepared, name)) for name in Prepared._fields[2:]}
        down: Any = None if gravity is None else tuple(float(g) for g in gravity)
        known = Prepared(self.prepared.links, down, **columns)
        return eqx.combine(kept, known, is_leaf=lambda x: x is None)  # type: ignore[arg-type]


class PartlyPrepared(NamedTuple):
    """Prepared parameters, None in place of those that are constants; and these."""

    kept: Prepared
    constants: Constants


@final
class Specialized(eqx.Module, OnTree):
    """A model with frozen parameters, accepted in place of a model by the equations of motion (`inverse_dynamics`,
    `forward_dynamics`, `mass_matrix`, forces), energies, momentum, `center_of_mass`, `poses`, partial velocities, external forces,
    `joint_reactions`, `coordinate_rates`, `tangent_gradient` and the simulations.

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
        frozen = jax.tree.map(lambda x: x is not None, constants.prepared, is_leaf=lambda x: x is None)
        return PartlyPrepared(jax.tree.map(lambda x, is_frozen: None if is_frozen else x, prepare(whole(self)), frozen), constants)


def whole(model: Model | Specialized) -> Model:
    """The model itself; of a specialized one, what it was made from, with the kept leaves as they are now."""
    if not isinstance(model, Specialized):
        return model
    frozen, names = model._constants.model, list(model.kept)
    return eqx.tree_at(lambda m: [getattr(m, name) for name in names], frozen, [*model.kept.values()]) if names else frozen


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
        values, depends = _values(model), _depends(model, keep)
        if not any(jax.tree.leaves(depends.links)):
            values = _values(model, upright=_without_first_moment(model.tree, values.links))
    known = jax.tree.map(lambda x, is_kept: None if is_kept else x, values, depends)
    return Specialized({name: getattr(model, name) for name in keep}, model.tree, model.dtype, Constants(model, known))


def _values(model: Model, upright: tuple[bool, ...] = ()) -> Prepared:
    prepared = jax.tree.map(lambda x: np.asarray(x, np.float64), prepare(model, upright))
    rounding, links = ROUNDING[model.dtype], prepared.links
    whole_numbers = np.round(links.rotation)
    rotation = np.where(np.abs(links.rotation - whole_numbers) < rounding, whole_numbers, links.rotation)
    position, first, second = (_without_rounding(x, rounding) for x in (links.position, links.first_moment, links.second_moment))
    return prepared._replace(links=links._replace(rotation=rotation, position=position, first_moment=first, second_moment=second))


def _without_rounding(rows: Rows, rounding: float) -> np.ndarray:
    """Rows with 0 for what is as small as rounding, beside the largest number of its row and far more so beside that of all."""
    sizes = np.abs(rows)
    scale = np.maximum(sizes.max(1, keepdims=True, initial=0.0), 1e-3 * sizes.max(initial=0.0))
    return np.where(sizes < rounding * scale, 0.0, rows)


def _depends(model: Model, keep: tuple[str, ...]) -> Prepared:
    """What depends on a kept leaf: it is not a number where that is none."""
    shapes = leaf_shapes(model.tree)
    without = model.replace(**{name: jnp.full(shapes[name], jnp.nan) for name in keep})
    return jax.tree.map(lambda x, y: bool(np.any(np.isnan(y) & ~np.isnan(x))), prepare(model), prepare(without))


def _without_first_moment(tree: Tree, links: LinkParameters) -> tuple[bool, ...]:
    """Links that turn, and of which regrouping leaves no first moment."""
    return tuple(kind == "revolute" and not np.any(h) for kind, h in zip(tree.joint_types, links.first_moment, strict=True))
