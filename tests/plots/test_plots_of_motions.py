"""Figures of motions show the numbers they were given, in the right panels and units."""

import subprocess
import sys
import types
from typing import Any

import jax
import jax.numpy as jnp
import matplotlib
import matplotlib.colors
import matplotlib.image
import matplotlib.style
import mujoco
import numpy as np
import pytest

import kanejax as kj
from tests.helpers.mechanisms import random_states

# The stubs of matplotlib know less of axes and lines than is asked of them here.
plots: Any = kj.plots

# One joint of each kind; the slide has a range far off, the hinge a near one.
ROBOT = """<mujoco><compiler angle="radian"/><option><flag energy="enable" contact="disable"/></option><worldbody>
<body name="base" pos="0 0 1"><freejoint name="float"/><geom size="0.1" mass="2" pos="0.02 0 0"/>
<body name="arm" pos="0.4 0 0"><joint name="hinge" axis="0 1 0" range="-1.5 2" limited="true" stiffness="3" armature="0.1"/>
<geom size="0.1" mass="1" pos="0.2 0 0"/>
<body name="rod" pos="0.4 0 0"><joint name="slide" type="slide" axis="0 0 1" range="-70 80" limited="true"/>
<geom size="0.1" mass="1"/>
<body name="tip" pos="0.1 0 0"><joint name="wrist" type="ball" stiffness="2"/><geom size="0.05" mass="0.2" pos="0.1 0 0"/>
</body></body></body></body></worldbody></mujoco>"""
COUNT = 31
TITLES = ["float, translation", "float, rotation", "hinge", "slide", "wrist"]
# Of each panel: coordinates and speeds, with their units and those of forces.
PLACES = {
    "float, translation": (slice(0, 3), slice(0, 3), ("m", "m/s", "N")),
    "float, rotation": (slice(3, 7), slice(3, 6), ("", "rad/s", "N m")),
    "hinge": (slice(7, 8), slice(6, 7), ("rad", "rad/s", "N m")),
    "slide": (slice(8, 9), slice(7, 8), ("m", "m/s", "N")),
    "wrist": (slice(9, 13), slice(8, 11), ("", "rad/s", "N m")),
}


@pytest.fixture(scope="module")
def mj():
    return mujoco.MjModel.from_xml_string(ROBOT)


@pytest.fixture(scope="module")
def model(mj):
    return kj.from_mujoco(mj)


@pytest.fixture(scope="module")
def path(mj):
    q, u, tau = random_states(mj, COUNT)
    return types.SimpleNamespace(ts=np.linspace(0.5, 2.0, COUNT), q=q, u=u, tau=tau[:-1])


@pytest.fixture(scope="module")
def many(path):
    random = np.random.default_rng(1)
    noise = [random.normal(size=(8, *array.shape)) for array in (path.q, path.u, path.tau)]
    arrays = [array + more for array, more in zip((path.q, path.u, path.tau), noise, strict=True)]
    return types.SimpleNamespace(ts=np.tile(path.ts, (8, 1)), q=arrays[0], u=arrays[1], tau=arrays[2])


def panels(figure):
    return {axes.get_title(loc="left"): axes for axes in figure.axes}


def curves(axes, count=COUNT):
    """The lines of so many points; limits have two."""
    return [line for line in axes.lines if len(line.get_xdata()) == count]


def limits(axes):
    return sorted(line.get_ydata()[0] for line in axes.lines if list(line.get_xdata()) == [0, 1])


def legend(figure):
    (found,) = figure.legends
    return [text.get_text() for text in found.get_texts()]


