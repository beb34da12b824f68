# ---
# jupyter:
#   jupytext:
#     formats: ipynb,py:percent
# ---

# %% [markdown]
# # Ten minutes to kanejax
#
# kanejax computes how robots move, by Kane's method, in JAX: one call, thousands at once, with derivatives with respect to
# anything. In this notebook you
#
# 1. load a robot from its URDF, and compare the library with MuJoCo,
# 2. evaluate inverse and forward dynamics, for one state and for 4096,
# 3. differentiate, also with respect to the robot itself,
# 4. simulate it, falling and under control, and look at the motion.
#
# Install with `pip install 'kanejax[notebooks]'`. JAX computes in float32 unless told otherwise, and the library never changes
# JAX's settings; here we want all digits.

# %%
import jax
import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np
import rich

import kanejax as kj

jax.config.update("jax_enable_x64", True)
np.set_printoptions(precision=4, suppress=True)

# %% [markdown]
# ## A robot
#
# Put the path of your own URDF or MJCF here. This is a Universal Robots UR10, from the package `example-robot-data`.

# %%
urdf = kj.robots.example_file("ur10_robot.urdf")
model = kj.load(urdf)

print(f"{model.nbody} bodies, {model.nv} joints: {', '.join(model.tree.joint_names)}")
print("masses [kg]:", model.mass)

# %% [markdown]
# A model is a pytree: a static tree of names, and arrays with all numbers of the robot, which may be changed, batched and
# differentiated. A file that says more than the equations of motion can represent is refused by name, unless you say
# `strict=False`; `kj.load_report` tells what a file has that does not matter to them.
#
# Is it right? `validate` compares with MuJoCo at random states.

# %%
report = kj.validate(urdf, samples=100)
rich.print(report.table())
assert report.passed

# %% [markdown]
# ## Dynamics
#
# Coordinates q and speeds u are MuJoCo's `qpos` and `qvel`, in its order; SI units and radians. Which torques hold the arm still,
# stretched out to one side?

# %%
q = jnp.array([0.0, 0.0, 0.5, 0.0, 0.0, 0.0])
rest = jnp.zeros(model.nv)

tau = kj.inverse_dynamics(model, q, rest, rest)
print("torques at rest [N m]:  ", tau)
print("accelerations then:     ", kj.forward_dynamics(model, q, rest, tau))
print("accelerations without:  ", kj.forward_dynamics(model, q, rest, rest))

# %% [markdown]
# Thousands of states are one `jax.vmap` away. `None` says that all share the model; a 0 in its place would batch robots, too.

# %%
random = np.random.default_rng(0)
q_many, u_many, u_dot_many = (jnp.asarray(random.uniform(-2.0, 2.0, (4096, model.nv))) for _ in range(3))

inverse_dynamics = jax.jit(jax.vmap(kj.inverse_dynamics, (None, 0, 0, 0)))
forward_dynamics = jax.jit(jax.vmap(kj.forward_dynamics, (None, 0, 0, 0)))

tau_many = inverse_dynamics(model, q_many, u_many, u_dot_many)
back = forward_dynamics(model, q_many, u_many, tau_many)
print(f"{len(tau_many)} states there and back: largest error {jnp.max(jnp.abs(back - u_dot_many)):.0e} rad/s^2")

# %% [markdown]
# ## Derivatives
#
# With respect to the state, as for any function in JAX: how the accelerations answer to the coordinates.

# %%
print(jax.jacfwd(kj.forward_dynamics, argnums=1)(model, q, rest, tau))

# %% [markdown]
# And with respect to the robot. The gradient of a number by a model is a model: `by.mass`, `by.com`, `by.joint_axis` and all the
# rest. Which link's mass does the torque of the shoulder lift depend on most, over all those states?


# %%
def effort(model):
    return jnp.mean(jax.vmap(kj.inverse_dynamics, (None, 0, 0, 0))(model, q_many, u_many, u_dot_many)[:, 1] ** 2)


by = jax.jit(jax.grad(effort))(model)

moving = slice(1, 7)
figure, axes = plt.subplots(figsize=(7, 2.6), layout="constrained")
axes.barh(model.tree.body_names[moving], by.mass[moving], color="#0b62b0")
axes.invert_yaxis()
axes.set_xlabel(r"d(mean squared torque) / d(mass)  [N$^2$ m$^2$/kg]")
axes.spines[["top", "right"]].set_visible(False)
plt.show()

# %% [markdown]
# Changing a number gives another model of the same kind, so that nothing is compiled again.

# %%
heavier = model.body("wrist_3_link").set(mass=5.0)
print("with 5 kg at the wrist [N m]:", kj.inverse_dynamics(heavier, q, rest, rest))

# %% [markdown]
# ## Simulation
#
# Without torques the arm falls, and nothing takes energy away: what the simulation loses or gains is the error of its steps. They
# are adaptive, here with tight tolerances.

# %%
ts = np.linspace(0.0, 2.0, 201)
fall = kj.simulate(model, q, rest, ts, rtol=1e-9, atol=1e-9)
print(kj.Status(int(fall.status)).name, "after", int(fall.stats["num_steps"]), "steps")
kj.plots.energies(model, fall)

# %% [markdown]
# A controller is a function of time, coordinates and speeds. This one holds the weight, and pulls the joints to a posture like
# springs with dampers, as stiff as what they move is heavy.

# %%
target = jnp.array([1.2, -1.0, 1.4, -0.6, 1.0, 0.0])


def control(t, q, u):
    pull = 16.0 * (target - q) - 8.0 * u
    return kj.mass_matrix(model, q) @ pull - kj.gravity_force(model, q)


path = kj.simulate(model, q, rest, ts, control=control)
print("off the target at the end [rad]:", path.q[-1] - target)
kj.plots.motion(model, path, joints=["shoulder_pan_joint", "shoulder_lift_joint", "elbow_joint"])

# %% [markdown]
# What if the hand holds 5 kg that the controller does not know of? The same call with another model, and the motion that was
# meant as a reference.

# %%
loaded = kj.simulate(heavier, q, rest, ts, control=control)
kj.plots.coordinates(model, loaded, reference=path)

# %% [markdown]
# ## Where to go next
#
# - What happens inside, equation by equation: [02, Kane's method step by step](02_kanes_method.ipynb).
# - Many simulations at once, with random robots: [04, four thousand trajectories](04_four_thousand_trajectories.ipynb).
# - The masses of a real robot from its log: [05, identification](05_identify.ipynb).
# - The motion of least effort: [06, optimal motions](06_optimal_motion.ipynb).
# - Why it is fast: [07, speed](07_speed.ipynb).
