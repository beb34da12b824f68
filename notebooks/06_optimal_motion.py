# ---
# jupyter:
#   jupytext:
#     formats: ipynb,py:percent
# ---

# %% [markdown]
# # Optimise a motion, and check it
#
# A robot has to go from one posture to another: with as little effort as possible, or in as little time. You will see
#
# - both motions of a UR10, within limits of position, speed and torque,
# - whether they arrive when MuJoCo replays the torques,
# - what becomes of one if the robot carries something nobody told of, and feedback that brings it back.
#
# [docs/optimization.md](../docs/optimization.md) is the guide.

# %%
import jax
import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np

import kanejax as kj

jax.config.update("jax_enable_x64", True)
np.set_printoptions(precision=4, suppress=True)

urdf = kj.robots.example_file("ur10_robot.urdf")
arm = kj.load(urdf).replace(armature=np.full(6, 0.2))  # inertia of the rotors [kg m^2]: the file has none, and a real arm has

# %% [markdown]
# ## A task
#
# Start and goal at rest, a duration, limits, and what it costs: here the integral of the squared torques. Ranges of the joints
# are the model's; the other limits are this robot's.

# %%
limits = kj.Limits(arm, u=[2.0, 2.0, 3.0, 3.0, 3.0, 3.0], tau=[330.0, 330.0, 150.0, 56.0, 56.0, 56.0])
start = jnp.array([-1.0, -0.4, 0.8, -0.6, 0.5, 0.0])
goal = jnp.array([1.0, -0.6, 1.2, -1.0, -0.5, 0.5])

task = kj.MotionTask(arm, start, goal, 1.3, kj.costs.torque(), limits=limits)
motion = kj.optimize(task)

print(f"cost {motion.cost:.1f} N^2 m^2 s, after {motion.iterations} iterations, converged: {bool(motion.converged)}")
kj.plots.motion(arm, motion, limits=limits, joints=["shoulder_pan_joint", "shoulder_lift_joint", "elbow_joint"])

# %% [markdown]
# Limits are dashed where they are near. The elbow bends on the way, since a short arm turns more easily. The conditions of
# optimality hold to 1e-8: no motion nearby is better.
#
# A straight way there with the same timing for all joints, a polynomial of fifth degree, is also a motion. Compare:

# %%
s = np.linspace(0.0, 1.0, len(motion.ts))[:, None]
rise = 10 * s**3 - 15 * s**4 + 6 * s**5
rise_rate, rise_rate_2 = (30 * s**2 - 60 * s**3 + 30 * s**4) / 1.3, (60 * s - 180 * s**2 + 120 * s**3) / 1.3**2
way = goal - start
tau = jax.vmap(kj.inverse_dynamics, (None, 0, 0, 0))(arm, start + way * rise, way * rise_rate, way * rise_rate_2)
straight = np.trapezoid(np.sum(tau**2, axis=1), motion.ts)
print(f"straight: {straight:.1f} N^2 m^2 s, {straight / motion.cost:.2f} times the optimum's")

# %% [markdown]
# ## As fast as possible
#
# The duration may be sought as well: a pair of bounds in place of a number, and a cost for it. A little of the first cost keeps
# torques from jumping between their limits where that gains nothing.

# %%
terms = (kj.costs.duration(1.0), kj.costs.torque(1e-6))
hasty = kj.optimize(kj.MotionTask(arm, start, goal, (0.3, 3.0), terms, limits=limits))

print(f"{hasty.duration:.3f} s in place of 1.3 s, after {hasty.iterations} iterations, converged: {bool(hasty.converged)}")
kj.plots.motion(arm, hasty, limits=limits, joints=["shoulder_pan_joint", "shoulder_lift_joint", "elbow_joint"])

# %% [markdown]
# ## Does it arrive?
#
# An optimiser believes its own steps, in each of which accelerations are constant. So the torques, and nothing else, are given to
# MuJoCo with its method of Runge and Kutta, and to this library's adaptive steps:

# %%
for name, each in {"least effort": motion, "least time": hasty}.items():
    in_mujoco, adaptive = kj.replayed_by_mujoco(arm, each), kj.replayed(arm, each)
    off, apart = (np.rad2deg(np.abs(error).max()) for error in (in_mujoco.q[-1], in_mujoco.q - adaptive.q))
    print(f"{name}: {off:.2f} degrees off the goal in MuJoCo, which differs from ours by {apart:.0e} degrees on the way")

# %% [markdown]
# Both agree on where the torques lead. What is off is the optimiser's, whose 50 steps are of the second order: twice as many
# (`steps=100`) make it a quarter.
#
# ## A load that nobody told of
#
# Now the hand holds 2 kg. Torques that were made for an empty hand do not bring it to the goal. `kj.tracking` makes a feedback
# along the motion, the linear-quadratic regulator, from the model as it was believed to be:

# %%
loaded = kj.with_payload(arm, "wrist_3_link", "load", position=[0.0, 0.1, 0.0]).body("load").set(mass=2.0)
feedback = kj.tracking(arm, motion, q_error=0.002)

alone = kj.replayed_by_mujoco(loaded, motion)
held = kj.replayed_by_mujoco(loaded, motion, feedback)

figure, axes = plt.subplots(figsize=(7, 3), layout="constrained")
axes.semilogy(motion.ts[1:], np.rad2deg(np.abs(alone.q[1:]).max(axis=1)), color="#c4620a", label="torques alone")
axes.semilogy(motion.ts[1:], np.rad2deg(np.abs(held.q[1:]).max(axis=1)), color="#0b62b0", label="with feedback")
axes.set(xlabel="time [s]", ylabel="largest deviation of a joint [degrees]", xlim=(0, 1.3))
axes.legend(frameon=False)
axes.spines[["top", "right"]].set_visible(False)
plt.show()

# %% [markdown]
# The feedback is a `control` for `kj.simulate` like any other:

# %%
path = kj.simulate(loaded, start, jnp.zeros(arm.nv), np.asarray(motion.ts), control=feedback)
kj.plots.coordinates(arm, path, reference=motion, joints=["wrist_1_joint", "wrist_2_joint"])

# %% [markdown]
# ## Where to go next
#
# - Obstacles, goals in space, costs of your own, thousands of tasks at once, derivatives of the optimum with respect to the
#   robot: [docs/optimization.md](../docs/optimization.md).
# - From a terminal, with a page on which the robot moves: `kanejax optimize --example > task.toml`.
# - The load, found from the torques: [05, identify a robot](05_identify.ipynb).
