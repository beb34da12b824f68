# ---
# jupyter:
#   jupytext:
#     formats: ipynb,py:percent
# ---

# %% [markdown]
# # Kane's method, step by step
#
# Kane and Levinson's arm of 1983 turns about the vertical, turns about the horizontal, and slides: two revolute joints and a
# prismatic one, with a load in its hand. In this notebook its equations of motion are built as the paper builds them, from
# partial velocities to generalized forces, each equation beside the array that it describes; the result is compared with the
# library's recursion and with MuJoCo. Then the arm moves under the paper's feedback, and the energy is accounted for.
#
# Numbers (1.x) are those of the textbook chapter on open kinematic chains that carries this example with its data.

# %%
import warnings

import jax
import jax.numpy as jnp
import matplotlib.pyplot as plt
import mujoco
import numpy as np

import kanejax as kj

jax.config.update("jax_enable_x64", True)
np.set_printoptions(precision=4, suppress=True)

with warnings.catch_warnings(record=True) as told:
    warnings.simplefilter("always")
    arm = kj.robots.rrp_arm()

print("bodies:", arm.tree.body_names)
print("joints:", arm.tree.joint_names)
print("library:", told[0].message)

# %% [markdown]
# The library's first remark is right: the inertia printed for the load RB is not one that a rigid body can have, by half a
# thousandth of its size. The equations of motion are well defined all the same.
#
# ## Coordinates and speeds
#
# $q_3$ turns link 1 about the vertical $\mathbf i_0$, $q_1$ turns link 2 about the horizontal $\mathbf j_2$, and $q_2$ slides
# link 3 along $\mathbf k_2$. The generalized speeds are
#
# $$u_1 = \dot q_3,\quad u_2 = \dot q_1,\quad u_3 = \dot q_2. \tag{1.3}$$
#
# The model has its joints from the base outwards, so its `q` is $(q_3, q_1, q_2)$ and its `u` is $(u_1, u_2, u_3)$. We take one
# state, with accelerations.

# %%
q = jnp.array([0.3, 0.7, 0.25])
u = jnp.array([0.8, -0.5, 0.4])
u_dot = jnp.array([1.0, 2.0, -1.5])

q3, q1, q2 = q
s1, c1 = jnp.sin(q1), jnp.cos(q1)
L1, L2, LB, (px, py, pz) = 0.3, 0.5, 1.1, (0.2, 0.4, 0.6)

# %% [markdown]
# ## Partial velocities
#
# Every angular velocity and every velocity of a mass centre is linear in the speeds; what multiplies $u_r$ is a *partial
# velocity*:
#
# $$\boldsymbol\omega = \sum_r \boldsymbol\omega_r u_r, \qquad \mathbf v = \sum_r \mathbf v_r u_r .$$
#
# For link 2, and for the mass centre $C_R$ of the load, the text finds, in the axes $(\mathbf i_2, \mathbf j_2, \mathbf k_2)$,
#
# $$\boldsymbol\omega_{20} = u_1 c_1\, \mathbf i_2 + u_2\, \mathbf j_2 + u_1 s_1\, \mathbf k_2 \tag{1.9}$$
#
# $$\mathbf v_{C_R} = (-s_1 p_y\, u_1 + Z_{14} u_2)\, \mathbf i_2 + Z_{15} u_1\, \mathbf j_2
#   + (c_1 p_y\, u_1 - p_x u_2 + u_3)\, \mathbf k_2 \tag{1.19}$$
#
# with $Z_{14} = L_2 + q_2 + p_z$ and $Z_{15} = -(L_B + (L_2 + q_2)\, c_1) + s_1 p_x - c_1 p_z$. One row for each speed:

# %%
Z14 = L2 + q2 + pz
Z15 = -(LB + (L2 + q2) * c1) + s1 * px - c1 * pz

w_by_hand = jnp.array([[c1, 0.0, s1], [0.0, 1.0, 0.0], [0.0, 0.0, 0.0]])
v_by_hand = jnp.array([[-s1 * py, Z15, c1 * py], [Z14, 0.0, -px], [0.0, 0.0, 1.0]])

# %% [markdown]
# The library has those of all bodies in world axes, `angular[k, r]` and `linear[k, r]`. Turned into the axes of the link they are
# the text's.

# %%
w, v = kj.partial_velocities(arm, q)
axes_of_link_2 = kj.poses(arm, q).rotation[1]  # from (i2, j2, k2) to world components

print("partial angular velocities of link 2:\n", w[1] @ axes_of_link_2)
print("partial velocities of C_R:\n", v[3] @ axes_of_link_2)
assert jnp.allclose(w[1] @ axes_of_link_2, w_by_hand)
assert jnp.allclose(v[3] @ axes_of_link_2, v_by_hand)

