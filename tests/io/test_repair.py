"""Inertias that MuJoCo refuses: kept when they are sound, refused by name when not, changed or kept on request."""

import warnings

import mujoco
import numpy as np
import pytest

from kanejax._errors import InvalidInertiaError, ModelFileError, UnphysicalInertiaWarning, UnsupportedModelError
from kanejax._io.inertial import defect, nearest_physical_moments
from kanejax._io.source import compile_source

BROKEN = (1.0, 1.0, 3.0)


def inertial(mass: float, moments: tuple[float, float, float], com: str = "0.1 0 0", rpy: str = "0.3 0.4 0.5") -> str:
    ixx, iyy, izz = moments
    inertia = f'<inertia ixx="{ixx}" iyy="{iyy}" izz="{izz}" ixy="0" ixz="0" iyz="0"/>'
    return f'<inertial><origin xyz="{com}" rpy="{rpy}"/><mass value="{mass}"/>{inertia}</inertial>'


def chain(*links: str, kind: str = "revolute") -> str:
    """Return a URDF of a base and the links, joined by hinges about axes that differ."""
    axes = ("0 0 1", "0 1 0", "1 0 0")
    text = '<link name="link0"/>'
    for number, link in enumerate(links, start=1):
        text += f'<link name="link{number}">{link}</link><joint name="joint{number}" type="{kind}">'
        text += f'<parent link="link{number - 1}"/><child link="link{number}"/><axis xyz="{axes[number % 3]}"/></joint>'
    return f'<robot name="chain">{text}</robot>'


SOUND = inertial(1, (1, 1, 1))


def mass_matrix(model: mujoco.MjModel, qpos: np.ndarray) -> np.ndarray:
    data = mujoco.MjData(model)
    data.qpos[:] = qpos
    mujoco.mj_forward(model, data)
    matrix = np.zeros((model.nv, model.nv))
    for row, unit in zip(matrix, np.eye(model.nv), strict=True):
        mujoco.mj_mulM(model, data, row, unit)
    return matrix


@pytest.mark.parametrize(
    ("moments", "text"),
    [
        ((1.0, 1.0, 2.0), None),
        ((0.0, 0.0, 0.0), None),
        ((0.0, 1.0, 1.0), None),
        ((1.0, 1.0, 2.000001), None),
        ((1.0, 1.0, 2.1), "break the triangle inequality A + B >= C by 0.1 kg m^2, 4.76 % of C"),
        ((-1.0, 1.0, 1.0), "include a negative one"),
    ],
)
def test_defect(moments: tuple[float, float, float], text: str | None) -> None:
    found = defect(1.0, np.array(moments))
    assert found == text or (text is not None and found is not None and text in found)


def test_noise_around_a_point_mass_is_no_defect() -> None:
    assert defect(1.0, np.array([-1e-20, 0.0, 1e-20])) is None
    assert defect(1e-6, np.array([0.0, 0.0, 3e-6])) is not None


def test_nearest_physical_moments() -> None:
    moments = np.array([3.0, 1.0, 1.0])
    repaired = nearest_physical_moments(moments)
    assert defect(1.0, repaired) is None
    np.testing.assert_allclose(repaired, [3.0, 1.5, 1.5], rtol=1e-5)
    sound = np.array([1.0, 1.2, 2.0])
    np.testing.assert_allclose(nearest_physical_moments(sound), sound, rtol=1e-15)
    np.testing.assert_array_equal(nearest_physical_moments(np.array([-1.0, -2.0, -1.0])), np.zeros(3))


def test_broken_inertia_is_refused_with_the_remedy() -> None:
    expected = r"body 'link1': principal moments 1, 1, 3 kg m\^2 break .* by 1 kg m\^2.*repair=True.*allow_unphysical=True"
    with pytest.raises(InvalidInertiaError, match=expected):
        compile_source(chain(inertial(2, BROKEN)))


def test_every_broken_body_is_named() -> None:
    with pytest.raises(InvalidInertiaError, match=r"body 'link1'.*body 'link3'"):
        compile_source(chain(inertial(2, BROKEN), SOUND, inertial(-1, (1, 1, 1))))


