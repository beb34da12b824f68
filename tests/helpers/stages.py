"""Small problems of optimal control, written out by hand."""

from collections.abc import Callable

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from kanejax._optimal_control.stages import AbstractStages, Bounds, FinalValues, Path, StageValues


class SwingUp(AbstractStages):
    """Least squared force from rest to rest; four steps of Runge and Kutta's method a stage, in which the force is held."""

    start: jax.Array
    goal: jax.Array
    lower: jax.Array
    upper: jax.Array
    duration: jax.Array
    rates: Callable = eqx.field(static=True)
    steps: int = eqx.field(static=True, default=50)

    def stage(self, k, x, w):
        h = self.duration / self.steps
        d = h / 4

        def step(_, x):
            k1 = self.rates(x, w)
            k2 = self.rates(x + d / 2 * k1, w)
            k3 = self.rates(x + d / 2 * k2, w)
            k4 = self.rates(x + d * k3, w)
            return x + d / 6 * (k1 + 2 * k2 + 2 * k3 + k4)

        after = jax.lax.scan(lambda x, _: (step(0, x), None), x, length=4)[0]
        return StageValues(after, h * jnp.sum(w**2), jnp.zeros(0, x.dtype))

    def final(self, x):
        return FinalValues(jnp.zeros((), x.dtype), jnp.zeros(0, x.dtype))

    def bounds(self):
        limits = jnp.stack((self.lower, self.upper))
        stage = jnp.broadcast_to(limits[:, None], (2, self.steps, limits.shape[1]))
        return Bounds(stage.at[:, 0, : len(self.start)].set(self.start[None]), jnp.stack((self.goal, self.goal)))

    def straight(self):
        """States between start and goal, no forces."""
        share = jnp.linspace(0.0, 1.0, self.steps + 1, dtype=self.start.dtype)[:, None]
        x = (1 - share) * self.start[None] + share * self.goal[None]
        return Path(x, jnp.zeros((self.steps, len(self.lower) - len(self.start)), x.dtype))


def pendulum_rates(x, w):
    """A point of 1 kg at 1 m, damping 0.1; hangs at zero."""
    return jnp.stack((x[1], w[0] - 0.1 * x[1] - 9.81 * jnp.sin(x[0])))


def cart_pole_rates(x, w):
    """A cart of 1 kg with a point of 0.3 kg at 0.5 m (Kelly 2017)."""
    _, angle, v, rate = x
    sine, cosine = jnp.sin(angle), jnp.cos(angle)
    force, least = w[0] + 0.15 * sine * rate**2, 1.3 - 0.3 * cosine**2
    return jnp.stack((v, rate, (force + 0.3 * 9.81 * cosine * sine) / least, -(force * cosine + 1.3 * 9.81 * sine) / (0.5 * least)))


def pendulum(dtype=jnp.float64):
    values = ([0.0, 0.0], [np.pi, 0.0], [-10.0, -20.0, -5.0], [10.0, 20.0, 5.0], 4.0)
    start, goal, lower, upper, duration = (jnp.asarray(each, dtype) for each in values)
    return SwingUp(start, goal, lower, upper, duration, pendulum_rates)


def cart_pole(dtype=jnp.float64):
    inf = np.inf
    values = ([0.0] * 4, [1.0, np.pi, 0.0, 0.0], [-2.0, -inf, -inf, -inf, -20.0], [2.0, inf, inf, inf, 20.0], 2.0)
    start, goal, lower, upper, duration = (jnp.asarray(each, dtype) for each in values)
    return SwingUp(start, goal, lower, upper, duration, cart_pole_rates)
