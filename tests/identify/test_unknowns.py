"""What is said of unknowns that make no sense, or do not fit the plant."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import kanejax as kj
from kanejax._parameters.parameterization import parameterization
from kanejax._parameters.plant import Drives, Plant
from kanejax._parameters.priors import Entropic, Gaussian, Geodesic
from kanejax._parameters.unknowns import Unknown

INERTIAL = '<inertial pos="0 0 0.1" mass="1" diaginertia="0.1 0.2 0.25"/>'
XML = f"""<mujoco><worldbody><body name="base">{INERTIAL}<body name="arm">{INERTIAL}<joint name="yaw" damping="0.3"/>
<body name="wrist1">{INERTIAL}<joint name="lift" type="slide" damping="0.1"/>
<body name="wrist2">{INERTIAL}<joint name="roll" damping="0.5"/></body></body></body></body></worldbody></mujoco>"""
BALL = f'<mujoco><worldbody><body name="head">{INERTIAL}<joint name="neck" type="ball"/></body></worldbody></mujoco>'


def ideal(model: kj.Model) -> Plant:
    return Plant(model, Drives.ideal(model))


@pytest.fixture(scope="module")
def plant() -> Plant:
    return ideal(kj.load(XML))


MISTAKES = {
    "leaf": (lambda: Unknown("friction"), "no leaf that can be identified is named 'friction'; the names are: 'inertia', 'mass'"),
    "range": (lambda: Unknown("joint_range"), "no leaf that can be identified is named 'joint_range'"),
    "tie": (
        lambda: Unknown("inertia", tied=True),
        r"Unknown\('inertia'\) cannot be tied: a tie joins single numbers, such as 'damping'",
    ),
    "pair": (
        lambda: Unknown("damping", bounds=(1.0,)),
        r"are \(1.0,\); give a pair, least and greatest",
    ),
    "order": (lambda: Unknown("damping", bounds=(2.0, 1.0)), r"are 2.0 and 1.0; the first must be less than the second"),
    "count": (lambda: Unknown("com", bounds=((1.0, 2.0), None)), r"a bound of Unknown\('com'\) has 2 numbers; give one, or 3"),
    "no bounds": (
        lambda: Unknown("inertia", bounds=(0, 1)),
        "takes no bounds: all that it can become is physical",
    ),
    "prior": (
        lambda: Unknown("damping", prior=Entropic()),
        "has prior Entropic.*, which is for 'inertia'; use Gaussian",
    ),
    "relative": (
        lambda: Unknown("joint_axis", prior=Gaussian(1.0, relative=True)),
        "relative Gaussian prior, but some .* naturally zero",
    ),
    "std": (lambda: Gaussian(0.0), "std of Gaussian is 0.0; it must be positive and finite"),
    "stds": (lambda: Gaussian((1.0, -1.0)), "std of Gaussian is -1.0; it must be positive and finite"),
    "entropic": (lambda: Entropic(-1.0), "std of Entropic is -1.0; it must be positive and finite"),
    "geodesic": (lambda: Geodesic(float("inf")), "std of Geodesic is inf; it must be positive and finite"),
    "scale": (lambda: Unknown("damping", scale=0.0), r"scale of Unknown\('damping'\) is 0.0; it must be positive and finite"),
    "one scale": (lambda: Unknown("inertia", scale=1.0), r"is 1.0; give a pair, mass \[kg\] and radius of gyration \[m\]"),
    "two scales": (lambda: Unknown("damping", scale=(1.0, 1.0)), r"is \(1.0, 1.0\); give one number"),
}


@pytest.mark.parametrize(("make", "says"), MISTAKES.values(), ids=MISTAKES)
def test_mistakes_in_unknowns(make, says):
    with pytest.raises((kj.UnknownNameError, ValueError), match=says):
        make()


MISFITS = {
    "nothing": ([], "nothing is sought; give at least one unknown, such as 'inertia'"),
    "body": ([Unknown("mass", "yaw")], "no body is named 'yaw'; the names are: 'base', 'arm', 'wrist1', 'wrist2'"),
    "pattern": ([Unknown("damping", "wrist*")], "no joint is named 'wrist\\*'; the names are: 'yaw', 'lift', 'roll'"),
    "predicate": ([Unknown("damping", lambda name: False)], r"Unknown\('damping'\) selects no joint; the names are: 'yaw', 'lift'"),
    "no names": ([Unknown("mass", [])], r"Unknown\('mass'\) selects no body; the names are: 'base'"),
    "whole": ([Unknown("delay", "yaw")], r"Unknown\('delay'\) belongs to the whole plant; leave `of` out"),
    "twice": (["damping", Unknown("damping", "lift")], "joint 'lift': 'damping' is sought twice"),
    "twice a body": (["com", Unknown("com", "arm")], "body 'arm': 'com' is sought twice"),
    "twice the plant": (["delay", "delay"], "the plant: 'delay' is sought twice"),
    "twice a zero": (
        ["coordinate_reference", Unknown("coordinate_reference", "roll")],
        "joint 'roll': 'coordinate_reference' is",
    ),
    "part": (["inertia", Unknown("mass", "arm")], "body 'arm': 'mass' is part of 'inertia', which is sought too; leave one out"),
    "bounds": ([Unknown("offset", bounds=(1.0, 2.0))], r"yaw\.offset is 0 in the given plant, outside of its bounds 1 to 2"),
    "units": ([Unknown("damping", tied=True)], r"Unknown\('damping'\) ties numbers of different units: N m s/rad, N s/m"),
    "relative": (
        [Unknown("offset", prior=Gaussian(0.1, relative=True))],
        r"yaw\.offset is 0 in .*, and its Gaussian prior is relative",
    ),
    "std": ([Unknown("com", prior=Gaussian((1.0, 2.0)))], r"prior of Unknown\('com'\) has 2 standard deviations; give one, or 3"),
    "ten": ([Unknown("inertia", prior=Gaussian(1.0))], "a Gaussian prior of 'inertia' needs ten standard deviations"),
}


@pytest.mark.parametrize(("unknowns", "says"), MISFITS.values(), ids=MISFITS)
def test_unknowns_that_do_not_fit_the_plant(plant, unknowns, says):
    with pytest.raises((kj.UnknownNameError, ValueError), match=says):
        parameterization(plant, unknowns)


def test_plants_that_do_not_fit(plant):
    negative = Plant(plant.model.replace(damping=[0.1, -0.2, 0.3]), plant.drives)
    with pytest.raises(kj.InvalidParameterError, match=r"lift\.damping is -0\.2 .*, outside of its default bounds 0 to inf"):
        parameterization(negative, ["damping"])
    with pytest.raises(kj.InvalidParameterError, match=r"arm\.m is nan; what is sought must start at a finite number"):
        parameterization(Plant(plant.model.body("arm").set(mass=np.nan), plant.drives), ["inertia"])
    with pytest.raises(ValueError, match=r"joint 'neck' is ball and has no joint_axis"):
        parameterization(ideal(kj.load(BALL)), [Unknown("joint_axis", "neck")])
    with pytest.raises(ValueError, match=r"theta has shape \(2,\), but this parameterization needs \(3,\)"):
        parameterization(plant, ["damping"]).phi(jnp.zeros(2))
    batch = jax.tree.map(lambda x: jnp.stack((x, x)), plant)
    with pytest.raises(ValueError, match=r"model.gravity has shape \(2, 3\), but this tree needs \(3,\)"):
        parameterization(batch, ["damping"])
