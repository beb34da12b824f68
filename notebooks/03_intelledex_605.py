# ---
# jupyter:
#   jupytext:
#     formats: ipynb,py:percent
# ---

# %% [markdown]
# # The Intelledex 605 of 1988, today
#
# Nie's thesis of 1988, *Derivation and automatic generation of Kane's dynamical equations for mechanical manipulators*, ends with
# two programs: AUTOTF turns a specified motion of a robot into torques, AUTOQ turns torques back into motion. Here both are run
# again on the same robot, with the recursion of the same thesis. You will see
#
# - the torques of the specified motion, equal to the printed equations once their misprints are corrected,
# - how long that takes, where AUTOTF took 0.28 s,
# - the way back, which is harder than it looks.
#
# `python -m experiments.thesis` does all this for every claim of the thesis.

# %%
import time

import jax
import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np

import kanejax as kj

jax.config.update("jax_enable_x64", True)
np.set_printoptions(precision=8, suppress=True, linewidth=100)

robot = kj.robots.intelledex_605()
print("links:", robot.tree.body_names)
print("masses [kg]:", robot.mass)

# %% [markdown]
# ## The motion
#
# Equation (60): a cycloid takes each of the six joints by 60 degrees from rest to rest in 2 s, but the second by -30 degrees,
# from 90. Speeds and accelerations come from differentiating it twice.

# %%
T = 2.0


def coordinates(t):
    turn = jnp.pi / 3 * jnp.array([1.0, -0.5, 1.0, 1.0, 1.0, 1.0])
    start = jnp.array([0.0, jnp.pi / 2, 0.0, 0.0, 0.0, 0.0])
    return start + turn * (t / T - jnp.sin(2 * jnp.pi * t / T) / (2 * jnp.pi))


def motion(t):
    speeds = jax.jacfwd(coordinates)
    return coordinates(t), speeds(t), jax.jacfwd(speeds)(t)


# %% [markdown]
# ## To torques
#
# AUTOTF's task is inverse dynamics along the motion: one `vmap` over time. Its Figures 3.3 to 3.8:

# %%
torques = jax.jit(jax.vmap(lambda t: kj.inverse_dynamics(robot, *motion(t))))

ts = np.linspace(0.0, T, 401)
tau = torques(ts)
kj.plots.torques(robot, ts, tau)

# %% [markdown]
# The appendix of the thesis prints the equations of this robot in full, Z1 to Z285, derived by hand. Once [two
# misprints](../experiments/errata.md) are corrected they give, to the last of eight decimals:

# %%
printed_equations = np.array([
    [0.0, 0.0, -51.41806886, -15.63086866, 0.0, 0.0],
    [-3.65240562, 23.80108726, -29.90338861, -4.44952941, 0.00752381, -0.00450906],
    [10.24418406, 7.55862433, 14.24269294, 9.76929291, 0.0, 0.0],
])  # fmt: skip
now = torques(np.array([0.0, 1.0, 2.0]))
print("torques [N m] at 0, 1 and 2 s:\n", now.round(8) + 0.0)
print(f"largest difference: {np.max(np.abs(now - printed_equations)):.0e} N m")
assert np.max(np.abs(now - printed_equations)) < 6e-9

# %% [markdown]
# ## 0.28 seconds
#
# That is what AUTOTF took for the six torques at one time, on an IBM AT. Nie compares methods by operations, which do not age:
# 672 multiplications and 404 additions in the equations derived by hand, 646 and 394 for the similar Stanford arm by Kane and
# Levinson, where Newton and Euler need 852 and 738 and Lagrange 2195 and 1719.

# %%
count = kj.operation_count(kj.inverse_dynamics, robot)
print(f"now: {count.multiplications} multiplications, {count.additions} additions, {count.transcendentals} sines and cosines")

# %% [markdown]
# The same count for every link's general inertia would be larger: here two moments of inertia of each link are equal, and four
# lengths zero, because the thesis's Table 3 has them so.
#
# And in seconds, on the machine that made this page: one call at a time, where handing the call over takes most of the time; and
# 4096 states in one call, with the robot's numbers as arguments and as constants.


# %%
def seconds(function, *arguments):
    """Of a call, the fastest of a hundred."""
    took = []
    for _ in range(101):
        begin = time.perf_counter()
        jax.block_until_ready(function(*arguments))
        took.append(time.perf_counter() - begin)
    return min(took)


