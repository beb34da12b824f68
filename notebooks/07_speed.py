# ---
# jupyter:
#   jupytext:
#     formats: ipynb,py:percent
# ---

# %% [markdown]
# # Speed, and where it comes from
#
# On a CPU this library evaluates inverse dynamics of a six-joint robot in less than a tenth of a microsecond. None of it is C++:
# it is JAX, written in another form than usual. You will see
#
# - the equations written as one would at first, with 3x3 matrices, and what they cost,
# - the same equations in scalar form,
# - how many operations there are, and why the library has fewer,
# - compile time, which should not grow with the robot, and the size of a batch.
#
# All numbers are measured here, on the machine that made this page, by one process that shares it with others; yours will differ,
# the ratios less. `make benchmark` compares with Pinocchio, MuJoCo and others.

# %%
import time

import jax
import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np

import kanejax as kj

# What compiles here is to be measured, so nothing may come from a cache on disk.
jax.config.update("jax_enable_compilation_cache", False)
print("device:", jax.devices()[0].device_kind)

robot = kj.robots.intelledex_605()
print(f"{robot.nv} joints, {robot.dtype}")

# %% [markdown]
# ## As one would write it
#
# Newton and Euler's recursion from the textbook: rotation matrices, cross products, outwards for velocities and accelerations,
# inwards for forces. It is short, right, and differentiable.


# %%
def rotation(quaternion, axis, angle):
    """Rotation matrix of a body's frame, and then by an angle about an axis."""
    w, x, y, z = quaternion / jnp.linalg.norm(quaternion)
    v, cross = jnp.array([x, y, z]), lambda v: jnp.cross(v, -jnp.eye(3))
    placed = jnp.eye(3) + 2.0 * w * cross(v) + 2.0 * cross(v) @ cross(v)
    return placed @ (jnp.eye(3) + jnp.sin(angle) * cross(axis) + (1.0 - jnp.cos(angle)) * cross(axis) @ cross(axis))


def matrix_form(model, q, u, u_dot):
    """Inverse dynamics of a chain of revolute joints."""
    w = alpha = jnp.zeros(3)
    a, links = -model.gravity, []
    for k in range(model.nv):
        axis, p, c = model.joint_axis[k], model.body_position[k], model.com[k]
        R = rotation(model.body_quaternion[k], axis, q[k] - model.coordinate_reference[k])
        a = R.T @ (a + jnp.cross(alpha, p) + jnp.cross(w, jnp.cross(w, p)))
        w, alpha = R.T @ w, R.T @ alpha
        alpha = alpha + axis * u_dot[k] + jnp.cross(w, axis * u[k])
        w = w + axis * u[k]
        force = model.mass[k] * (a + jnp.cross(alpha, c) + jnp.cross(w, jnp.cross(w, c)))
        inertia = model.central_inertia[k]
        moment = inertia @ alpha + jnp.cross(w, inertia @ w) + jnp.cross(c, force)
        links.append((R, p, axis, force, moment))
    tau, force_after, moment_after = [], jnp.zeros(3), jnp.zeros(3)
    for R, p, axis, force, moment in reversed(links):
        force, moment = force + force_after, moment + moment_after
        tau.append(axis @ moment)
        force_after = R @ force
        moment_after = R @ moment + jnp.cross(p, force_after)
    return jnp.stack(tau[::-1])


random = np.random.default_rng(0)
states = [jnp.asarray(random.uniform(-2.0, 2.0, (65536, robot.nv)), robot.dtype) for _ in range(3)]
one = [each[0] for each in states]
print("matrix form:        ", matrix_form(robot, *one))
print("kj.inverse_dynamics:", kj.inverse_dynamics(robot, *one))

# %% [markdown]
# Both agree. Now for many states at once: `jax.vmap`, compiled, the fastest of several runs. The robot's numbers are arguments of
# the first two programs, so that they can be changed and differentiated; the third has them as constants, by `kj.specialize`.


# %%
def nanoseconds(function, *arguments):
    """Of one state in a batch, the fastest of several calls."""
    jax.block_until_ready(function(*arguments))
    took = []
    while sum(took) < 0.1 or len(took) < 3:
        begin = time.perf_counter()
        jax.block_until_ready(function(*arguments))
        took.append(time.perf_counter() - begin)
    return 1e9 * min(took) / len(arguments[-1])


over_states = (None, 0, 0, 0)
library = jax.jit(jax.vmap(kj.inverse_dynamics, over_states))
programs = {
    "matrix form": (jax.jit(jax.vmap(matrix_form, over_states)), robot),
    "kanejax": (library, robot),
    "kanejax, constants": (library, kj.specialize(robot)),
}
sizes = (1, 4096, 65536)
times = {
    name: [nanoseconds(program, model, *(each[:size] for each in states)) for size in sizes]
    for name, (program, model) in programs.items()
}

print("nanoseconds a state, batch of " + "".join(f"{size:10d}" for size in sizes))
for name, each in times.items():
    print(f"{name:30s}" + "".join(f"{value:10.0f}" for value in each))

# %%
figure, axes = plt.subplots(figsize=(7, 3.4), layout="constrained")
for (name, each), style in zip(times.items(), ("-", "-", "--"), strict=True):
    axes.loglog(sizes, each, style, color="#c4620a" if name == "matrix form" else "#0b62b0", marker="o", markersize=4, label=name)
