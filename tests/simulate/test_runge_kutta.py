import diffrax
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from kanejax._simulate.runge_kutta import ExplicitRungeKutta

TERM = diffrax.ODETerm(lambda t, y, args: jnp.sin(t) * y + jnp.roll(y, 1))
Y0 = jnp.array([0.3, -0.8, 0.5])


@pytest.mark.parametrize(
    "solver", [diffrax.Tsit5(), diffrax.Bosh3(), diffrax.Heun(), diffrax.Dopri8()], ids=lambda s: type(s).__name__
)
def test_steps_are_those_of_diffrax(solver):
    def steps(solver, y):
        """Two, the second after a jump of the right-hand side."""
        state = solver.init(TERM, jnp.array(0.2), jnp.array(0.5), y, None)
        y, error, dense, state, _ = solver.step(TERM, jnp.array(0.2), jnp.array(0.5), y, None, state, False)
        jump = solver.step(TERM, jnp.array(1.5), jnp.array(1.6), y, None, state, jnp.array(True))
        plain = solver.step(TERM, jnp.array(0.5), jnp.array(0.6), y, None, state, False)
        interpolation = solver.interpolation_cls(t0=0.2, t1=0.5, **dense)
        return y, error, interpolation.evaluate(jnp.array(0.3)), jump[:2], plain[:2]

    own = ExplicitRungeKutta(solver)
    assert own.order(TERM) == solver.order(TERM)
    found, expected = (jax.jit(jax.vmap(lambda y: steps(s, y)))(jnp.stack((Y0, 2 * Y0))) for s in (own, solver))  # noqa: B023
    for a, b in zip(jax.tree.leaves(found), jax.tree.leaves(expected), strict=True):
        np.testing.assert_allclose(a, b, rtol=1e-13, atol=1e-15)