one = jax.jit(lambda q, u, u_dot: kj.inverse_dynamics(robot, q, u, u_dot))
many = jax.jit(jax.vmap(kj.inverse_dynamics, (None, 0, 0, 0)))
states = jax.vmap(motion)(jnp.linspace(0.0, T, 4096))

then = 0.28
took = {
    "one call": seconds(one, *motion(1.0)),
    "one of 4096": seconds(many, robot, *states) / 4096,
    "one of 4096, constants": seconds(many, kj.specialize(robot), *states) / 4096,
}
for name, each in took.items():
    print(f"{name:23s} {each * 1e6:8.3f} us, {then / each:12,.0f} times as fast as in 1988")

figure, axes = plt.subplots(figsize=(7, 2.2), layout="constrained")
rows = {"AUTOTF, IBM AT, 1988": then, **took}
axes.barh(list(rows), list(rows.values()), color=["#8c959f"] + ["#0b62b0"] * 3)
axes.set(xscale="log", xlabel="seconds for six torques", xlim=(1e-8, 2.0))
axes.invert_yaxis()
axes.spines[["top", "right"]].set_visible(False)
plt.show()

# %% [markdown]
# ## And back
#
# AUTOQ integrates forward dynamics with torques from a table. A table of the torques every 1/32768 s, and steps of 1/1024 s with
# a method of Runge and Kutta, bring the motion back:

# %%
every = np.arange(2**16 + 1) / 2**15
table = kj.TorqueTable(every, torques(every), "cubic")

q0, u0, _ = motion(0.0)
at = np.linspace(0.0, T, 65)
specified = jax.vmap(coordinates)(at)

back = kj.simulate(robot, q0, u0, at, control=table, dt0=2.0**-10)
print(f"largest error of a coordinate: {np.max(np.abs(back.q - specified)):.1e} rad")

# %% [markdown]
# AUTOQ's own schemes, explicit and between explicit and implicit, are here as `kj.BetaScheme`. With steps as long as these, which
# its output can just tell apart, they leave the motion long before its end, and not because they are bad. How much does an error
# at the start grow until a time t? The derivative of the coordinates by those at the start, through the simulation, tells.


# %%
def later(q0):
    return kj.simulate(robot, q0, u0, at, control=table, dt0=2.0**-8).q


growth = np.linalg.norm(jax.jacfwd(later)(q0), 2, axis=(1, 2))
print(f"in {T:g} s an error is multiplied by up to {growth[-1]:.0e}")

errors = {"Runge-Kutta, Tsitouras": np.abs(back.q - specified)}
for name, beta in {"AUTOQ, explicit": 0.0, "AUTOQ, between": 0.5}.items():
    scheme = kj.BetaScheme(beta, three_point=True)
    path = kj.simulate(robot, q0, u0, at, control=table, solver=scheme, dt0=2.0**-10, rtol=1e-10, atol=1e-12)
    errors[name] = np.abs(path.q - specified)

figure, axes = plt.subplots(figsize=(7, 3.6), layout="constrained")
for (name, error), color in zip(errors.items(), ("#0b62b0", "#c4620a", "#009e73"), strict=True):
    axes.semilogy(at[1:], error[1:].max(axis=1), color=color, label=name)
axes.semilogy(at, 1e-12 * growth, "--", color="#777777", label="an error of 1e-12 at the start")
axes.set(xlabel="time [s]", ylabel="largest error of a coordinate [rad]", xlim=(0, T))
axes.legend(frameon=False)
axes.spines[["top", "right"]].set_visible(False)
plt.show()

# %% [markdown]
# An error grows ten million times, with any scheme: torques without feedback do not determine this motion in practice, on a real
# arm less than here. That is why robots are driven by feedback, and why an accurate integrator has to be of high order.
#
# ## Where to go next
#
# - The equations themselves: [02, Kane's method step by step](02_kanes_method.ipynb).
# - Why the recursion is fast: [07, speed](07_speed.ipynb).
# - Feedback along a motion: [06, optimal motions](06_optimal_motion.ipynb).
# - Orders of all the schemes, and the claims of the thesis: `python -m experiments.thesis`.
