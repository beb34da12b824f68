"""Multiple shooting: how simulated motion differs from measured motion, linearised and compressed.

The log is cut into pieces, each of which is integrated from a state of its own, all side by side, with the sensitivities to this
state and to the parameters phi. The gaps between pieces of one window are residuals too, which weigh more and more as a fit
converges, until the pieces are one motion; nothing that grows along a whole run is ever formed. Orthogonal transformations take
the state of one piece after another out, so what remains is one triangular factor for phi: the square-root information filter
(Bierman 1977), and backwards the smoother, of which weak gaps are the process noise. Memory for Jacobians does not grow with the
log.
"""

from collections.abc import Sequence
from typing import Any, NamedTuple, final

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Bool, Float, Int

from kanejax._dynamics.regressor import prepare_with
from kanejax._parameters.joint_force import Mechanism, joint_force
from kanejax._parameters.parameterization import Parameterization
from kanejax._regression.huber import huber_cost, huber_weight
from kanejax._simulate.control import Controlled
from kanejax._simulate.system import System, rates
from kanejax._simulation_fit.windows import Pieces

# Numbers in the Jacobian of as many pieces as are taken up at a time, of all starts together.
NUMBERS = 2**19


class Measured(NamedTuple):
    """Samples of all runs one after another; `sigma` are the standard deviations of the outputs, (noutput, nv)."""

    ts: Float[Array, " n"]
    outputs: Float[Array, "n noutput nv"]
    effort: Float[Array, "n nv"]
    weight: Float[Array, "n nv"]


class Linearization(NamedTuple):
    """The sum of squares of residuals and weighted gaps about one phi and one state of each piece.

    With the change d of phi, the residuals that the states leave are `factor @ [d, 1]`, and the change of the state of a piece
    solves `back @ [change, change of the next, d, 1] = 0`.

    Attributes:
        factor: upper triangle, (n + 1, n + 1).
        back: of each piece.
        misfit: sum of squared residuals, each divided by its standard deviation; of Huber's function of them, if the fit is robust.
        gaps: sum of the squared gaps [rad/s, m/s] from the end of each piece to the state of the next, where they are joined.
        squares: sum of squared residuals of each output, before they are divided by its standard deviation.
        sizes: of the residuals at each sample, divided by their standard deviations.
        states: coordinates and speeds at each sample.
        predicted: outputs at each sample.
    """

    factor: Float[Array, "n1 n1"]
    back: Float[Array, "pieces nx unknowns"]
    misfit: Float[Array, ""]
    gaps: Float[Array, ""]
    squares: Float[Array, "noutput nv"]
    sizes: Float[Array, "pieces length noutput nv"]
    states: Float[Array, "pieces length nx"]
    predicted: Float[Array, "pieces length noutput nv"]


@final
class Shooting(eqx.Module):
    """The pieces of all runs, and how they are simulated.

    Attributes:
        parameterization: what is sought.
        measured: what is to be met.
        pieces: of the runs.
        inside: which samples of the pieces count.
        given: which pieces start from a state that is known.
        control: instead of the measured effort, a function of (t, q, u); or None.
        solver: of diffrax, for equal steps.
        run_lengths: samples of each run; static.
        outputs: what is compared: "q", "u" and "effort"; static.
        substeps: steps from sample to sample; static.
        interpolation: of the effort between samples; static.
        has_delay: whether the signal's delay counts; static.
        has_load_friction: see `Mechanism`; static.
        robust: whether residuals far out count less; static.
    """

    parameterization: Parameterization
    measured: Measured
    pieces: Pieces
    inside: Bool[Array, "pieces length"]
    given: Bool[Array, " pieces"]
    control: Controlled | None
    solver: diffrax.AbstractSolver[Any]
    run_lengths: tuple[int, ...] = eqx.field(static=True)
    outputs: tuple[str, ...] = eqx.field(static=True)
    substeps: int = eqx.field(static=True)
    interpolation: str = eqx.field(static=True)
    has_delay: bool = eqx.field(static=True)
    has_load_friction: bool = eqx.field(static=True)
    robust: bool = eqx.field(static=True)


class _Piece(NamedTuple):
    """What pieces are made of, besides the parameters: the effort, and how it depends on the delay."""

    start: Float[Array, "*b nx"]
    after: Float[Array, "*b nx"]
    ts: Float[Array, "*b length1"]
    effort: Float[Array, "*b length1 nv"]
    later: Float[Array, "*b length1 nv"]
    outputs: Float[Array, "*b length noutput nv"]
    weight: Float[Array, "*b length nv"]
    count: Int[Array, "*b"]
    joined: Bool[Array, "*b"]
    given: Bool[Array, "*b"]


