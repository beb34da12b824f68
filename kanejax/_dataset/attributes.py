"""What a data set says of itself: where it comes from, and in what shape it is."""

import importlib.metadata
from typing import Any

from kanejax._dataset.store import LAST, ArrayLayout
from kanejax._dataset.study import GivenForces, RandomForces, Study
from kanejax._fingerprint import fingerprint_of
from kanejax._model.model import leaf_shapes
from kanejax._simulate.trajectory import Status
from kanejax.distributions import AbstractDistribution

# What the digits of a trajectory depend on.
_PACKAGES = ("jax", "jaxlib", "equinox", "diffrax", "numpy", "scipy")
_UNITS = {"revolute": ("rad", "rad/s", "N m"), "prismatic": ("m", "m/s", "N")}


def attributes_of(study: Study, source: dict[str, Any]) -> dict[str, Any]:
    """Of the root: all that the trajectories depend on, so that two data sets with the same attributes hold the same.

    Args:
        study: what is simulated.
        source: where the model is from, such as {"robot": "arm.urdf", "robot_sha256": "..."}.
    """
    from kanejax import __version__

    tree, options = study.model.tree, dict(study.options)
    events = options.pop("events", None)
    described = {
        "trajectories": study.trajectories,
        "seed": study.seed,
        "model_fingerprint": fingerprint_of(study.model),
        "times_fingerprint": fingerprint_of(study.ts),
        "dtype": str(study.model.dtype),
        "q0": "uniform within the joints' ranges" if study.q0 is None else _described(study.q0),
        "u0": _described(study.u0),
        "forces": _described_forces(study.control),
        "parameters": {name: f"{random.how}: {_described(random.distribution)}" for name, random in study.parameters.items()},
        "solver": str(options.pop("solver", "Tsit5()")),
        "options": {name: str(value) for name, value in sorted(options.items())},
        "events": "none" if events is None else fingerprint_of(events),
        "joint_names": list(tree.joint_names),
        "body_names": list(tree.body_names),
        "versions": {"kanejax": __version__, **{name: importlib.metadata.version(name) for name in _PACKAGES}},
    }
    return source | described


def layout_of(study: Study) -> dict[str, ArrayLayout]:
    """The arrays of a data set."""
    model, count, dtype = study.model, study.trajectories, str(study.model.dtype)
    tree, nan = model.tree, float("nan")
    coordinates = {"joints": list(tree.joint_names), "units": "rad and m, quaternions (w, x, y, z)"}
    speeds = {"joints": list(tree.joint_names), "units": "rad/s and m/s"}

    def moving(shape: tuple[int, ...], dimensions: tuple[str, ...], attributes: dict[str, Any]) -> ArrayLayout:
        return ArrayLayout((count, *shape), dtype, ("trajectory", *dimensions), nan, attributes)

    times = len(study.ts)
    arrays = {
        "time": ArrayLayout((times,), dtype, ("time",), 0.0, {"units": "s"}, study.ts),
        "q": moving((times, tree.nq), ("time", "coordinate"), coordinates | {"long_name": "generalized coordinates"}),
        "u": moving((times, tree.nv), ("time", "speed"), speeds | {"long_name": "generalized speeds"}),
        "t_end": moving((), (), {"units": "s", "long_name": "time at which the simulation ended"}),
        "num_steps": ArrayLayout((count,), "int32", ("trajectory",), -1, {"long_name": "steps of the integration"}),
    }
    shapes = leaf_shapes(tree)
    for name, leaf in study.rows(0, 1).leaves.items():
        arrays[name] = moving(leaf.shape[1:], _dimensions(name, shapes[name]), {"long_name": f"{name} of the model"})
    if study.force_times is not None:
        ts = study.force_times
        arrays["force_time"] = ArrayLayout((len(ts),), dtype, ("force_time",), 0.0, {"units": "s"}, ts)
        assert study.control is not None
        forces = {"units": "N m and N", "long_name": "forces at the joints", "interpolation": study.control.interpolation}
        arrays["tau"] = moving((len(ts), tree.nv), ("force_time", "speed"), forces)
    meanings = {"flag_values": [int(status) for status in Status], "flag_meanings": " ".join(status.name for status in Status)}
    arrays[LAST] = ArrayLayout((count,), "int8", ("trajectory",), int(Status.NOT_RUN), {"long_name": "how it ended"} | meanings)
    return arrays


def _described(source: Any) -> str:
    """A distribution in words, or the hash of what is given."""
    if isinstance(source, AbstractDistribution):
        return str(source)
    return f"given, fingerprint {fingerprint_of(source)}"


def _described_forces(control: RandomForces | GivenForces | None) -> str:
    if control is None:
        return "none"
    if isinstance(control, RandomForces):
        return f"{_described(control.distribution)} every {control.period} s, {control.interpolation}"
    return f"given, fingerprint {fingerprint_of(control.ts, control.values)}, {control.interpolation}"


def _dimensions(name: str, shape: tuple[int, ...]) -> tuple[str, ...]:
    """Names for the axes of a leaf."""
    first = {
        "gravity": "axis",
        "body_position": "body",
        "body_quaternion": "body",
        "joint_axis": "joint",
        "joint_anchor": "joint",
        "mass": "body",
        "com": "body",
        "central_inertia": "body",
        "stiffness": "joint",
        "joint_range": "joint",
        "spring_reference": "coordinate",
        "coordinate_reference": "coordinate",
    }.get(name, "speed")
    rest = {"body_quaternion": ("component",), "joint_range": ("end",), "central_inertia": ("row", "axis")}
    return (first, *rest.get(name, ("axis",)))[: len(shape)]