def words(axes):
    return [text.get_text() for text in axes.texts]


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_coordinates_are_those_of_the_path_in_the_units_of_their_joints(model, path, dtype):
    given = types.SimpleNamespace(ts=jnp.asarray(path.ts, dtype), q=jnp.asarray(path.q, dtype))
    found = panels(plots.coordinates(model.astype(dtype), given))
    assert list(found) == TITLES
    for title, axes in found.items():
        columns, _, (unit, _, _) = PLACES[title]
        assert axes.get_ylabel() == unit
        drawn = curves(axes)
        np.testing.assert_array_equal([line.get_ydata() for line in drawn], path.q[:, columns].T.astype(dtype))
        for line in drawn:
            np.testing.assert_array_equal(line.get_xdata(), path.ts.astype(dtype))
        assert axes.get_xlim() == pytest.approx((0.5, 2.0))


def test_parts_are_named_and_differ_by_colour(model, path):
    found = panels(plots.coordinates(model, path))
    for title, names in (("float, translation", "xyz"), ("float, rotation", "wxyz"), ("wrist", "wxyz")):
        assert [text.get_text() for text in found[title].get_legend().get_texts()] == list(names)
        lines = curves(found[title])
        assert len({line.get_color() for line in lines}) == len(names)
    assert found["hinge"].get_legend() is None


def test_near_limits_are_lines_and_far_ones_words(model, path):
    found = panels(plots.coordinates(model, path))
    assert limits(found["hinge"]) == [-1.5, 2.0]
    low, high = found["hinge"].get_ylim()
    assert low < -1.5
    assert high > 2.0
    assert limits(found["slide"]) == []
    assert words(found["slide"]) == ["limits \u221270, 80"]
    # Where a legend is above a panel, words are inside, at the end where the limit would be.
    far = panels(plots.speeds(model, path, limits=(-100.0, 2.5)))
    assert words(far["wrist"]) == words(far["hinge"]) == ["limit \u2212100"]
    assert [far[title].texts[0].xy for title in ("wrist", "hinge")] == [(1.0, 0.0), (1.0, 1.0)]
    low, high = found["slide"].get_ylim()
    assert -10 < low < path.q[:, 8].min()
    assert path.q[:, 8].max() < high < 10
    for title in ("float, translation", "float, rotation", "wrist"):
        assert limits(found[title]) == []
        assert words(found[title]) == []


def test_all_that_is_drawn_lies_inside(model, path):
    other = types.SimpleNamespace(ts=path.ts, q=3.0 * path.q)
    for axes in plots.coordinates(model, path, reference=other).axes:
        low, high = axes.get_ylim()
        for line in axes.lines:
            assert low < np.min(line.get_ydata())
            assert np.max(line.get_ydata()) < high


def test_a_reference_is_dashed_at_its_own_times(model, path):
    other = types.SimpleNamespace(ts=np.linspace(0, 3, 7), q=np.arange(7 * 13).reshape(7, 13) / 50.0, u=np.ones((7, 11)))
    figure = plots.coordinates(model, path, reference=other, joints=["hinge", "float"])
    found = panels(figure)
    assert list(found) == ["hinge", "float, translation", "float, rotation"]
    (line,) = curves(found["hinge"], 7)
    np.testing.assert_array_equal(line.get_ydata(), other.q[:, 7])
    np.testing.assert_array_equal(line.get_xdata(), other.ts)
    assert line.get_linestyle() == "--"
    assert legend(figure) == ["reference", "limit"]
    found = panels(plots.speeds(model, path, reference=other))
    assert [len(curves(axes, 7)) for axes in found.values()] == [3, 3, 1, 1, 3]


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_speeds_and_their_limits(model, path, dtype):
    model = model.astype(dtype)
    given = types.SimpleNamespace(ts=jnp.asarray(path.ts, dtype), u=jnp.asarray(path.u, dtype))
    greatest = np.linspace(2.0, 4.0, 11)
    found = panels(plots.speeds(model, given, limits=kj.Limits(model, u=greatest)))
    assert list(found) == TITLES
    for title, axes in found.items():
        _, columns, (_, unit, _) = PLACES[title]
        assert axes.get_ylabel() == unit
        np.testing.assert_array_equal([line.get_ydata() for line in curves(axes)], path.u[:, columns].T.astype(dtype))
        expected = sorted([*greatest[columns], *-greatest[columns]])
        np.testing.assert_array_equal(limits(axes), np.array(expected, dtype))
    assert all(limits(axes) == [] for axes in plots.speeds(model, given).axes)
    hinge = panels(plots.speeds(model, given, limits=(-2.0, np.linspace(2.0, 4.0, 11)), joints="hinge"))["hinge"]
    np.testing.assert_allclose(limits(hinge), [-2.0, greatest[6]], rtol=1e-6)


