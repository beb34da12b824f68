"""Kane's equations of a serial chain, generated in scalar form for the angular velocity of any link as generalized speeds.

Nie chose the angular velocity of a link in the middle by hand, (2.18), and left it out of his automatic generation. Here it is
generated: angular velocities, partial angular velocities and angular accelerations start at the base link, where they are the
speeds themselves, known ones and zeros, and spread from there to both sides. Products with known zeros and ones are not traced.
Each link's frame has its z axis along its own joint, as `kanejax.poses` gives it.
"""

from collections.abc import Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

import kanejax as kj
from kanejax._scalar import ZERO, add, apply, apply_transposed, cross, dot, is_known, minus, mul, plus, scale, sub

Scalar = Any
Vector = tuple[Scalar, Scalar, Scalar]
Z: Vector = (0.0, 0.0, 1.0)
ROUNDING = 1e-12


class ChainLink(NamedTuple):
    """Numbers of one link in its own frame; rotation and position are to the frame of the link before."""

    slides: bool
    rotation: tuple
    position: Vector
    mass: float
    com: Vector
    inertia: tuple


class Chain(NamedTuple):
    """A serial chain of revolute and prismatic joints; gravity in the axes of the base."""

    links: tuple[ChainLink, ...]
    gravity: Vector


class Base(NamedTuple):
    """Components of the angular velocity of link `link` in place of the rates of the joints `replaced`.

    Three of them along x, y and z; two, where only two joints turn the link, along `component` and z.
    """

    link: int
    replaced: tuple[int, ...]
    component: int = 0

    @property
    def components(self) -> tuple[int, ...]:
        """The component in place of each rate."""
        return (0, 1, 2) if len(self.replaced) == 3 else (self.component, 2)


class Frame(NamedTuple):
    """Where a link is in the frame of the one before."""

    link: ChainLink
    sine: Scalar
    cosine: Scalar
    position: Vector

    def inward(self, a: Vector) -> Vector:
        """Components in the frame before."""
        turned = (sub(mul(self.cosine, a[0]), mul(self.sine, a[1])), add(mul(self.sine, a[0]), mul(self.cosine, a[1])), a[2])
        return apply(self.link.rotation, turned)

    def outward(self, a: Vector) -> Vector:
        """Components in the own frame."""
        x, y, z = apply_transposed(self.link.rotation, a)
        return (add(mul(self.cosine, x), mul(self.sine, y)), sub(mul(self.cosine, y), mul(self.sine, x)), z)


def chain_of(model: kj.Model) -> Chain:
    """The numbers of a model, with what rounding leaves of zeros and ones made exact.

    Raises:
        ValueError: it is no serial chain of revolute and prismatic joints without rotors, springs, damping and friction.
    """
    tree = model.tree
    serial = tree.body_parents == tuple(range(-1, model.nbody - 1)) and tree.joint_bodies == tuple(range(model.nbody))
    if not serial or set(tree.joint_types) - {"revolute", "prismatic"}:
        raise ValueError(f"{tree.body_names} is no serial chain of revolute and prismatic joints, one a link")
    for name in ("armature", "damping", "stiffness", "coulomb_friction", "coordinate_reference"):
        if np.any(getattr(model, name)):
            raise ValueError(f"the model has {name}, which the generated equations leave out")
    at = kj.poses(model, jnp.zeros(model.nq, model.dtype))
    turn, origin = np.asarray(at.link_rotation), np.asarray(at.link_origin)
    before_turn, before_origin = np.concatenate((np.eye(3)[None], turn[:-1])), np.concatenate((np.zeros((1, 3)), origin[:-1]))
    links = []
    for k, kind in enumerate(tree.joint_types):
        body = turn[k].T @ np.asarray(at.rotation[k])
        links.append(
            ChainLink(
                kind == "prismatic",
                _numbers(before_turn[k].T @ turn[k]),
                _numbers(before_turn[k].T @ (origin[k] - before_origin[k])),
                float(model.mass[k]),
                _numbers(turn[k].T @ (np.asarray(at.com[k]) - origin[k])),
                _numbers(body @ np.asarray(model.central_inertia[k]) @ body.T),
            )
        )
    return Chain(tuple(links), _numbers(np.asarray(model.gravity)))


def _numbers(array: np.ndarray) -> tuple:
    near = np.round(array)
    array = np.where(np.abs(array - near) < ROUNDING, near, array)
    return tuple(_numbers(row) if array.ndim > 1 else float(row) for row in array)


def frames_of(chain: Chain, q: jax.Array) -> list[Frame]:
    """Placements of the links at coordinates q."""
    frames = []
    for k, link in enumerate(chain.links):
        slide = scale(q[k] if link.slides else 0.0, tuple(row[2] for row in link.rotation))
        sine, cosine = (0.0, 1.0) if link.slides else (jnp.sin(q[k]), jnp.cos(q[k]))
        frames.append(Frame(link, sine, cosine, plus(link.position, slide)))
    return frames


