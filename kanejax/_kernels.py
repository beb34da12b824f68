"""What the batching primitive evaluates: functions for one state or for a batch, and their derivatives.

A kernel is a pure function of arrays that may have one trailing batch axis, of size 1 or of the batch's size. Tangents and
transposes are kernels again, so that derivatives of any order are.
"""

import dataclasses
import functools
from collections.abc import Callable
from typing import Any, final

import jax
import jax.numpy as jnp

Arrays = tuple[jax.Array, ...]
Indices = tuple[int, ...]
Shapes = tuple[jax.ShapeDtypeStruct, ...]


@final
@dataclasses.dataclass(frozen=True)
class Function:
    """A kernel from a function and its static arguments."""

    function: Callable[..., Arrays]
    static: tuple

    def __call__(self, *operands: jax.Array) -> Arrays:
        """Evaluate."""
        return self.function(*self.static, *operands)

    def shapes(self, operands: Shapes) -> Shapes:
        """Of the results for one state: found by tracing, once."""
        return _traced_shapes(self, operands)

    def linear_operands(self, total: int) -> Indices:
        """Operands in which the results are linear, jointly: none."""
        return ()

    def owners(self, total: int) -> Indices | None:
        """The operand that each result is a gradient of: none."""
        return None

    @property
    def width(self) -> int:
        """Directions side by side."""
        return 1


@final
@dataclasses.dataclass(frozen=True)
class Tangent:
    """Directional derivative of a kernel: operands are its own, `count` of them, then the tangents of those in `varied`."""

    kernel: Any
    varied: Indices
    count: int

    def __call__(self, *operands: jax.Array) -> Arrays:
        """Evaluate."""
        along, at = _vary(self, operands)
        # Of an operand and its tangent, one may be shared by the batch.
        pairs = [jnp.broadcast_arrays(x, t) for x, t in zip(at, operands[self.count :], strict=True)]
        return jax.jvp(along, tuple(x for x, _ in pairs), tuple(t for _, t in pairs))[1]

    def shapes(self, operands: Shapes) -> Shapes:
        """Those of the kernel's results."""
        return self.kernel.shapes(operands[: self.count])

    def linear_operands(self, total: int) -> Indices:
        """The tangents, and what the kernel is linear in."""
        return (*self.kernel.linear_operands(self.count), *range(self.count, total))

    def owners(self, total: int) -> Indices | None:
        """Those of the kernel."""
        return self.kernel.owners(self.count)

    @property
    def width(self) -> int:
        """That of the kernel."""
        return self.kernel.width

    def transposed(self, unknown: Indices, total: int, results: int) -> tuple["Transpose", Indices]:
        """The kernel that pulls cotangents of the `results` back to the `unknown` tangents, and these, to which they belong."""
        return Transpose(self.kernel, tuple(self.varied[i - self.count] for i in unknown), self.count), unknown


@final
@dataclasses.dataclass(frozen=True)
class Transpose:
    """Transposed derivative of a kernel: operands are its own, then the cotangents of its results; results are gradients."""

    kernel: Any
    varied: Indices
    count: int

    def __call__(self, *operands: jax.Array) -> Arrays:
        """Evaluate."""
        along, at = _vary(self, operands)
        results, pull_back = jax.vjp(along, *at)
        cotangents = zip(operands[self.count :], results, strict=True)
        return pull_back(tuple(jnp.broadcast_to(c, r.shape) for c, r in cotangents))

    def shapes(self, operands: Shapes) -> Shapes:
        """Those of what the gradients are of."""
        return tuple(operands[i] for i in self.varied)

    def linear_operands(self, total: int) -> Indices:
        """The cotangents, and what the kernel is linear in."""
        return (*self.kernel.linear_operands(self.count), *range(self.count, total))

    def owners(self, total: int) -> Indices | None:
        """The operands that are varied."""
        return self.varied

    @property
    def width(self) -> int:
        """That of the kernel."""
        return self.kernel.width

    def transposed(self, unknown: Indices, total: int, results: int) -> tuple["Tangent", Indices]:
        """The kernel that pushes tangents forward, and the operands to which its results belong: all cotangents."""
        return Tangent(self.kernel, self.varied, self.count), tuple(range(self.count, total))


@final
@dataclasses.dataclass(frozen=True)
class Fan:
    """A derivative in several directions at one point, which come first in results and in operands that are `widened`."""

    kernel: "Tangent | Transpose | Fan"
    widened: Indices
    directions: int

    def __call__(self, *operands: jax.Array) -> Arrays:
        """Evaluate."""
        axes = tuple(0 if i in self.widened else None for i in range(len(operands)))
        return jax.vmap(self.kernel.__call__, axes)(*operands)

    def shapes(self, operands: Shapes) -> Shapes:
        """Those of the derivative, with the directions first."""
        one = tuple(jax.ShapeDtypeStruct(x.shape[i in self.widened :], x.dtype) for i, x in enumerate(operands))
        return tuple(jax.ShapeDtypeStruct((self.directions, *x.shape), x.dtype) for x in self.kernel.shapes(one))

    def linear_operands(self, total: int) -> Indices:
        """Those of the derivative."""
        return self.kernel.linear_operands(total)

    def owners(self, total: int) -> Indices | None:
        """Those of the derivative."""
        return self.kernel.owners(total)

    @property
    def count(self) -> int:
        """Operands that make up the point."""
        return self.kernel.count

    @property
    def width(self) -> int:
        """All directions side by side, also those of fans within."""
        return self.directions * self.kernel.width

    def transposed(self, unknown: Indices, total: int, results: int) -> tuple["Fan", Indices]:
        """That of the derivative, in all directions: also gradients of operands that these share, which are to be added up."""
        flipped, wanted = self.kernel.transposed(unknown, total, results)
        return Fan(flipped, tuple(range(self.count, self.count + results)), self.directions), wanted


def copied_operands(kernel: Any, total: int, summed: tuple) -> set[int]:
    """Operands of which every member of the batch needs a copy, to have a gradient of its own with respect to them."""
    owners = kernel.owners(total) or ()
    found = {owner for owner, adds in zip(owners, summed, strict=True) if not adds} if owners else set()
    while not isinstance(kernel, Function):
        inner = kernel.kernel
        if isinstance(kernel, Transpose):
            # What is transposed are the gradients of each member, where the kernel's results are gradients.
            found |= set(inner.owners(kernel.count) or ())
        kernel = inner
    return found


def of_shared(kernel: Any, i: int, gradient: jax.Array, axis: int) -> jax.Array:
    """Gradient of operand i from those in all directions, which start at an axis: their sum, where these share the operand."""
    while isinstance(kernel, Fan):
        if i in kernel.widened:
            axis += 1
        else:
            gradient = jnp.sum(gradient, axis)
        kernel = kernel.kernel
    return gradient


@functools.lru_cache(maxsize=1024)
def _traced_shapes(kernel: Function, operands: Shapes) -> Shapes:
    return tuple(jax.ShapeDtypeStruct(x.shape, x.dtype) for x in jax.eval_shape(kernel, *operands))


def _vary(derivative: Tangent | Transpose, operands: Arrays) -> tuple[Callable[..., Arrays], Arrays]:
    """The kernel as a function of the varied operands alone, and their values."""

    def along(*varied: jax.Array) -> Arrays:
        full = list(operands[: derivative.count])
        for i, x in zip(derivative.varied, varied, strict=True):
            full[i] = x
        return derivative.kernel(*full)

    return along, tuple(operands[i] for i in derivative.varied)