def test_held_forces_are_steps_and_others_lines(model, path):
    found = panels(plots.torques(model, path, limits=2.5))
    again = panels(plots.torques(model, path.ts, path.tau, limits=kj.Limits(model, tau=2.5)))
    for title, axes in found.items():
        _, columns, (_, _, unit) = PLACES[title]
        assert axes.get_ylabel() == unit
        for line, same, force in zip(curves(axes), curves(again[title]), path.tau[:, columns].T, strict=True):
            assert line.get_drawstyle() == "steps-post"
            np.testing.assert_array_equal(line.get_ydata(), [*force, force[-1]])
            np.testing.assert_array_equal(same.get_ydata(), line.get_ydata())
        assert limits(axes) == limits(again[title]) == [-2.5, 2.5]
    at_times = np.arange(COUNT * 11.0).reshape(COUNT, 11)
    for axes, columns in zip(plots.torques(model, path.ts, at_times).axes, [place[1] for place in PLACES.values()], strict=True):
        drawn = curves(axes)
        np.testing.assert_array_equal([line.get_ydata() for line in drawn], at_times[:, columns].T)
        assert {line.get_drawstyle() for line in drawn} == {"default"}


def test_motion_has_a_column_for_each_quantity(model, path):
    figure = plots.motion(model, path, limits=kj.Limits(model, u=3.0, tau=2.5))
    rows = np.array(figure.axes).reshape(5, 3)
    for (columns, speeds, units), row in zip(PLACES.values(), rows, strict=True):
        for axes, values, unit in zip(row, (path.q[:, columns], path.u[:, speeds], path.tau[:, speeds]), units, strict=True):
            assert axes.get_ylabel() == unit
            np.testing.assert_array_equal(np.array([line.get_ydata() for line in curves(axes)])[:, : len(values)], values.T)
        assert limits(row[1]) == [-3.0, 3.0]
        assert limits(row[2]) == [-2.5, 2.5]
    assert [words(axes)[-1] for axes in rows[0]] == ["coordinates", "speeds", "forces"]
    without = plots.motion(model, types.SimpleNamespace(ts=path.ts, q=path.q, u=path.u), joints="hinge")
    assert len(without.axes) == 2
    assert limits(without.axes[0]) == [-1.5, 2.0]


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_energies_are_those_of_mujoco(mj, model, path, dtype):
    data = mujoco.MjData(mj)
    potential, kinetic = np.zeros(COUNT), np.zeros(COUNT)
    for k in range(COUNT):
        data.qpos, data.qvel = path.q[k], path.u[k]
        mujoco.mj_forward(mj, data)
        potential[k], kinetic[k] = data.energy
    given = types.SimpleNamespace(**{name: np.asarray(getattr(path, name), dtype) for name in ("ts", "q", "u")})
    upper, lower = plots.energies(model.astype(dtype), given).axes
    drawn = {line.get_label(): line.get_ydata() for line in upper.lines}
    tolerance = 1e-5 if dtype == np.float32 else 1e-12
    for name, expected in (("kinetic", kinetic), ("potential", potential), ("total", kinetic + potential)):
        assert drawn[name].dtype == dtype
        np.testing.assert_allclose(drawn[name], expected, rtol=tolerance, atol=tolerance * kinetic.max(), err_msg=name)
    total = kinetic + potential
    (change,) = curves(lower)
    np.testing.assert_allclose(change.get_ydata(), (total - total[0]) / kinetic.max(), rtol=10 * tolerance, atol=10 * tolerance)
    assert upper.get_ylabel() == "J"