class Spread(NamedTuple):
    """Rates of the joints, and an angular vector of each link in its own frame."""

    rates: list[Scalar]
    vectors: list[Vector]


def spread(frames: list[Frame], base: Base | None, speeds: Sequence[Scalar], extra: Sequence[Vector]) -> Spread:
    """Angular velocities of all links from the speeds; or accelerations from their rates, or partials from ones and zeros.

    The vector of a link is that of the link before, the rate of the joint along z, and what `extra` says; in the frame of the base
    link its components are the speeds of the replaced joints.
    """
    rates = [0.0 if base is not None and k in base.replaced else speed for k, speed in enumerate(speeds)]
    if base is None:
        return Spread(rates, _outward(frames, rates, extra, ZERO))
    s, own = base.replaced[-1], [speeds[k] for k in base.replaced]
    if len(own) == 3:
        vectors: dict[int, Vector] = {base.link: (own[0], own[1], own[2])}
        for k in range(base.link, s, -1):
            vectors[k - 1] = frames[k].inward(minus(minus(vectors[k], _turn(frames[k], rates[k])), extra[k]))
        hat = frames[s].inward(minus(vectors[s], extra[s]))
        known = _outward(frames[:s], rates, extra, ZERO)[-1]
        found, own_vector = _solve_three(frames, base, minus(hat, known))
        vectors[s - 1] = plus(known, own_vector)
        first = s - 1
    else:
        known = _outward(frames[: s + 1], rates, extra, ZERO)[-1]
        found, vectors = _solve_two(frames, base, own, known)
        first = s
    rates = [found.get(k, rate) for k, rate in enumerate(rates)]
    inner = _outward(frames[:first], rates, extra, ZERO)
    middle = [vectors[k] for k in range(first, base.link + 1)]
    rest = slice(base.link + 1, None)
    return Spread(rates, inner + middle + _outward(frames[rest], rates[rest], extra[rest], middle[-1]))


def _turn(frame: Frame, rate: Scalar) -> Vector:
    return (0.0, 0.0, 0.0 if frame.link.slides else rate)


def _outward(frames: Sequence[Frame], rates: Sequence[Scalar], extra: Sequence[Vector], start: Vector) -> list[Vector]:
    vectors = []
    for frame, rate, more in zip(frames, rates, extra, strict=False):
        start = plus(frame.outward(start), _turn(frame, rate), more)
        vectors.append(start)
    return vectors


def _axis(frames: list[Frame], joint: int, last: int) -> Vector:
    """The axis of a joint in the frame of a link further out."""
    axis = Z
    for k in range(joint + 1, last + 1):
        axis = frames[k].outward(axis)
    return axis


def _solve_three(frames: list[Frame], base: Base, vector: Vector) -> tuple[dict[int, Scalar], Vector]:
    """Rates along three axes that make up a vector, in the frame before the last of them; and the vector without that last one.

    That axis is constant there, and across it two equations are left for the other two rates.
    """
    first, second, last = base.replaced
    along = tuple(row[2] for row in frames[last].link.rotation)
    a, b = _axis(frames, first, last - 1), _axis(frames, second, last - 1)
    across = [_numbers(row) for row in np.linalg.svd(np.array(along)[None])[2][1:]]
    x, y = _eliminate([[dot(e, a), dot(e, b)] for e in across], [dot(e, vector) for e in across])
    part = add(mul(dot(along, a), x), mul(dot(along, b), y))
    projection = _numbers(np.eye(3) - np.outer(along, along))
    return {first: x, second: y, last: sub(dot(along, vector), part)}, plus(apply(projection, vector), scale(part, along))


def _eliminate(matrix: list[list[Scalar]], right: list[Scalar]) -> tuple[Scalar, Scalar]:
    """Two unknowns; a known zero, if there is one, saves the elimination."""
    for row in (0, 1):
        for column in (0, 1):
            if is_known(matrix[row][column]) and matrix[row][column] == 0:
                lone = mul(right[row], _inverse(matrix[row][1 - column]))
                rest = sub(right[1 - row], mul(matrix[1 - row][1 - column], lone))
                other = mul(rest, _inverse(matrix[1 - row][column]))
                return (lone, other) if column else (other, lone)
    (a, b), (c, d) = matrix
    inverse = _inverse(sub(mul(a, d), mul(b, c)))
    first = mul(sub(mul(d, right[0]), mul(b, right[1])), inverse)
    return first, mul(sub(mul(a, right[1]), mul(c, right[0])), inverse)


def _inverse(x: Scalar) -> Scalar:
    return 1.0 / x