axes.set(xlabel="states in a batch", ylabel="nanoseconds a state")
axes.legend(frameon=False)
axes.spines[["top", "right"]].set_visible(False)
plt.show()

# %% [markdown]
# A call for one state is mostly JAX's own work of handing arrays over. In large batches what counts is the program, and memory:
# the matrix form gains no more, or loses, once its intermediate results leave the cache. The library splits large batches into
# chunks that stay there.
#
# ## Scalar form
#
# Under `vmap` a 3x3 matrix becomes an array (batch, 3, 3), and each product a loop over tiny matrices, in which the processor's
# wide registers are of little use. Written with scalars, x, y and z are arrays over the batch of their own, and every operation
# works on a register full of states. Here are the velocities along a chain of links, in both forms:


# %%
def with_matrices(c, s, u):
    w = v = jnp.zeros(3)
    for k in range(len(u)):
        R = jnp.array([[c[k], -s[k], 0.0], [0.0, 0.0, -1.0], [s[k], c[k], 0.0]])
        v = R.T @ (v + jnp.cross(w, jnp.array([0.3, 0.0, 0.1])))
        w = R.T @ w + jnp.array([0.0, 0.0, 1.0]) * u[k]
    return v


def with_scalars(c, s, u, after_each_link=lambda state: state):
    wx = wy = wz = vx = vy = vz = jnp.zeros_like(u[0])
    for k in range(len(u)):
        vx, vy, vz = vx + 0.1 * wy, vy + 0.3 * wz - 0.1 * wx, vz - 0.3 * wy
        vx, vy, vz = c[k] * vx + s[k] * vz, c[k] * vz - s[k] * vx, -vy
        wx, wy, wz = c[k] * wx + s[k] * wz, c[k] * wz - s[k] * wx, u[k] - wy
        vx, vy, vz, wx, wy, wz = after_each_link((vx, vy, vz, wx, wy, wz))
    return jnp.stack([vx, vy, vz])


def with_barriers(c, s, u):
    return with_scalars(c, s, u, jax.lax.optimization_barrier)


links = (5, 10, 20)
print("nanoseconds a state, links:" + "".join(f"{count:8d}" for count in links))
for form in (with_matrices, with_scalars, with_barriers):
    row = []
    for count in links:
        angles, u = (jnp.asarray(random.normal(size=(16384, count)), jnp.float32) for _ in range(2))
        row.append(nanoseconds(jax.jit(jax.vmap(form)), jnp.cos(angles), jnp.sin(angles), u))
    print(f"{form.__name__:27s}" + "".join(f"{value:8.0f}" for value in row))

# %% [markdown]
# For a few links scalars alone win, and for many they lose: XLA fuses everything into one loop, and in doing so evaluates what
# several others need once for each of them, which multiplies from link to link. A barrier after each link, which no fusion
# crosses, keeps the cost in proportion. The library has barriers in these places, and loops over the links rather than writing
# them out.
#
# ## Fewer operations
#
# `kj.operation_count` writes a function out for one robot, folds zeros and ones, merges what occurs twice, and counts. It counts
# any function, so also the one with matrices:

# %%
for name, function in {
    "matrix form": lambda _, q, u, u_dot: matrix_form(robot, q, u, u_dot),
    "kanejax": kj.inverse_dynamics,
}.items():
    count = kj.operation_count(function, robot)
    print(f"{name:12s} {count.multiplications} multiplications, {count.additions} additions")

# %% [markdown]
# The same physics in half the operations. Mass on a joint's axis moves the same whichever of two links it is counted with, so
# every link hands it to the one before, and most products with masses vanish. (These are the base parameters that
# [identification](05_identify.ipynb) finds, too.) With all numbers as arguments nothing is known to be zero, and the factor
# between the two rows of kanejax above is what that costs.
#
# ## Compile time
#
# A loop over the links is one program whatever their number. The same recursion, written out link by link, is not. First calls,
# tracing and compiling included, for chains of links:


# %%
def chain(count):
    """A chain of links on hinges about x and y in turn."""
    inertial = '<inertial pos="0 0 .1" mass="1" diaginertia=".01 .01 .002"/>'
    opening = "".join(f'<body pos="0 0 {0.2 * (k > 0)}"><joint axis="{(k + 1) % 2} {k % 2} 0"/>{inertial}' for k in range(count))
    return kj.load(f"<mujoco><worldbody>{opening}{'</body>' * count}</worldbody></mujoco>")


def first_call(function, model):
    states = jnp.zeros((4096, model.nv), model.dtype)
    jax.clear_caches()
    begin = time.perf_counter()
    jax.block_until_ready(jax.jit(jax.vmap(function, over_states))(model, states, states, states))
    return time.perf_counter() - begin


counts = (2, 4, 8)
chains = [chain(count) for count in counts]
print("seconds, links:" + "".join(f"{count:8d}" for count in counts))
for name, function in {"matrix form": matrix_form, "kanejax": kj.inverse_dynamics}.items():
    print(f"{name:15s}" + "".join(f"{first_call(function, model):8.1f}" for model in chains))

# %% [markdown]
# ## Where to go next
#
# - Against Pinocchio, MuJoCo, MJX and others, gradients and simulations included: [docs/performance.md](../docs/performance.md).
# - XLA runs one program on one core. `kj.simulate_batch` and `kj.write_study` use all; for other functions see
#   [docs/scale.md](../docs/scale.md).
# - The operations of 1988: [03, the Intelledex 605](03_intelledex_605.ipynb).