def linearized(
    shooting: Shooting,
    phi: Float[Array, " n"],
    starts: Float[Array, "pieces nx"],
    sigma: Float[Array, "noutput nv"],
    tightness: Float[Array, ""],
    numbers: int = NUMBERS,
) -> Linearization:
    """Simulate all pieces from their `starts`, and compress how residuals, and gaps times `tightness`, depend on everything.

    As many pieces are taken up at a time as have so many `numbers` in their Jacobian.
    """
    pieces = _pieces(shooting, phi, starts)
    number, length = shooting.inside.shape
    size, nx = len(phi), starts.shape[-1]
    blocks = min(number, -(-number * length * sigma.size * (nx + size) // numbers))
    # A state is held by next to nothing, so that what no output shows does not move.
    least = (1e-3 if phi.dtype == jnp.float64 else 1e-2) / jnp.max(sigma)
    held = jnp.eye(nx, nx + size + 1, dtype=phi.dtype) * least
    # Of a state that is known, heavy rows would leave rounding errors.
    stays = jnp.eye(nx, 2 * nx + size + 1, dtype=phi.dtype)

    def take_up(triangle: jax.Array, block: _Piece) -> tuple[jax.Array, tuple]:
        rows, links, *rest = jax.vmap(_linearized_piece, (None, None, None, None, 0))(shooting, phi, sigma, tightness, block)
        triangle, back = lax.scan(eliminate, triangle, (rows, links, block.joined, block.given))
        return triangle, (back, *rest)

    def eliminate(triangle: jax.Array, piece: tuple) -> tuple[jax.Array, jax.Array]:
        rows, links, joined, given = piece
        new = jnp.concatenate((jnp.zeros((nx, nx), phi.dtype), held), 1)
        # Heavy rows first, for the sake of rounding errors (Powell and Reid 1969).
        known = jnp.concatenate((triangle, rows))
        known = jnp.concatenate((known[:, :nx], jnp.zeros((len(known), nx), known.dtype), known[:, nx:]), 1)
        whole = jnp.linalg.qr(jnp.concatenate((jnp.where(joined, links, new), known)), mode="r")
        return whole[nx:, nx:], jnp.where(given, stays, whole[:nx])

    start = jnp.zeros((nx + size + 1, nx + size + 1), phi.dtype).at[:nx].set(held)
    triangle, found = lax.scan(take_up, start, _blocks(pieces, blocks))
    back, misfit, gaps, squares, *of_samples = (x.reshape(-1, *x.shape[2:])[:number] for x in found)
    misfit, gaps, squares = (jnp.sum(x, 0) for x in (misfit, gaps, squares))
    return Linearization(triangle[nx:, nx:], back, misfit, gaps, squares, *of_samples)


def _pieces(shooting: Shooting, phi: jax.Array, starts: jax.Array) -> _Piece:
    measured, at = shooting.measured, shooting.pieces.index
    effort, later = measured.effort, jnp.zeros_like(measured.effort)
    if shooting.has_delay:
        delay = shooting.parameterization.assemble(phi)[0].drives.delay
        effort, later = shifted(measured.ts, measured.effort, delay, shooting.run_lengths)
    outputs = measured.outputs[at[..., :-1]]
    if "effort" in shooting.outputs:
        place = shooting.outputs.index("effort")
        outputs = outputs.at[..., place, :].set(effort[at[..., :-1]])
    weight = jnp.where(shooting.inside[..., None], measured.weight[at[..., :-1]], 0.0)
    after = jnp.concatenate((starts[1:], starts[-1:]))
    ts, count, joined = (jnp.asarray(x) for x in (shooting.pieces.ts, shooting.pieces.count, shooting.pieces.joined))
    return _Piece(starts, after, ts, effort[at], later[at], outputs, weight, count, joined, shooting.given)


def shifted(ts: jax.Array, effort: jax.Array, delay: jax.Array, run_lengths: Sequence[int]) -> tuple[jax.Array, jax.Array]:
    """What was recorded by `delay` later than each sample, on straight lines between samples, and its rate of change.

    The rate is that of the line on which the time lies; the first and last values of a run hold before and after it.
    """
    values, slopes, first = [], [], 0
    for length in run_lengths:
        own, table = ts[first : first + length], effort[first : first + length]
        first += length
        t = own + lax.stop_gradient(delay)
        left = jnp.clip(jnp.searchsorted(own, t, side="right") - 1, 0, length - 2)
        slope = (table[left + 1] - table[left]) / (own[left + 1] - own[left])[:, None]
        within = (t >= own[0]) & (t <= own[-1])
        t = jnp.clip(t, own[0], own[-1])
        values.append(table[left] + (t - own[left])[:, None] * slope)
        slopes.append(jnp.where(within[:, None], slope, 0.0))
    return jnp.concatenate(values), jnp.concatenate(slopes)


def _linearized_piece(
    shooting: Shooting, phi: jax.Array, sigma: jax.Array, tightness: jax.Array, piece: _Piece
) -> tuple[jax.Array, ...]:
    """Triangle of the residuals, of [own state, phi, 1]; rows of the gap, of [own state, next, phi, 1]; sums, states, outputs."""
    nx = len(piece.start)
    point = jnp.concatenate((piece.start, phi))
    directions = jnp.eye(len(point), dtype=phi.dtype)
    directions = jnp.where((jnp.arange(len(point)) < nx)[:, None] & piece.given, 0.0, directions)

    def along(direction: jax.Array) -> tuple[tuple, tuple]:
        return jax.jvp(lambda x: _simulated(shooting, x[nx:], x[:nx], piece), (point,), (direction,))

    ((states, predicted), (states_by, predicted_by)) = jax.vmap(along, out_axes=((None, None), (-1, -1)))(directions)
    scale = jnp.sqrt(piece.weight)[:, None, :] / sigma[None]
    error = jnp.where(scale > 0, predicted - piece.outputs, 0.0)
    size = jnp.abs(scale * error)
    if shooting.robust:
        scale = scale * jnp.sqrt(huber_weight(size))
    derivative = jnp.where(scale[..., None] > 0, scale[..., None] * predicted_by, 0.0)
    rows = jnp.concatenate((derivative, (scale * error)[..., None]), -1).reshape(-1, len(point) + 1)
    rows = jnp.linalg.qr(rows, mode="r")
    # A force that is missing for the length of a piece makes gaps of speeds, and half that times the length of coordinates.
    length = piece.ts[-1] - piece.ts[0]
    units = jnp.where(jnp.arange(nx) < nx // 2, 2.0 / length, 1.0)
    gap = jnp.where(piece.joined, units * (states[piece.count] - piece.after), 0.0)
    end, one = units[:, None] * states_by[piece.count], jnp.diag(units)
    links = tightness * jnp.concatenate((end[:, :nx], -one, end[:, nx:], gap[:, None]), 1)
    squares = jnp.sum(piece.weight[:, None, :] * error**2, 0)
    misfit = huber_cost(size) if shooting.robust else size**2
    return rows, links, jnp.sum(misfit), jnp.sum(gap**2), squares, size, states[:-1], predicted


def _simulated(shooting: Shooting, phi: jax.Array, start: jax.Array, piece: _Piece) -> tuple[jax.Array, jax.Array]:
    """States at all samples of a piece and after it, and outputs at its samples."""
    plant, parameters = shooting.parameterization.assemble(phi)
    tree = plant.model.tree
    mechanism = Mechanism(prepare_with(plant.model, parameters), plant.drives, tree, shooting.has_load_friction)
    delay = plant.drives.delay
    effort = piece.effort + (delay - lax.stop_gradient(delay)) * piece.later
    term, hold = diffrax.ODETerm(rates), shooting.interpolation == "hold"

    def interval(y: jax.Array, ends: tuple) -> tuple[jax.Array, jax.Array]:
        t0, t1, before, after = ends
        drive = _Drive(mechanism, shooting.control, t0, before, jnp.zeros_like(after) if hold else (after - before) / (t1 - t0))
        system = System(mechanism.prepared, Controlled(drive), tree)
        times = t0 + (t1 - t0) * (jnp.arange(shooting.substeps + 1, dtype=y.dtype) / shooting.substeps)
        state = shooting.solver.init(term, times[0], times[1], y, system)

        def step(carry: tuple, ends: tuple[jax.Array, jax.Array]) -> tuple[tuple, None]:
            y1, _, _, state, _ = shooting.solver.step(term, *ends, carry[0], system, carry[1], made_jump=False)
            return (y1, state), None

        return lax.scan(step, (y, state), (times[:-1], times[1:]))[0][0], y

    end, states = lax.scan(interval, start, (piece.ts[:-1], piece.ts[1:], effort[:-1], effort[1:]))
    states = jnp.concatenate((states, end[None]))
    q, u = states[:-1, : tree.nq], states[:-1, tree.nq :]
    outputs = {"q": q, "u": u}
    if "effort" in shooting.outputs:
        assert shooting.control is not None
        outputs["effort"] = jax.vmap(shooting.control)(piece.ts[:-1], q, u) - (effort - piece.effort)[:-1]
    return states, jnp.stack([outputs[name] for name in shooting.outputs], 1)


@final
class _Drive(eqx.Module):
    """Force at the joints between two samples; the signal is on a straight line, or from a control."""

    mechanism: Mechanism
    control: Controlled | None
    start: jax.Array
    before: jax.Array
    slope: jax.Array

    def __call__(self, t: jax.Array, q: jax.Array, u: jax.Array) -> jax.Array:
        signal = self.before + (t - self.start) * self.slope if self.control is None else self.control(t, q, u)
        return joint_force(self.mechanism, signal, q, u)


def _blocks(pieces: _Piece, number: int) -> _Piece:
    """Cut pieces into blocks of the same size, filled up with copies of the last that do not count."""
    count = len(pieces.count)
    size = -(-count // number)
    spare = number * size - count

    def cut(x: jax.Array, counts: bool = True) -> jax.Array:
        if spare:
            last = jnp.repeat(x[-1:], spare, 0)
            x = jnp.concatenate((x, last if counts else jnp.zeros_like(last)))
        return x.reshape(number, size, *x.shape[1:])

    return jax.tree.map(cut, pieces)._replace(weight=cut(pieces.weight, False))
