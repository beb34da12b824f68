import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import kanejax as kj

Q0, U0, TS = np.array([0.3, -0.8]), np.array([0.5, 1.0]), np.array([0.0, 0.2, 0.4])


class Gain(eqx.Module):
    gain: jax.Array

    def __call__(self, t, q, u):
        return -self.gain * u + jnp.sin(t)


def test_forms_of_control_agree(pendulum):
    gain = jnp.array([0.3, 0.2])
    forms = (lambda t, q, u: -gain * u + jnp.sin(t), (lambda t, q, u, k: -k * u + jnp.sin(t), gain), Gain(gain))
    function, pair, module = (kj.simulate(pendulum, Q0, U0, TS, control=form, dt0=0.02).q for form in forms)
    np.testing.assert_allclose(function, pair, rtol=1e-12)
    np.testing.assert_allclose(function, module, rtol=1e-12)


def test_tables_interpolate():
    ts = np.array([0.0, 0.1, 0.3, 0.4, 0.6])
    curve = np.stack((ts**2, 1 - ts), 1)
    linear, cubic, hold = (kj.TorqueTable(ts, curve, kind) for kind in ("linear", "cubic", "hold"))
    np.testing.assert_allclose(linear(0.2), (curve[1] + curve[2]) / 2)
    # A parabola is exact.
    np.testing.assert_allclose(cubic(0.25), [0.0625, 0.75], atol=1e-12)
    np.testing.assert_allclose(cubic(0.05), [0.0025, 0.95], atol=1e-12)
    np.testing.assert_allclose([hold(0.3), hold(0.29), hold(0.6)], [curve[2], curve[1], curve[4]])
    for table in (linear, cubic, hold):
        np.testing.assert_allclose(table(-1.0), curve[0], atol=1e-12)
        np.testing.assert_allclose(table(2.0), curve[-1], atol=1e-12)
    np.testing.assert_allclose(kj.TorqueTable(ts[:2], curve[:2], "cubic")(0.05), curve[:2].mean(0))


def test_a_held_table_is_integrated_piece_by_piece(pendulum):
    table = kj.TorqueTable(np.array([0.0, 0.11, 0.25]), np.array([[2.0, 0], [-1, 1], [0, -1]]), "hold")
    whole = kj.simulate(pendulum, Q0, U0, TS, control=table, rtol=1e-9, atol=1e-10)
    q, u = Q0, U0
    for start, end, row in ((0.0, 0.11, 0), (0.11, 0.25, 1), (0.25, 0.4, 2)):
        constant = (lambda t, q, u, tau: tau, table.values[row])
        piece = kj.simulate(pendulum, q, u, np.array([start, end]), control=constant, rtol=1e-9, atol=1e-10)
        q, u = piece.q_end, piece.u_end
    np.testing.assert_allclose(whole.q_end, q, atol=1e-8)
    np.testing.assert_allclose(whole.u_end, u, atol=1e-8)


def test_bad_controls_are_refused(pendulum):
    with pytest.raises(ValueError, match=r"control returns shape \(3,\), but this model needs \(2,\)"):
        kj.simulate(pendulum, Q0, U0, TS, control=lambda t, q, u: jnp.zeros(3))
    with pytest.raises(TypeError, match="control is list"):
        kj.simulate(pendulum, Q0, U0, TS, control=[0.0, 0.0])
    with pytest.raises(ValueError, match="strictly increasing"):
        kj.TorqueTable(np.array([0.0, 0.0]), np.zeros((2, 2)))
    with pytest.raises(ValueError, match=r"values has shape \(3, 2\), but this table needs \(2, nv\)"):
        kj.TorqueTable(np.array([0.0, 1.0]), np.zeros((3, 2)))
    with pytest.raises(ValueError, match=r"ts has shape \(1,\)"):
        kj.TorqueTable(np.array([0.0]), np.zeros((1, 2)))