def test_broken_inertia_can_be_kept() -> None:
    with pytest.warns(UnphysicalInertiaWarning, match="body 'link1'.*kept as it is"):
        compiled = compile_source(chain(inertial(2, BROKEN, rpy="0 0 0")), allow_unphysical=True)
    kept = compiled.inertials[2]
    assert kept.mass == 2
    np.testing.assert_allclose(kept.com, [0.1, 0, 0])
    np.testing.assert_allclose(kept.central_inertia, np.diag(BROKEN), atol=1e-15)
    np.testing.assert_allclose(np.sort(compiled.mj_model.body_inertia[2]), BROKEN)
    assert compiled.mj_model.body_subtreemass[0] == 2
    assert compiled.repaired == ()


def test_broken_inertia_can_be_repaired() -> None:
    compiled = compile_source(chain(inertial(2, BROKEN, rpy="0 0 0")), repair=True)
    np.testing.assert_allclose(compiled.inertials[2].central_inertia, np.diag([1.5, 1.5, 3]), rtol=1e-5, atol=1e-15)
    assert len(compiled.repaired) == 1
    assert "body 'link1'" in compiled.repaired[0]
    assert "1, 1, 3 kg m^2 break" in compiled.repaired[0]
    assert "changed to mass 2 kg, principal moments 1.5, 1.5, 3 kg m^2" in compiled.repaired[0]


def test_mjcf_diagonal_inertia_keeps_its_order_and_frame() -> None:
    text = """<mujoco><worldbody><body name="a"><joint/>
    <inertial mass="1" pos="0 0 1" euler="0 0 90" diaginertia="3 1 1"/></body></worldbody></mujoco>"""
    with pytest.raises(InvalidInertiaError, match="body 'a'"):
        compile_source(text)
    with pytest.warns(UnphysicalInertiaWarning):
        compiled = compile_source(text, allow_unphysical=True)
    np.testing.assert_allclose(compiled.inertials[1].central_inertia, np.diag([1, 3, 1]), atol=1e-15)
    np.testing.assert_array_equal(compiled.mj_model.body_inertia[1], [3, 1, 1])


@pytest.mark.parametrize("moments", [(0.0, 1.0, 1.0), (1.0, 1.0, 2.0 + 1e-9)])
def test_sound_inertia_that_mujoco_refuses_is_kept(moments: tuple[float, float, float]) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        compiled = compile_source(chain(inertial(1, moments, rpy="0 0 0")))
    np.testing.assert_allclose(compiled.inertials[2].central_inertia, np.diag(moments), atol=1e-15)
    assert compiled.repaired == ()
    assert not any("link1" in sentence for sentence in compiled.ignored)


def test_bad_inertia_of_a_static_body_does_not_matter() -> None:
    compiled = compile_source(chain(inertial(2, BROKEN), kind="fixed"))
    assert any("body 'link1'" in sentence and "welded to the world" in sentence for sentence in compiled.ignored)


@pytest.mark.parametrize("mass", [0, -1])
def test_no_mass_at_the_tip(mass: float) -> None:
    text = chain(SOUND, inertial(mass, (0, 0, 0)))
    with pytest.raises(InvalidInertiaError, match=r"body 'link2'.*mass (0|-1) kg.*repair=True"):
        compile_source(text)
    compiled = compile_source(text, repair=True)
    assert compiled.mj_model.body("link2").mass[0] == 1e-3
    np.testing.assert_allclose(compiled.mj_model.body("link2").inertia, 1e-7)
    assert all("body 'link2'" in sentence for sentence in compiled.repaired)
    assert "changed to mass 0.001 kg, principal moments 1e-07, 1e-07, 1e-07 kg m^2" in compiled.repaired[-1]


def test_a_missing_inertial_at_the_tip() -> None:
    with pytest.raises(InvalidInertiaError, match="body 'link2': a joint moves too little inertia"):
        compile_source(chain(SOUND, ""))
    assert compile_source(chain(SOUND, ""), repair=True).mj_model.body("link2").mass[0] == 1e-3


def test_massless_links_between_hinges_are_sound() -> None:
    compiled = compile_source(chain("", "", SOUND))
    model = compiled.mj_model
    assert [model.body(f"link{number}").mass[0] for number in range(1, 4)] == [0, 0, 1]
    assert sorted(compiled.inertials) == [2, 3]
    matrix = mass_matrix(model, np.array([0.3, 0.4, 0.5]))
    assert np.linalg.eigvalsh(matrix)[0] > 0.1


