# ---
# jupyter:
#   jupytext:
#     formats: ipynb,py:percent
# ---

# %% [markdown]
# # Identify a robot from its log
#
# The masses in a robot's file are often guesses, and friction is seldom in it at all. A recording of positions and motor torques
# tells more. You will see
#
# - a simulated UR5 that carries something its file does not know of, identified from 24 s of noisy data,
# - what the data determine, how exactly, and what they cannot tell,
# - a real UR10e, identified from its motor currents, if you have the recordings.
#
# [docs/identification.md](../docs/identification.md) is the guide.

# %%
import os
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
from IPython.display import display

import kanejax as kj

jax.config.update("jax_enable_x64", True)
np.set_printoptions(precision=2, suppress=True)
random = np.random.default_rng(0)

# %% [markdown]
# ## A robot that is not what its file says
#
# The nominal robot is the URDF. The true one carries 1.5 kg, its forearm is a fifth heavier, and it has friction: viscous, and
# dry.

# %%
urdf = kj.robots.example_file("ur5_joint_limited_robot.urdf")
nominal = kj.load(urdf)

truth = kj.with_payload(nominal, "wrist_3_link", "load", position=[0.0, 0.1, 0.0]).body("load").set(mass=1.5)
truth = truth.body("forearm_link").set(mass=1.2 * nominal.body("forearm_link").mass)
truth = truth.replace(
    damping=[4.0, 4.0, 3.0, 1.0, 1.0, 1.0],
    coulomb_friction=[5.0, 5.0, 4.0, 1.5, 1.2, 1.0],
    friction_width=np.full(6, 2e-4),
)

# %% [markdown]
# ## Recordings
#
# All joints move at once, with several frequencies. (`kj.excitation` designs such a motion so that it tells most, within the
# robot's limits; here its amplitudes are random.) The log has positions, and torques with noise of 3 %; another motion is held
# out.


# %%
def recording(name, speeds):
    motion = kj.FourierMotion(nominal.tree.joint_names, 10.0, np.zeros(6), *speeds)
    states = kj.motion_table(motion, rate=200.0, periods=2, start=np.zeros(6), blend=2.0)
    tau = jax.jit(jax.vmap(kj.inverse_dynamics, (None, 0, 0, 0)))(truth, states.q, states.u, states.u_dot)
    noise = 0.03 * np.std(tau, axis=0) * random.normal(size=tau.shape)
    q = states.q + 1e-4 * random.normal(size=tau.shape)
    return kj.Log(nominal.tree.joint_names, kj.Run(name, states.ts, q, np.asarray(tau + noise)))


log = recording("a random motion", 0.4 * random.normal(size=(2, 6, 5)))
held_out = recording("another one", 0.4 * random.normal(size=(2, 6, 5)))

# %% [markdown]
# ## Identify
#
# One call filters and differentiates the log, finds what the motion can tell, and fits inertias, friction and offsets among those
# that a robot can have: every body stays physical, whatever the data say.

# %%
found = kj.identify(nominal, log, ("inertia", "damping", "coulomb_friction", "offset"), validation=held_out)
assert found.converged

(run,) = found.validation
print("torque that is not predicted, of a motion that was not fitted [%]")
print("  by the file:     ", 100 * kj.relative_error(run, run.nominal))
print("  by what is found:", 100 * kj.relative_error(run))
kj.plots.torque_fit(found, joints=["elbow_joint", "wrist_1_joint"])

# %% [markdown]
# What is left is the noise that we put in. Friction, with its 95 % intervals. They know of noise, also of noise that lasts, but
# not of a model that is wrong: had the true friction not set in at once, as it does here and in the fit, more of them would miss.

# %%
friction = [f"{joint}.{kind}" for kind in ("damping", "coulomb_friction") for joint in nominal.tree.joint_names]
true = np.concatenate((truth.damping, truth.coulomb_friction))
inside = sum(found[name].lower < value < found[name].upper for name, value in zip(friction, true, strict=True))

for name, value in zip(friction, true, strict=True):
    print(f"{name:36s} true {value:.2f}, found {found[name].value:.3f} +- {found[name].std:.3f} {found[name].unit}")
print(f"{inside} of {len(friction)} intervals have the true value in them")
kj.plots.parameters(found, friction)

# %% [markdown]
# ## What the data cannot tell
#
# No motion of the arm tells how much mass is in the upper arm and how much in the forearm: it tells sums. The library says which,
# and gives intervals only to what is determined alone.