def _solve_two(
    frames: list[Frame], base: Base, own: Sequence[Scalar], known: Vector
) -> tuple[dict[int, Scalar], dict[int, Vector]]:
    """Rates of two joints from two components of the last link's vector, and this vector."""
    first, last = base.replaced
    axis, c = _axis(frames, first, last), base.component
    x = mul(sub(own[0], known[c]), _inverse(axis[c]))
    other = add(mul(axis[1 - c], x), known[1 - c])
    found = {first: x, last: sub(sub(own[1], known[2]), mul(axis[2], x))}
    return found, {last: (other, own[0], own[1]) if c else (own[0], other, own[1])}


class Motion(NamedTuple):
    """Rates of the joints, and motion of each link in its frame: angular velocity, its acceleration, the mass centre's."""

    rates: list[Scalar]
    w: list[Vector]
    alpha: list[Vector]
    a: list[Vector]


def motion_of(chain: Chain, frames: list[Frame], base: Base | None, u: Sequence[Scalar], u_dot: Sequence[Scalar]) -> Motion:
    """Velocities and accelerations from the speeds and their rates; the accelerations contain minus gravity."""
    rates, w = spread(frames, base, u, [ZERO] * len(frames))
    extra = [cross(own, _turn(frame, rate)) for own, frame, rate in zip(w, frames, rates, strict=True)]
    second, alpha = spread(frames, base, u_dot, extra)
    origin, field, a = tuple(-g for g in chain.gravity), (ZERO, ZERO, ZERO), []
    for k, frame in enumerate(frames):
        origin = frame.outward(plus(origin, apply(field, frame.position)))
        if frame.link.slides:
            origin = plus(origin, scale(2.0, cross(w[k], (0.0, 0.0, rates[k]))), (0.0, 0.0, second[k]))
        field = _acceleration_field(w[k], alpha[k])
        a.append(plus(origin, apply(field, frame.link.com)))
    return Motion(rates, w, alpha, a)


def _acceleration_field(w: Vector, alpha: Vector) -> tuple[Vector, Vector, Vector]:
    """The matrix [alpha x] + [w x][w x], which a point's position is multiplied by."""
    (x, y, z), (p, q, r) = w, alpha
    xx, yy, zz, xy, xz, yz = mul(x, x), mul(y, y), mul(z, z), mul(x, y), mul(x, z), mul(y, z)
    return (
        (sub(0.0, add(yy, zz)), sub(xy, r), add(xz, q)),
        (add(xy, r), sub(0.0, add(xx, zz)), sub(yz, p)),
        (sub(xz, q), add(yz, p), sub(0.0, add(xx, yy))),
    )


def _wrench(link: ChainLink, w: Vector, alpha: Vector, a: Vector) -> tuple[Vector, Vector]:
    """Force and moment about the mass centre that a motion takes."""
    return scale(link.mass, a), plus(apply(link.inertia, alpha), cross(w, apply(link.inertia, w)))


class Explicit(NamedTuple):
    """X and Y of X u_dot + Y = W^T tau, Nie's (2.57) and (3.56): Y has the gravity in it. And q_dot."""

    X: jax.Array
    Y: jax.Array
    rates: jax.Array


def explicit_equations(chain: Chain, base: Base | None, q: jax.Array, u: jax.Array) -> Explicit:
    """Kane's equations from the partial velocities of every body, as the thesis derives them by hand."""
    frames, n = frames_of(chain, q), len(chain.links)
    motion = motion_of(chain, frames, base, [u[k] for k in range(n)], [0.0] * n)
    X: list[list[Scalar]] = [[0.0] * n for _ in range(n)]
    Y: list[Scalar] = [0.0] * n
    partials = [_partials(frames, base, r) for r in range(n)]
    for k, link in enumerate(chain.links):
        force, moment = _wrench(link, motion.w[k], motion.alpha[k], motion.a[k])
        for s in range(n):
            w, v = partials[s][0][k], partials[s][1][k]
            spin, momentum = apply(link.inertia, w), scale(link.mass, v)
            Y[s] = plus((Y[s],), (dot(w, moment),), (dot(v, force),))[0]
            for r in range(s + 1):
                X[r][s] = plus((X[r][s],), (dot(partials[r][0][k], spin),), (dot(partials[r][1][k], momentum),))[0]
    full = [[X[min(r, s)][max(r, s)] for s in range(n)] for r in range(n)]
    return Explicit(_array(full, q), _array(Y, q), _array(motion.rates, q))


