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
import importlib.metadata

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
# An xArm 7, with a load in its hand and links whose masses are not quite as the file says. `jax.vmap` over a function that returns a
# model gives a model with a batch axis: 4096 robots.

# %%
urdf = next(file for file in importlib.metadata.files("example-robot-data") if file.name == "xarm7.urdf").locate()
arm = kj.with_payload(kj.load(urdf), "link7", "load", position=[0.0, 0.0, 0.1])


def robot(load, factors):
    return arm.replace(mass=arm.mass * factors).body("load").set(mass=load)


loads = random.uniform(0.0, 4.0, COUNT)
factors = np.exp(0.1 * random.normal(size=(COUNT, arm.nbody)))
robots = jax.jit(jax.vmap(robot))(loads, factors)

print("masses of the first three [kg]:\n", robots.mass[:3])

# %% [markdown]
# And postures within the ranges of the joints, at rest.

# %%
low, high = np.clip(arm.joint_range, -np.pi, np.pi).T
q0 = random.uniform(low, high, (COUNT, arm.nq))
u0 = np.zeros((COUNT, arm.nv))

# %% [markdown]
# ## Falling, and what energy says
#
# First without friction and motors: every arm falls for a second, and its energy should stay what it was. `simulate_batch` takes
# robots and states one by one; an arm that needs few steps makes room for the next, on all cores.

# %%
frictionless = jax.vmap(lambda robot: robot.replace(damping=jnp.zeros(arm.nv), coulomb_friction=jnp.zeros(arm.nv)))(robots)
ts = np.linspace(0.0, 1.0, 51)


@jax.jit
@jax.vmap
def energy_range(robot, q, u):
    """Kinetic energy at most, and by how much the total one strays."""
    kinetic = jax.vmap(kj.kinetic_energy, (None, 0, 0))(robot, q, u)
    total = kinetic + jax.vmap(kj.potential_energy, (None, 0))(robot, q)
    return jnp.max(kinetic), jnp.max(jnp.abs(total - total[0]))


drift = {}
for rtol in (1e-4, 1e-6, 1e-8):
    fall = kj.simulate_batch(frictionless, q0, u0, ts, rtol=rtol, atol=rtol)
    kinetic, strayed = energy_range(frictionless, fall.q, fall.u)
    drift[rtol] = strayed / kinetic
    print(f"rtol {rtol:.0e}: {np.mean(fall.stats['num_steps']):4.0f} steps on average, worst drift {np.max(drift[rtol]):.0e}")

figure, axes = plt.subplots(figsize=(7, 3), layout="constrained")
for (rtol, each), color in zip(drift.items(), ("#d55e00", "#0072b2", "#009e73"), strict=True):
    axes.hist(np.log10(each), bins=60, color=color, alpha=0.75, label=f"rtol = {rtol:.0e}")
axes.set(xlabel=r"$\log_{10}$ of the drift of energy over the greatest kinetic energy", ylabel="trajectories")
axes.legend(frameon=False)
axes.spines[["top", "right"]].set_visible(False)
plt.show()

# %% [markdown]
# ## How each ended
#
# Now with friction, and with the joints' ranges as the end of a trajectory. Into one initial state we put a speed that is not a number,
# as happens in real data. `status` tells of every trajectory how it ended, and one that fails leaves the others their bits.

# %%
broken = u0.copy()
broken[1234, 2] = np.nan

ended = kj.simulate_batch(robots, q0, broken, ts, joint_limits=True)
whole = kj.simulate_batch(robots, q0, u0, ts, joint_limits=True)

print({kj.Status(status).name: number for status, number in collections.Counter(ended.status.tolist()).items()})
others = np.arange(COUNT) != 1234
print("all others the same, bit by bit:", np.array_equal(ended.q_end[others], whole.q_end[others]))

figure, axes = plt.subplots(figsize=(7, 3), layout="constrained")
stopped = ended.status == kj.Status.EVENT
axes.hist(ended.t_end[stopped], bins=50, color="#0072b2")
axes.set(xlabel="time [s]", ylabel="arms that reach an end of a range", xlim=(0, 1))
axes.spines[["top", "right"]].set_visible(False)
plt.show()