# %% [markdown]
# ## Accelerations
#
# Differentiating in time, with $\dot{\boldsymbol\omega}_r$ and $\dot{\mathbf v}_r$ the rates of the partial velocities in the
# world,
#
# $$\boldsymbol\alpha = \sum_r \boldsymbol\omega_r \dot u_r + \dot{\boldsymbol\omega}_r u_r, \qquad
#   \mathbf a = \sum_r \mathbf v_r \dot u_r + \dot{\mathbf v}_r u_r . $$
#
# Which is (1.10) to (1.23), without writing a single component.

# %%
w_dot, v_dot = kj.partial_velocity_rates(arm, q, u)

omega = jnp.einsum("kri,r->ki", w, u)
alpha = jnp.einsum("kri,r->ki", w, u_dot) + jnp.einsum("kri,r->ki", w_dot, u)
a = jnp.einsum("kri,r->ki", v, u_dot) + jnp.einsum("kri,r->ki", v_dot, u)

print("accelerations of the mass centres, in world axes [m/s^2]:\n", a)

# %% [markdown]
# ## Generalized inertia forces
#
# Each body has an inertia force and an inertia torque, (1.27) and (1.28),
#
# $$\mathbf F_\text{in} = -m\, \mathbf a, \qquad
#   \mathbf T_\text{in} = -\mathbf I \cdot \boldsymbol\alpha - \boldsymbol\omega \times (\mathbf I \cdot \boldsymbol\omega),$$
#
# and the generalized inertia forces are their projections on the partial velocities, summed over the bodies:
#
# $$F_r^* = \sum_j \mathbf v_{r} \cdot \mathbf F_{\text{in}\,j} + \boldsymbol\omega_{r} \cdot \mathbf T_{\text{in}\,j} \tag{1.44}$$

# %%
turn = kj.poses(arm, q).rotation
inertia = jnp.einsum("kij,kjl,kml->kim", turn, arm.central_inertia, turn)

F_in = -arm.mass[:, None] * a
T_in = -jnp.einsum("kij,kj->ki", inertia, alpha) - jnp.cross(omega, jnp.einsum("kij,kj->ki", inertia, omega))
F_star = jnp.einsum("kri,ki->r", v, F_in) + jnp.einsum("kri,ki->r", w, T_in)

print("F*_r:          ", F_star)
print("of the library:", kj.generalized_inertia_force(arm, q, u, u_dot))

# %% [markdown]
# ## Generalized active forces
#
# Forces in the bearings do no work and drop out: that is what projecting on partial velocities is for. What is left is the weight
# and the three motors, $T_{01x}$, $T_{12y}$ and $F_{23z}$, one along each speed:
#
# $$F_r = \sum_j \mathbf v_{r} \cdot m_j \mathbf g + \tau_r .$$
#
# The text writes it out as (1.54),
#
# $$F_2 = T_{12y} - g\,[(m_2 L_2 + m_3 Z_9 + m_R Z_{14})\, c_1 - m_R p_x s_1], \qquad F_3 = F_{23z} - g\,(m_3 + m_R)\, s_1 ,$$
#
# and $F_1 = T_{01x}$, for which it prints $T_{12x}$: one of its misprints.

# %%
weight = jnp.einsum("kri,ki->r", v, arm.mass[:, None] * arm.gravity)
_, m2, m3, mR = arm.mass
print("of the weight:", weight)
print("(1.54):       ", -9.81 * jnp.array([0.0, (m2 * L2 + m3 * (L2 + q2) + mR * Z14) * c1 - mR * px * s1, (m3 + mR) * s1]))

# %% [markdown]
# ## Kane's equations
#
# $$F_r + F_r^* = 0, \qquad r = 1, 2, 3. \tag{1.55}$$
#
# Solved for the motors' forces, they are inverse dynamics. The library gets there by a recursion over the links that never forms
# a partial velocity, and MuJoCo by one of its own. MuJoCo refuses a load that cannot exist, so it is given link 3 and RB as one
# body, which can.

# %%
tau = -(F_star + weight)

compiled = kj.to_mujoco(kj.robots.rrp_arm(load="fused")).compile()
state = mujoco.MjData(compiled)
state.qpos, state.qvel, state.qacc = q, u, u_dot
mujoco.mj_inverse(compiled, state)

print("by hand [N m, N m, N]:", tau)
print("kj.inverse_dynamics:  ", kj.inverse_dynamics(arm, q, u, u_dot))
print("MuJoCo's mj_inverse:  ", state.qfrc_inverse)
assert np.allclose(tau, kj.inverse_dynamics(arm, q, u, u_dot), rtol=1e-12)
assert np.allclose(tau, state.qfrc_inverse, rtol=1e-12)