# %%
alone = [each.name for each in found.estimates if each.determined == "alone"]
print(f"{len(found.estimates)} parameters, {len(alone)} determined alone; {len(found.base.formulas)} numbers count, among them")
sums = [i for i, formula in enumerate(found.base.formulas) if " + " in formula]
for i in sorted(sums, key=lambda i: len(found.base.formulas[i]))[:3]:
    print(f"  {found.base.formulas[i]} = {found.base.value[i]:.4f} +- {found.base.std[i]:.4f}")

# %% [markdown]
# These numbers are all that torques and motion depend on. So the mass matrix of what was found should be the true robot's, at any
# posture, although single masses may not:

# %%
mass_matrices = jax.jit(jax.vmap(kj.mass_matrix, (None, 0)))
q = jnp.asarray(random.uniform(-np.pi, np.pi, (1000, 6)))
true_matrices = mass_matrices(truth, q)
for name, model in {"file": nominal, "found": found.model}.items():
    off = jnp.linalg.norm(mass_matrices(model, q) - true_matrices, axis=(1, 2)) / jnp.linalg.norm(true_matrices, axis=(1, 2))
    print(f"mass matrix, {name:5s}: {100 * jnp.max(off):5.1f} % off at most, over {len(q)} postures")

# %% [markdown]
# ## A real UR10e
#
# Recordings of a real arm come with [shamilmamedov/dynamic_calibration](https://github.com/shamilmamedov/dynamic_calibration);
# they are not part of this project. Put two of the CSV files and the URDF into a folder `ur10e`, and set the environment variable
# `KANEJAX_DATA` to the folder around it.

# %%
folder = Path(os.environ.get("KANEJAX_DATA", "data")) / "ur10e"
training, point_to_point = "ur-20_02_10-30sec_12harm.csv", "ur-20_01_17-ptp_10_points.csv"
available = all((folder / name).is_file() for name in ("ur10e.urdf", training, point_to_point))

if not available:
    print("=" * 80)
    print("NOT RUN: there are no recordings of the UR10e here. NOTHING below is about a real robot.")
    print("=" * 80)

# %% [markdown]
# Columns and units are told by numbers and names; currents become torques by the motors' published gains. The filters are those
# of the reference baselines, so that errors can be compared. Trained on 31 s of a Fourier motion, tested on motion from point to
# point:

# %%
if available:
    arm = kj.load(folder / "ur10e.urdf")
    gains = (10.0000, 10.6956, 8.4566, 9.0029, 9.4800, 10.1232)  # N m/A
    plant = kj.Plant(arm, kj.Drives.ideal(arm).replace(gain=gains))
    columns = kj.Columns(time=0, position=range(1, 7), velocity=range(7, 13), effort=range(13, 19))
    filters = {"cutoff": 0.15, "cutoff_unit": "Nyquist", "accuracy": 2, "resampling": None, "trim": 0.0}

    def read(file, rows):
        return kj.read_log(folder / file, arm.tree.joint_names, columns=columns, units=kj.Units(effort="A"), rows=rows)

    real = kj.identify(
        plant,
        read(training, rows=(635, 3510)),
        ("inertia", "armature", "damping", "coulomb_friction", "offset"),
        validation=kj.motions(read(point_to_point, rows=(700, 4200)), arm, **filters),
        motion_options={**filters, "effort_cutoff": 0.20},
    )
    (run,) = real.validation
    print("current that is not predicted, of each joint [%]")
    print("  URDF, no friction:       ", 100 * kj.relative_error(run, run.nominal))
    print("  weighted least squares:   [12.81  5.27  5.61  9.39 15.7  54.96] (comes with the data)")
    print("  kanejax:                 ", 100 * kj.relative_error(run))
    shown = ["shoulder_pan_joint", "elbow_joint", "wrist_1_joint", "wrist_3_joint"]
    display(kj.plots.torque_fit(real, joints=shown))

# %% [markdown]
# The last joint hardly moves in this recording; what differs there is friction near rest.
#
# What was found is a model like any other: simulate it, differentiate it, write it with `kj.to_mjcf` or `kj.to_urdf_inertials`.
#
# ## Where to go next
#
# - From a terminal, with a report: `kanejax identify arm.urdf log.csv --out result`.
# - Payloads, delays, priors, robust fits, the fit of simulated to measured motion:
#   [docs/identification.md](../docs/identification.md).
# - All baselines and variants on the UR10e: `python -m experiments.identification.ur10e`.
# - A motion for the robot just found: [06, optimal motions](06_optimal_motion.ipynb).