def test_a_massless_body_with_armature_is_sound() -> None:
    text = '<mujoco><worldbody><body name="rotor"><joint armature="1"/></body></worldbody></mujoco>'
    assert compile_source(text).mj_model.body_mass[1] == 0
    with pytest.raises(InvalidInertiaError, match="body 'rotor'"):
        compile_source(text.replace('armature="1"', ""))


def test_a_point_mass_on_its_axis() -> None:
    text = chain(SOUND, inertial(1, (0, 0, 0), com="0 0 0"))
    with pytest.raises(InvalidInertiaError, match=r"body 'link2'.*mass 1 kg, principal moments 0, 0, 0"):
        compile_source(text)
    compiled = compile_source(text, repair=True)
    assert compiled.mj_model.body("link2").mass[0] == 1
    np.testing.assert_allclose(compiled.mj_model.body("link2").inertia, 1e-4)


def test_parallel_axes_through_one_point_need_a_mass_between() -> None:
    text = chain("", SOUND).replace('axis xyz="1 0 0"', 'axis xyz="0 1 0"')
    with pytest.raises(InvalidInertiaError, match="body 'link1'"):
        compile_source(text)
    assert compile_source(text, repair=True).mj_model.body("link1").mass[0] == 1e-3


def test_unphysical_numbers_must_leave_the_mass_matrix_regular() -> None:
    with pytest.warns(UnphysicalInertiaWarning), pytest.raises(InvalidInertiaError, match="mass matrix is singular"):
        compile_source(chain(inertial(-1, (-1, -1, -1))), allow_unphysical=True)


def test_numbers_that_mujoco_would_derive_from_placeholders_are_refused() -> None:
    body = '<body name="a"><joint {}/><inertial mass="1" pos="0 0 0" diaginertia="1 1 2.0000001"/></body>'
    spring = body.format('name="j" springdamper="1 1"')
    with pytest.raises(UnsupportedModelError, match="springdamper of joint 'j'"):
        compile_source(f"<mujoco><worldbody>{spring}</worldbody></mujoco>")


def test_what_the_file_asks_mujoco_to_change_is_changed() -> None:
    text = '<mujoco><compiler {}/><worldbody><body name="a"><joint/>{}</body></worldbody></mujoco>'
    broken = '<inertial mass="1" pos="0 0 0" diaginertia="1 1 4"/>'
    balanced = compile_source(text.format('balanceinertia="true"', broken)).mj_model
    np.testing.assert_array_equal(balanced.body_inertia[1], [2, 2, 2])
    bounded = compile_source(text.format('boundmass="1" boundinertia="2"', "")).mj_model
    assert bounded.body_mass[1] == 1
    np.testing.assert_array_equal(bounded.body_inertia[1], [2, 2, 2])


def test_inertia_from_geoms_is_left_to_mujoco() -> None:
    text = '<mujoco><worldbody><body><joint/><geom size="0.1"/></body></worldbody></mujoco>'
    compiled = compile_source(text)
    assert compiled.inertials == {}
    assert compiled.mj_model.body_mass[1] == mujoco.MjModel.from_xml_string(text).body_mass[1]


def test_malformed_urdf_that_repair_can_read() -> None:
    text = chain(SOUND, SOUND).replace('name="joint2"', 'name="joint1"').replace('xyz="0 1 0"', 'xyz="0 0 0"')
    with pytest.raises(ModelFileError, match="joint 'joint1': axis '0 0 0' is zero"):
        compile_source(text)
    compiled = compile_source(text.replace('ixy="0"', ""), repair=True)
    assert compiled.mj_model.joint("joint1_2").id == 1
    assert "joint 'joint1': axis '0 0 0' replaced by the default '1 0 0'" in compiled.repaired
    assert "joint 'joint1': a second joint of this name is renamed 'joint1_2'" in compiled.repaired
    assert "link 'link1': missing inertia ixy taken as zero" in compiled.repaired
    empty = compile_source(chain("<inertial/>", SOUND), repair=True)
    assert "link 'link1': missing <mass> taken as zero" in empty.repaired
