"""How public functions reach the kernels: check, prepare the parameters of the links once, call the batching primitive."""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
from jax.core import Tracer

from kanejax import _batching
from kanejax._model.model import Model
from kanejax._model.prepared import Prepared, batch_shape, prepare
from kanejax._model.specialized import PartlyPrepared, Specialized
from kanejax._model.tree import Tree


def check_state(model: Model | Specialized, **state: Any) -> None:
    """Compare shapes and data types of a state with the model's.

    Raises:
        ValueError: naming the argument, its shape or type, and what it should be.
    """
    for name, value in state.items():
        size = model.nq if name == "q" else model.nv
        if not hasattr(value, "dtype"):
            raise ValueError(f"{name} is a {type(value).__name__}, but must be an array: jnp.asarray({name})")
        shape, dtype = jnp.shape(value), value.dtype
        if shape != (size,):
            label = "nq" if name == "q" else "nv"
            hint = " (batches go through jax.vmap)" if len(shape) > 1 else ""
            raise ValueError(f"{name} has shape {shape}, but this model needs ({size},) = ({label},){hint}")
        if dtype not in (jnp.float32, jnp.float64):
            raise ValueError(f"{name} has dtype {dtype}; use float32 or float64")
        if dtype != model.dtype:
            raise ValueError(f"{name} has dtype {dtype}, but the model has {model.dtype}; convert one, e.g. model.astype({dtype})")


def evaluate(function: Callable[..., Any], model: Model | Specialized, *state: jax.Array) -> Any:
    """Evaluate the kernel `function(tree, prepared, *state)`, which is written for trailing batch axes."""
    return evaluate_prepared(function, model.tree, prepare_once(model), *state)


def prepare_once(model: Model | Specialized) -> Prepared | PartlyPrepared:
    """What `evaluate_prepared` needs of a model; constants, if the leaves are, so that no program computes them again."""
    if any(isinstance(leaf, Tracer) for leaf in jax.tree.leaves(model)):
        return _prepare(model)
    with jax.ensure_compile_time_eval():
        return _prepare_now(model)


def _prepare(model: Model | Specialized) -> Prepared | PartlyPrepared:
    return model.prepare() if isinstance(model, Specialized) else prepare(model)


_prepare_now = jax.jit(_prepare)


def evaluate_prepared(function: Callable[..., Any], tree: Tree, prepared: Prepared | PartlyPrepared, *state: jax.Array) -> Any:
    """The same with parameters that were prepared before, for many evaluations on one model."""
    operands, structure = jax.tree.flatten((prepared, tuple(jnp.asarray(x) for x in state)))
    results = _batching.call(_unflatten, (function, tree, structure), tuple(operands))
    return results[0] if len(results) == 1 else tuple(results)


def _unflatten(function: Callable, tree: Tree, structure: Any, *operands: jax.Array) -> tuple:
    prepared, state = jax.tree.unflatten(structure, operands)
    own = prepared.kept if isinstance(prepared, PartlyPrepared) else prepared
    batch = jnp.broadcast_shapes(batch_shape(own), *(x.shape[1:] for x in state))
    if isinstance(prepared, PartlyPrepared):
        prepared = prepared.constants.join(prepared.kept, state[0])
    result = function(tree, prepared, *(jnp.broadcast_to(x, x.shape[:1] + batch) for x in state))
    # A plain one, also of named parts: cotangents come as that.
    return tuple(result) if isinstance(result, tuple) else (result,)