# %% [markdown]
# Solved for $\dot u$, they are forward dynamics. $F^*$ is linear in $\dot u$; what multiplies it is minus the mass matrix,
#
# $$-F_r^* = \sum_s \Big( \sum_j m_j\, \mathbf v_r \cdot \mathbf v_s
#   + \boldsymbol\omega_r \cdot \mathbf I_j \cdot \boldsymbol\omega_s \Big) \dot u_s + \dots ,$$
#
# the $-X_{rs}$ of (1.56). `kj.kane_equations` has these terms, made in the same way as here.

# %%
M = jnp.einsum("kri,kij,ksj->rs", w, inertia, w) + jnp.einsum("kri,k,ksi->rs", v, arm.mass, v)
remainder = -F_star - M @ u_dot

print("mass matrix:\n", M)
print("accelerations:      ", jnp.linalg.solve(M, weight + tau - remainder))
print("kj.forward_dynamics:", kj.forward_dynamics(arm, q, u, tau))
assert jnp.allclose(M, kj.kane_equations(arm, q, u).mass_matrix)

# %% [markdown]
# ## Motion
#
# Section 1.4 of the text brings the arm from rest to rest by feedback: dampers, springs towards a target, and forces that hold
# the weight,
#
# $$T_{01x} = -\beta_{01} \dot q_3 - \gamma_{01} (q_3 - q_{3f}), \quad \dots, \quad
#   F_{23z} = -\beta_{23} \dot q_2 - \gamma_{23} (q_2 - q_{2f}) + g\,(m_3 + m_R) \sin q_1 .$$
#
# The print has $\sin q_3$ in the last one. Both are simulated; dashed is what the print would do.

# %%
start = jnp.array([np.pi / 18, np.pi / 6, 0.1])
target = jnp.array([7 * np.pi / 18, np.pi / 3, 0.4])
beta, gamma = jnp.array([464.0, 216.0, 169.0]), jnp.array([306.0, 285.0, 56.0])


def feedback(t, q, u):
    return -beta * u - gamma * (q - target) - kj.gravity_force(arm, q)


def as_printed(t, q, u):
    holding = (-kj.gravity_force(arm, q)).at[2].set(9.81 * (m3 + mR) * jnp.sin(q[0]))
    return -beta * u - gamma * (q - target) + holding


ts = np.linspace(0.0, 30.0, 3001)
path = kj.simulate(arm, start, jnp.zeros(3), ts, control=feedback, rtol=1e-10, atol=1e-10)
printed = kj.simulate(arm, start, jnp.zeros(3), ts, control=as_printed)

print("target:       ", target)
print("at 30 s:      ", path.q[-1])
print("with the print:", printed.q[-1])
kj.plots.coordinates(arm, path, reference=printed)

# %% [markdown]
# With $\sin q_1$ the arm comes to rest where it should; as printed the slider first falls through its bearing, and then stays at
# 1.59 m instead of 0.4 m.
#
# ## Energy
#
# What the motors put in is what the arm gains, in kinetic energy (1.57) and in height:
#
# $$T(t) + V(t) - T(0) - V(0) = \int_0^t \sum_r \tau_r u_r \, dt .$$

# %%
kinetic = jax.vmap(kj.kinetic_energy, (None, 0, 0))(arm, path.q, path.u)
gained = kinetic + jax.vmap(kj.potential_energy, (None, 0))(arm, path.q)
gained -= gained[0]

tau = jax.vmap(feedback)(path.ts, path.q, path.u)
power = jnp.sum(tau * path.u, axis=1)
# The integral by trapezoids, with their error taken off by the slopes at both ends.
h, slope = ts[1] - ts[0], jnp.gradient(power, ts[1] - ts[0])
work = jnp.concatenate((jnp.zeros(1), jnp.cumsum((power[1:] + power[:-1]) * h / 2))) - h**2 / 12 * (slope - slope[0])

apart = jnp.max(jnp.abs(gained - work))
print(f"gained {gained[-1]:.4f} J, work of the motors {work[-1]:.4f} J; at most {apart:.0e} J apart on the way")
assert apart < 1e-3

figure, axes = plt.subplots(figsize=(8, 3.2), layout="constrained")
axes.plot(ts, work, color="#c4620a", linewidth=5, alpha=0.4, label="work of the motors")
axes.plot(ts, gained, color="#0b62b0", label="kinetic and potential energy gained")
axes.plot(ts, kinetic, color="#009e73", label="kinetic energy")
axes.set(xlabel="time [s]", ylabel="J", xlim=(0, 15))
axes.legend(frameon=False)
axes.spines[["top", "right"]].set_visible(False)
plt.show()

# %% [markdown]
# ## Where to go next
#
# - The same recursion on a robot of 1988 with six joints: [03, the Intelledex 605](03_intelledex_605.ipynb).
# - `kj.with_speeds` takes other generalized speeds than $\dot q$, which is half of Kane's art;
#   `experiments/thesis/generalized_speeds.py` shows what their choice does to the equations.
# - The sources and their misprints: [experiments/errata.md](../experiments/errata.md).