def _partials(frames: list[Frame], base: Base | None, r: int) -> tuple[list[Vector], list[Vector]]:
    """Partial angular velocities of the links and partial velocities of their mass centres for one speed."""
    n = len(frames)
    rates, angular = spread(frames, base, [float(k == r) for k in range(n)], [ZERO] * n)
    origin, linear, before = ZERO, [], ZERO
    for k, frame in enumerate(frames):
        origin = frame.outward(plus(origin, cross(before, frame.position)))
        if frame.link.slides:
            origin = plus(origin, (0.0, 0.0, rates[k]))
        before = angular[k]
        linear.append(plus(origin, cross(before, frame.link.com)))
    return angular, linear


def equations_of_simulation(chain: Chain, base: Base | None, q: jax.Array, u: jax.Array, tau: jax.Array) -> tuple:
    """X, what X u_dot is, and q_dot: all that an integration needs besides the solution of the linear equations."""
    X, Y, rates = explicit_equations(chain, base, q, u)
    frames, n = frames_of(chain, q), len(chain.links)
    inverse = [spread(frames, base, [float(k == r) for k in range(n)], [ZERO] * n).rates for r in range(n)]
    active = [sub(_sum([mul(row[k], tau[k]) for k in range(n)]), Y[r]) for r, row in enumerate(inverse)]
    return X, _array(active, q), rates


def torques(chain: Chain, base: Base | None, q: jax.Array, u: jax.Array, u_dot: jax.Array) -> jax.Array:
    """Inverse dynamics as a recursion: forces summed from the tip to the base; the speeds enter the kinematics alone."""
    frames, n = frames_of(chain, q), len(chain.links)
    motion = motion_of(chain, frames, base, [u[k] for k in range(n)], [u_dot[k] for k in range(n)])
    force, moment, tau = ZERO, ZERO, []
    for k in reversed(range(n)):
        link = frames[k].link
        own, spin = _wrench(link, motion.w[k], motion.alpha[k], motion.a[k])
        moment = plus(moment, spin, cross(link.com, own))
        force = plus(force, own)
        tau.append(force[2] if link.slides else moment[2])
        force, moment = frames[k].inward(force), frames[k].inward(moment)
        moment = plus(moment, cross(frames[k].position, force))
    return _array(tau[::-1], q)


def explicit_torques(chain: Chain, base: Base | None, q: jax.Array, q_dot: jax.Array, q_ddot: jax.Array) -> jax.Array:
    """Inverse dynamics by the explicit form, from rates of coordinates as in Nie's TORQUE: tau is Y^T (X u_dot + Y_r)."""
    frames, n = frames_of(chain, q), len(chain.links)
    u, u_dot = [q_dot[k] for k in range(n)], [q_ddot[k] for k in range(n)]
    if base is not None:
        count = base.link + 1
        w = spread(frames[:count], None, u[:count], [ZERO] * count).vectors
        extra = [cross(own, _turn(frame, rate)) for own, frame, rate in zip(w, frames, u, strict=False)]
        alpha = spread(frames[:count], None, u_dot[:count], extra).vectors
        for slot, component in zip(base.replaced, base.components, strict=True):
            u[slot], u_dot[slot] = w[-1][component], alpha[-1][component]
    X, Y, _ = explicit_equations(chain, base, q, _array(u, q))
    change, total = speed_matrix(chain, base, q), [Y[r] for r in range(n)]
    for r in range(n):
        for s in range(n):
            total[r] = total[r] + X[r, s] * u_dot[s]
    return _array([_sum([change[r, k] * total[r] for r in range(n)]) for k in range(n)], q)


def _sum(terms: Sequence[Scalar]) -> Scalar:
    total: Scalar = 0.0
    for term in terms:
        total = add(total, term)
    return total


def angular_velocities(chain: Chain, base: Base | None, q: jax.Array, u: jax.Array) -> jax.Array:
    """Of all links, each in its own frame, (n, 3): what Nie counts below Figure 2.2."""
    frames = frames_of(chain, q)
    return _array([list(w) for w in spread(frames, base, [u[k] for k in range(len(frames))], [ZERO] * len(frames)).vectors], q)


def speed_matrix(chain: Chain, base: Base | None, q: jax.Array) -> jax.Array:
    """Y of u = Y q_dot, from the axes of the joints in the base link's frame."""
    frames, n = frames_of(chain, q), len(chain.links)
    rows: list[list[Scalar]] = [[float(r == s) for s in range(n)] for r in range(n)]
    if base is not None:
        axes = [_axis(frames, k, base.link) if k <= base.link and not frames[k].link.slides else ZERO for k in range(n)]
        for slot, component in zip(base.replaced, base.components, strict=True):
            rows[slot] = [axis[component] for axis in axes]
    return _array(rows, q)


def _array(rows: list, like: jax.Array) -> jax.Array:
    """An array of scalars, known or traced."""
    nested = isinstance(rows[0], list)
    return jnp.stack([_array(row, like) if nested else jnp.asarray(row, like.dtype) for row in rows])