def test_energies_at_rest_and_in_chosen_speeds(model, path):
    still = types.SimpleNamespace(ts=path.ts, q=np.tile(path.q[:1], (COUNT, 1)), u=np.zeros((COUNT, 11)))
    lower = plots.energies(model, still).axes[1]
    assert lower.get_ylabel() == "J"
    np.testing.assert_array_equal(curves(lower)[0].get_ydata(), 0.0)
    # Twice the speed of the model at first, and more later.
    model = kj.load("<mujoco><worldbody><body><joint/><geom size='1' pos='0 1 0'/></body></worldbody></mujoco>")
    chosen = kj.with_speeds(model, kj.GeneralizedSpeeds(lambda q, t: (2.0 + t) * jnp.eye(1, dtype=q.dtype)))
    path = types.SimpleNamespace(ts=path.ts, q=path.q[:, :1], u=path.u[:, :1])
    scaled = types.SimpleNamespace(ts=path.ts, q=path.q, u=(2.0 + path.ts[:, None]) * path.u)
    for one, other in zip(plots.energies(model, path).axes[0].lines, plots.energies(chosen, scaled).axes[0].lines, strict=True):
        np.testing.assert_allclose(one.get_ydata(), other.get_ydata(), rtol=1e-12)
    with pytest.raises(plots.PlotError, match=r"the speeds of a model with chosen speeds belong to no joint.*rates_from_speeds"):
        plots.speeds(chosen, scaled)
    assert len(plots.coordinates(chosen, scaled).axes) == 1


