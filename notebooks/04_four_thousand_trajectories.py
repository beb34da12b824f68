# ---
# jupyter:
#   jupytext:
#     formats: ipynb,py:percent
# ---

# %% [markdown]
# # Four thousand trajectories
#
# Simulations are seldom needed one at a time. Here 4096 robots, no two alike, start in 4096 postures. You will see
#
# - what makes a batch of robots, and how it is simulated on all cores,
# - the energy of each, which says how well each was integrated,
# - how each ended, among them one that could not be simulated,
# - and how a controller copes with loads that it does not know, as quantiles over time.

# %%
import collections

import jax
import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np

import kanejax as kj

jax.config.update("jax_enable_x64", True)
np.set_printoptions(precision=3, suppress=True)

COUNT = 4096
random = np.random.default_rng(0)

# %% [markdown]
# ## Robots, no two alike
#
# A UR5 with a load in its hand of up to 4 kg, and links whose masses are not quite those of the file. `jax.vmap` over a function
# that returns a model gives a model whose arrays have a batch axis: 4096 robots.

# %%
urdf = kj.robots.example_file("ur5_joint_limited_robot.urdf")
arm = kj.with_payload(kj.load(urdf), "wrist_3_link", "load", position=[0.0, 0.15, 0.0])


def robot(load, factors):
    return arm.replace(mass=arm.mass * factors).body("load").set(mass=load)


loads = random.uniform(0.0, 4.0, COUNT)
factors = np.exp(0.1 * random.normal(size=(COUNT, arm.nbody)))
robots = jax.jit(jax.vmap(robot))(loads, factors)

links = [arm.tree.body(name) for name in ("upper_arm_link", "forearm_link", "load")]
print("upper arm, forearm and load of the first three [kg]:\n", robots.mass[:3, links])

# %% [markdown]
# And postures anywhere within the ranges of the joints, at rest.

# %%
low, high = np.asarray(arm.joint_range).T
q0 = random.uniform(low, high, (COUNT, arm.nq))
u0 = np.zeros((COUNT, arm.nv))

# %% [markdown]
# ## Falling, and what energy says
#
# The file has no friction, and nothing drives the joints: every arm falls for a second, and its energy should stay what it was.
# `simulate_batch` takes robots and states one by one, on all cores; an arm that needs few steps makes room for the next.
# Both runs share one compiled program.

# %%
ts = np.linspace(0.0, 1.0, 51)


@jax.jit
@jax.vmap
def drift_of_energy(robot, q, u):
    """How far the energy strays, relative to the greatest kinetic energy."""
    kinetic = jax.vmap(kj.kinetic_energy, (None, 0, 0))(robot, q, u)
    total = kinetic + jax.vmap(kj.potential_energy, (None, 0))(robot, q)
    return jnp.max(jnp.abs(total - total[0])) / jnp.max(kinetic)


figure, axes = plt.subplots(figsize=(7, 3), layout="constrained")
for tolerance, color in ((1e-5, "#c4620a"), (1e-8, "#0b62b0")):
    fall = kj.simulate_batch(robots, q0, u0, ts, rtol=tolerance, atol=tolerance)
    drift = np.asarray(drift_of_energy(robots, fall.q, fall.u))
    steps = fall.stats["num_steps"]
    print(f"tolerance {tolerance:.0e}: {np.min(steps)} to {np.max(steps)} steps, worst drift {np.max(drift):.0e}")
    axes.hist(np.log10(drift), bins=60, color=color, alpha=0.8, label=f"tolerance {tolerance:.0e}")
axes.set(xlabel="$\\log_{10}$ of the drift, relative to the greatest kinetic energy", ylabel="trajectories")
axes.legend(frameon=False)
axes.spines[["top", "right"]].set_visible(False)
plt.show()

# %% [markdown]
# Every trajectory has steps of its own, so that one that is hard to integrate costs the others nothing.
#
# ## How each ended
#
# Now an arm stops where a joint comes to the end of its range. And into one initial state we put a speed that is not a number, as
# happens in real data.

# %%
broken = u0.copy()
broken[1234, 2] = np.nan

fallen = kj.simulate_batch(robots, q0, broken, ts, joint_limits=True)

for status, number in sorted(collections.Counter(fallen.status.tolist()).items()):
    print(f"{number:5d} {kj.Status(status).name}")

stopped = fallen.status == kj.Status.EVENT
figure, axes = plt.subplots(figsize=(7, 2.6), layout="constrained")
axes.hist(fallen.t_end[stopped], bins=50, color="#0b62b0")
axes.set(xlabel="time at which an arm comes to the end of a range [s]", ylabel="arms", xlim=(0, 1))
axes.spines[["top", "right"]].set_visible(False)
plt.show()

# %% [markdown]
# `status` tells of each how it ended; `t_end`, `q_end` and `u_end` when and where. The one that could not be simulated left the
# others alone:

# %%
whole = kj.simulate_batch(robots, q0, u0, ts, joint_limits=True)
others = np.arange(COUNT) != 1234
for name in ("status", "t_end", "q_end", "u_end", "q", "u"):
    assert np.array_equal(getattr(fallen, name)[others], getattr(whole, name)[others], equal_nan=True)
print("all others: the same, to the last bit")

# %% [markdown]
# ## Loads that the controller does not know
#
# Last, all arms go from one posture to another under a controller that takes the load for 2 kg, and the links for what the file
# says. A batched model is for the arms; the controller closes over its own.

# %%
start = jnp.array([-0.8, -0.6, 1.0, -0.8, 0.5, 0.0])
goal = jnp.array([0.8, -1.2, 1.4, -0.4, -0.5, 0.0])
expected = arm.body("load").set(mass=2.0)


def control(t, q, u):
    pull = 40.0 * (goal - q) - 12.0 * u
    return kj.inverse_dynamics(expected, q, u, pull)


reach = kj.simulate_batch(robots, np.tile(start, (COUNT, 1)), u0, np.linspace(0.0, 2.0, 101), control=control)
assert np.all(reach.ok)
kj.plots.quantiles(arm, reach)

# %% [markdown]
# Bands: what half and what nine tenths of the arms do. Elbow and wrist give way most. Where do the hands end up, and is it the
# load?

# %%
hand = arm.tree.body("load")
at = jax.jit(jax.vmap(lambda robot, q: kj.poses(robot, q).origin[hand]))(robots, reach.q[:, -1])
miss = 100 * np.linalg.norm(np.asarray(at - kj.poses(arm, goal).origin[hand]), axis=1)

figure, axes = plt.subplots(figsize=(7, 3), layout="constrained")
axes.scatter(loads, miss, s=3, color="#0b62b0", linewidths=0)
axes.set(xlabel="load in the hand [kg]", ylabel="miss after 2 s [cm]", xlim=(0, 4), ylim=(0, None))
axes.spines[["top", "right"]].set_visible(False)
plt.show()

# %% [markdown]
# ## Where to go next
#
# - More trajectories than fit the memory: `kj.Study` and `kj.write_study` stream a million of them to a Zarr store, and go on
#   after an interruption. [docs/scale.md](../docs/scale.md) has that, and many devices.
# - When simulations fail, and what helps: [docs/numerics.md](../docs/numerics.md).
# - The load from the torques: [05, identify a robot](05_identify.ipynb).