def test_phase_portrait_draws_speed_over_coordinate(model, path, many):
    (axes,) = plots.phase_portrait(model, path, "slide").axes
    (line,) = curves(axes)
    np.testing.assert_array_equal(line.get_xdata(), path.q[:, 8])
    np.testing.assert_array_equal(line.get_ydata(), path.u[:, 7])
    assert (axes.get_xlabel(), axes.get_ylabel()) == ("coordinate [m]", "speed [m/s]")
    ends = [(*line.get_xdata(), *line.get_ydata()) for line in axes.lines if line.get_marker() == "o"]
    assert ends == [(path.q[0, 8], path.u[0, 7]), (path.q[-1, 8], path.u[-1, 7])]
    (axes,) = plots.phase_portrait(model, many, "hinge").axes
    for line, q, u in zip(curves(axes), many.q, many.u, strict=True):
        np.testing.assert_array_equal(line.get_xdata(), q[:, 7])
        np.testing.assert_array_equal(line.get_ydata(), u[:, 6])
    assert len({matplotlib.colors.to_hex(line.get_color()) for line in curves(axes)}) == 8
    assert sorted(line.get_xdata()[0] for line in axes.lines if list(line.get_ydata()) == [0, 1]) == [-1.5, 2.0]
    figure = plots.phase_portrait(model, [path, path], "hinge", labels=("free", "held"))
    assert legend(figure) == ["free", "held"]
    assert len(curves(figure.axes[0])) == 2


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
@pytest.mark.parametrize("what", ["q", "u", "tau"])
def test_quantiles_are_those_of_numpy(model, many, what, dtype):
    values = getattr(many, what).astype(dtype)
    given = types.SimpleNamespace(ts=many.ts, **{what: jnp.asarray(values)})
    figure = plots.quantiles(model.astype(dtype), given, what, (0.1, 0.2, 0.5, 0.8, 0.9))
    expected = np.quantile(values, [0.1, 0.2, 0.5, 0.8, 0.9], axis=0)
    for axes, place in zip(figure.axes, PLACES.values(), strict=True):
        columns = place[0] if what == "q" else place[1]
        parts = range(columns.start, columns.stop)
        for line, part in zip(curves(axes), parts, strict=True):
            drawn = line.get_ydata()[: values.shape[1]]
            np.testing.assert_allclose(drawn, expected[2, :, part], rtol=1e-6)
        for number, band in enumerate(axes.collections):
            inner, part = number % 2, parts[number // 2]
            points = band.get_paths()[0].vertices[:, 1]
            assert points.min() == pytest.approx(expected[inner, :, part].min(), rel=1e-6)
            assert points.max() == pytest.approx(expected[-1 - inner, :, part].max(), rel=1e-6)
            assert np.isin(expected[[inner, -1 - inner], :, part].astype(np.float32), points.astype(np.float32)).all()
        assert len(axes.collections) == 2 * len(parts)
        assert axes.get_ylabel() == place[2][("q", "u", "tau").index(what)]
    assert legend(figure) == ["median", "20 to 80 %", "10 to 90 %"]
    assert figure.get_suptitle() == "8 motions"


def test_quantiles_are_of_the_motions_that_are_left(model, many):
    q = many.q.copy()
    q[0, 20:], q[1, 10:] = np.nan, np.inf
    q[:, 30] = np.nan
    figure = plots.quantiles(model, types.SimpleNamespace(ts=many.ts, q=q), levels=(0.25, 0.5, 0.75))
    assert figure.get_suptitle() == "8 motions, 8 of them end early"
    (line,) = curves(panels(figure)["hinge"])
    np.testing.assert_allclose(line.get_ydata()[10:20], np.median(np.delete(q, 1, axis=0)[:, 10:20, 7], axis=0))
    np.testing.assert_allclose(line.get_ydata()[20:30], np.median(q[2:, 20:30, 7], axis=0))
    assert np.isnan(line.get_ydata()[30])
    two = plots.quantiles(model, types.SimpleNamespace(ts=many.ts[0], q=many.q), levels=[0.1, 0.9], joints="hinge")
    assert legend(two) == ["10 to 90 %"]
    assert curves(two.axes[0]) == []


def test_simulations_are_drawn_as_they_come(model, mj):
    q, u, _ = random_states(mj, 3, seed=4)
    ts = np.linspace(0.0, 0.1, 6)
    found = kj.simulate_batch(model, q, u, ts, threads=1, dt0=0.01)
    one = jax.tree.map(lambda x: x[1], found)
    (line,) = curves(panels(plots.coordinates(model, one))["hinge"], 6)
    np.testing.assert_array_equal(line.get_ydata(), found.q[1, :, 7])
    (line,) = curves(panels(plots.quantiles(model, found))["slide"], 6)
    np.testing.assert_allclose(line.get_ydata(), np.median(found.q[..., 8], axis=0))
    # A motion that ends early has a gap.
    early = ts[:, None] < 0.05
    ended = types.SimpleNamespace(ts=ts, q=np.where(early, one.q, np.nan), u=np.where(early, one.u, np.nan))
    (line,) = curves(panels(plots.motion(model, ended))["hinge"], 6)
    np.testing.assert_array_equal(np.isnan(line.get_ydata()), ts >= 0.05)
    assert np.all(np.isfinite(plots.coordinates(model, ended).axes[2].get_ylim()))
    first = types.SimpleNamespace(ts=ts[:1], q=one.q[:1], u=one.u[:1])
    assert [line.get_marker() for line in plots.motion(model, first).axes[2].lines] == ["o"] * 4


def test_what_stands_still_is_a_flat_line(model, path):
    q = np.tile(path.q[:1], (COUNT, 1)) + 1e-14 * np.random.default_rng(0).normal(size=(COUNT, 13))
    low, high = panels(plots.coordinates(model, types.SimpleNamespace(ts=path.ts, q=q)))["slide"].get_ylim()
    assert high - low > 1e-4 * abs(path.q[0, 8])
    assert low < path.q[0, 8] < high


def cut(path, **changes):
    return types.SimpleNamespace(**{**vars(path), **changes})


def test_shapes_that_do_not_fit_are_refused_by_name(model, path, many):
    def refused(text):
        return pytest.raises(plots.PlotError, match=text)

    batch = r"path.q has shape \(8, 31, 13\), but one motion has \(n, nq\) = \(n, 13\); choose one with jax.tree.map.*quantiles"
    for draw in (plots.coordinates, plots.motion, plots.energies):
        with refused(batch):
            draw(model, many)
    with refused(r"path.ts has shape \(8, 31\), but a plot needs \(n,\)"):
        plots.coordinates(model, cut(path, ts=many.ts))
    with refused(r"path.u has shape \(31, 13\), but this model needs \(n, nv\) = \(n, 11\); give the model that the motion is of"):
        plots.speeds(model, cut(path, u=path.q))
    with refused(r"path.q has 31 rows, but path.ts has 30 times; give 30 rows"):
        plots.energies(model, cut(path, ts=path.ts[:-1]))
    with refused(r"reference.q has shape \(31, 11\)"):
        plots.coordinates(model, path, reference=cut(path, q=path.u))
    with refused(r"tau has 29 rows, but ts has 31 times; give 31 or 30 rows"):
        plots.torques(model, path.ts, path.tau[1:])
    with refused(r"path.ts has shape \(0,\), but a plot needs \(n,\) with n of at least 1"):
        plots.coordinates(model, cut(path, ts=path.ts[:0], q=path.q[:0]))
    with refused("ts is a SimpleNamespace, which has no 'tau'; give what kj.optimize returns, or times and forces: torques"):
        plots.torques(model, types.SimpleNamespace(ts=path.ts))
    with refused("path is a ndarray, which has no 'ts'; give what kj.simulate or kj.optimize returns"):
        plots.coordinates(model, path.q)
    with refused(r"a limit of u has shape \(3,\); give a number, \(11,\)"):
        plots.speeds(model, path, limits=np.ones(3))
    smaller = kj.load("<mujoco><worldbody><body><joint/><geom size='1'/></body></worldbody></mujoco>")
    with refused(r"limits.tau has shape \(2, 1\), but this model needs \(2, nv\) = \(2, 11\)"):
        plots.torques(model, path, limits=kj.Limits(smaller, tau=1.0))
    models = jax.tree.map(lambda leaf: jnp.stack([leaf, leaf]), model)
    with refused(r"model.joint_range has shape \(2, 4, 2\), but one model has \(4, 2\); choose the one"):
        plots.coordinates(models, path)
    with refused(r"model.gravity has shape \(2, 3\), but one model has \(3,\)"):
        plots.energies(models, path)
    with refused("there are no joints to draw"):
        plots.coordinates(model, path, joints=[])
    run = kj.Run("first", path.ts, path.q, path.q)
    with refused(r"path is a Run, whose columns are the log's joints; draw what kj.motions\(log, model\) returns"):
        plots.coordinates(model, run)


def test_batches_that_do_not_fit_are_refused_by_name(model, path, many):
    def refused(text):
        return pytest.raises(plots.PlotError, match=text)

    with refused(r"paths.q has shape \(31, 13\), but quantiles need \(batch, n, nq\); give a batch.*kj.plots.motion"):
        plots.quantiles(model, path)
    with refused(r"paths.q has shape \(1, 8, 31, 13\) and paths.ts \(8, 31\), but \(batch, n, nq\), and paths.ts"):
        plots.quantiles(model, cut(many, q=many.q[None]))
    with refused(r"paths.u has shape \(8, 31, 11\) and paths.ts \(7, 31\)"):
        plots.quantiles(model, cut(many, ts=many.ts[1:]), "u")
    with refused("motion 7 of paths has other times than motion 0; interpolate all to the same"):
        plots.quantiles(model, cut(many, ts=many.ts + 0.1 * (np.arange(8) == 7)[:, None]))
    with refused("what is 'speed'; use 'q', 'u', 'tau'"):
        plots.quantiles(model, many, "speed")
    for levels in ((0.5, 0.1), (0.1, 1.1), (), (0.5, 0.5)):
        with refused("levels is .*; give increasing numbers between 0 and 1"):
            plots.quantiles(model, many, levels=levels)
    with refused("labels has 1 names, but there are 8 motions; give one each"):
        plots.phase_portrait(model, many, "hinge", labels=["a"])
    with refused("paths is empty; give at least one motion"):
        plots.phase_portrait(model, [], "hinge")
    with refused(r"paths\[1\].q has shape \(31, 11\)"):
        plots.phase_portrait(model, [path, cut(path, q=path.u)], "hinge")


def test_unknown_joints_are_refused_with_the_names_there_are(model, path, many):
    for draw in (plots.coordinates, plots.speeds, plots.torques, plots.motion):
        with pytest.raises(
            kj.UnknownNameError, match="no joint is named 'elbow'; the names are: 'float', 'hinge', 'slide', 'wrist'"
        ):
            draw(model, path, joints=["hinge", "elbow"])
    with pytest.raises(kj.UnknownNameError, match="no joint is named 'elbow'"):
        plots.quantiles(model, many, joints="elbow")
    for name in ("elbow", "wrist"):
        with pytest.raises(kj.UnknownNameError, match=f"no joint with one coordinate is named '{name}'; .*'hinge', 'slide'$"):
            plots.phase_portrait(model, path, name)


def test_a_notebook_shows_figures_on_white_whatever_style_is_set(model, path, tmp_path):
    with matplotlib.style.context("dark_background"):
        figure = plots.coordinates(model, path, joints="hinge")
        before = dict(matplotlib.rcParams)
        image, place = figure._repr_png_()
        figure.savefig(tmp_path / "figure.png", dpi=200)
        assert dict(matplotlib.rcParams) == before
    (tmp_path / "shown.png").write_bytes(image)
    for name in ("shown", "figure"):
        pixels = matplotlib.image.imread(tmp_path / f"{name}.png")
        assert pixels.shape[1] == 2 * place["width"]
        np.testing.assert_array_equal(pixels[0, 0], 1.0)
        # All that is drawn can be seen on it: the greatest part is white, some of it is ink.
        assert np.mean(pixels[..., :3] == 1.0) > 0.8
        assert np.sum(pixels[..., :3].max(axis=-1) < 0.3) > 100
    figure.savefig(tmp_path / "figure.svg")
    assert "<svg" in (tmp_path / "figure.svg").read_text()


def test_nothing_of_pyplot_is_used():
    program = (
        "import sys, types, numpy as np, kanejax as kj\n"
        "assert 'matplotlib' not in sys.modules\n"
        "model = kj.robots.three_revolute_arm()\n"
        "path = types.SimpleNamespace(ts=np.arange(2.0), q=np.zeros((2, model.nq)), u=np.zeros((2, model.nv)))\n"
        "kj.plots.motion(model, path)._repr_png_()\n"
        "assert 'matplotlib.pyplot' not in sys.modules"
    )
    done = subprocess.run([sys.executable, "-W", "error", "-c", program], capture_output=True, text=True, timeout=120)
    assert done.returncode == 0, done.stderr


def test_a_missing_package_is_told(model, path, many, monkeypatch):
    # This is how Python marks a module that cannot be imported.
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    monkeypatch.setitem(sys.modules, "matplotlib.style", None)
    for draw in (
        lambda: plots.coordinates(model, path),
        lambda: plots.motion(model, path),
        lambda: plots.energies(model, path),
        lambda: plots.quantiles(model, many),
        lambda: plots.phase_portrait(model, path, "hinge"),
    ):
        with pytest.raises(ImportError, match=r"kanejax.plots needs the package matplotlib: pip install 'kanejax\[plots\]'"):
            draw()


def test_errors_are_those_of_the_library():
    assert issubclass(plots.PlotError, kj.KanejaxError)
    assert all(callable(getattr(plots, name)) for name in plots.__all__)
