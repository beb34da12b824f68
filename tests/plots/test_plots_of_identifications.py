"""Figures of an identification show its estimates, intervals, signals and spectra."""

import dataclasses
import sys
from typing import Any

import jax
import numpy as np
import pytest

import kanejax as kj

# The stubs of matplotlib know less of axes and lines than is asked of them here.
plots: Any = kj.plots

# Two joints, of which one slides.
ROBOT = """<mujoco><worldbody><body name="upper"><joint name="hinge" axis="0 1 0"/><geom size="0.1" mass="2" pos="0.2 0 0"/>
<body name="fore" pos="0.4 0 0"><joint name="slide" type="slide" axis="0 1 0"/><geom size="0.1" mass="1" pos="0.2 0 0"/>
</body></body></worldbody></mujoco>"""


@pytest.fixture(scope="module")
def found():
    """Of a simulated recording with noise, of which the last quarter is held out."""
    true = kj.load(ROBOT).replace(damping=[0.5, 2.0])
    ts, random = np.arange(0, 4, 0.02), np.random.default_rng(0)
    w = np.array([[1.3, 2.9, 4.1], [1.7, 2.3, 5.1]])
    q, u, u_dot = (np.stack([each(row[:, None] * ts, row[:, None]).sum(0) for row in w], 1) for each in (sine, slope, bend))
    forces = np.asarray(jax.jit(jax.vmap(kj.inverse_dynamics, (None, 0, 0, 0)))(true, q, u, u_dot))
    weight = np.ones_like(forces)
    # Not measured during a part of what is held out.
    weight[170:180, 1] = 0.0
    motion = kj.Motion(ts, q, u, u_dot, forces + 0.2 * random.normal(size=q.shape), weight, name="swing")
    nominal = true.replace(mass=1.3 * true.mass, damping=[0.8, 1.0])
    return kj.identify(nominal, [motion], ("mass", "damping"), validation=0.25)


def sine(x, w):
    return np.sin(x)


def slope(x, w):
    return w * np.cos(x)


def bend(x, w):
    return -(w**2) * np.sin(x)


def by_label(axes):
    return {label: [line for line in axes.lines if line.get_label() == label] for label in ("nominal", "identified", "interval")}


def legend(figure):
    (each,) = figure.legends
    return [text.get_text() for text in each.get_texts()]


def test_parameters_are_the_estimates_with_their_intervals(found):
    figure = plots.parameters(found)
    units = dict.fromkeys(estimate.unit for estimate in found.estimates)
    assert [axes.get_xlabel() for axes in figure.axes] == [unit.replace("^2", "\u00b2") for unit in units]
    for axes, unit in zip(figure.axes, units, strict=True):
        group = [estimate for estimate in found.estimates if estimate.unit == unit]
        assert [text.get_text() for text in axes.get_yticklabels()] == [estimate.name for estimate in group]
        lines = by_label(axes)
        for key, values in (("nominal", [each.nominal for each in group]), ("identified", [each.value for each in group])):
            assert [line.get_xdata()[0] for line in lines[key]] == values
            assert [line.get_ydata()[0] for line in lines[key]] == list(range(len(group)))
        determined = [row for row, each in enumerate(group) if np.isfinite(each.lower)]
        assert [line.get_ydata()[0] for line in lines["interval"]] == determined
        for line, row in zip(lines["interval"], determined, strict=True):
            assert tuple(line.get_xdata()) == (group[row].lower, group[row].upper)
        # The first is on top.
        bottom, top = axes.get_ylim()
        assert top < 0 < bottom
    # The mass of a body on a joint is determined only with where it hangs: here both are.
    assert {each.determined for each in found.estimates} >= {"alone"}


def test_parameters_that_are_not_determined_alone_are_hollow(found):
    first, *others = found.estimates
    lost = first._replace(std=np.nan, lower=np.nan, upper=np.nan, determined="in combination")
    changed = dataclasses.replace(found, estimates=(lost, *others))
    figure = plots.parameters(changed)
    assert legend(figure) == ["identified, with its 95 % interval", "identified, not determined alone", "nominal"]
    lines = by_label(figure.axes[0])
    assert [line.get_markerfacecolor() == "white" for line in lines["identified"]] == [
        True,
        *[False] * (len(lines["identified"]) - 1),
    ]
    assert all(line.get_ydata()[0] != 0 for line in lines["interval"])


def test_some_parameters_by_name(found):
    figure = plots.parameters(found, ["slide.damping", "fore.mass"])
    names = [text.get_text() for axes in figure.axes for text in axes.get_yticklabels()]
    assert names == ["slide.damping", "fore.mass"]
    (axes,) = plots.parameters(found, "slide.damping").axes
    (line,) = by_label(axes)["interval"]
    assert line.get_xdata()[0] < 2.0 < line.get_xdata()[1]
    assert legend(plots.parameters(found, "slide.damping")) == ["identified, with its 95 % interval", "nominal"]
    with pytest.raises(
        kj.UnknownNameError, match=r"no identified parameter is named 'fore.damping'; the names are: .*'slide.damping'"
    ):
        plots.parameters(found, ["fore.damping"])
    with pytest.raises(plots.PlotError, match="names is empty; give at least one parameter"):
        plots.parameters(found, [])


def test_fit_is_that_of_the_held_out_run(found):
    (run,) = found.validation
    figure = plots.torque_fit(found)
    assert figure.get_suptitle() == "swing, held out"
    assert legend(figure) == ["measured", "nominal plant", "identified plant"]
    pairs = np.array(figure.axes).reshape(2, 2)
    for signal, ((upper, lower), name, unit) in enumerate(zip(pairs, ("hinge", "slide"), ("N m", "N"), strict=True)):
        assert (upper.get_title(loc="left"), upper.get_ylabel(), lower.get_ylabel()) == (name, unit, "residual")
        measured, nominal, predicted = (line.get_ydata() for line in upper.lines)
        counts = run.weight[:, signal] > 0
        np.testing.assert_array_equal(measured, np.where(counts, run.measured[:, signal], np.nan))
        np.testing.assert_array_equal(predicted, run.predicted[:, signal])
        np.testing.assert_array_equal(nominal, run.nominal[:, signal])
        left, found_left = (line.get_ydata() for line in lower.lines[:2])
        np.testing.assert_array_equal(left, measured - nominal)
        np.testing.assert_array_equal(found_left, measured - predicted)
        for line in upper.lines:
            np.testing.assert_array_equal(line.get_xdata(), run.ts)
        # What the library says of the error is what is drawn.
        size = np.sqrt(np.nansum(found_left**2) / np.nansum(measured**2))
        assert size == pytest.approx(kj.relative_error(run)[signal])
    assert np.isnan(figure.axes[2].lines[0].get_ydata()).sum() == np.sum(run.weight[:, 1] == 0) > 0


def test_another_run_or_joint(found):
    figure = plots.torque_fit(found, found.training[0], joints="slide")
    assert figure.get_suptitle() == "swing, fitted"
    np.testing.assert_array_equal(figure.axes[0].lines[2].get_ydata(), found.training[0].predicted[:, 1])
    only = dataclasses.replace(found, validation=())
    assert plots.torque_fit(only).get_suptitle() == "swing, fitted"
    with pytest.raises(kj.UnknownNameError, match="no run is named 'sway'; the names are: 'swing'"):
        plots.torque_fit(found, "sway")
    with pytest.raises(kj.UnknownNameError, match="no joint is named 'elbow'; the names are: 'hinge', 'slide'"):
        plots.residuals(found, joints=["elbow"])
    (run,) = found.validation
    with pytest.raises(plots.PlotError, match="run 'swing' is not of this identification, which has 1 run"):
        plots.torque_fit(only, run)
    silent = dataclasses.replace(found, validation=(run._replace(weight=np.zeros_like(run.weight)),))
    with pytest.raises(
        plots.PlotError, match="no signal of 'hinge', 'slide' counts in run 'swing'; choose other joints or another"
    ):
        plots.torque_fit(silent)


def test_residuals_and_their_spectra(found):
    (run,) = found.validation
    figure = plots.residuals(found)
    for signal, (left, right) in enumerate(np.array(figure.axes).reshape(2, 2)):
        counts = run.weight[:, signal] > 0
        expected = np.where(counts, run.measured[:, signal] - run.predicted[:, signal], np.nan)
        np.testing.assert_array_equal(left.lines[1].get_ydata(), expected)
        (line,) = right.lines
        drawn = (found.noise.frequency > 0) & (found.noise.density[:, signal] > 0)
        np.testing.assert_array_equal(line.get_xdata(), found.noise.frequency[drawn])
        np.testing.assert_allclose(line.get_ydata() ** 2, found.noise.density[drawn, signal])
        assert right.get_ylabel() == ("N m / sqrt(Hz)", "N / sqrt(Hz)")[signal]
        # White noise of 0.2: its variance, spread evenly up to half of the 50 Hz.
        assert np.sqrt(np.mean(line.get_ydata() ** 2) * 25.0) == pytest.approx(0.2, rel=0.15)
    assert figure.axes[3].get_xlabel() == "frequency [Hz]"


def test_a_missing_package_is_told(found, monkeypatch):
    for name in ("matplotlib", "matplotlib.style"):
        monkeypatch.setitem(sys.modules, name, None)
    for draw in (plots.parameters, plots.torque_fit, plots.residuals):
        with pytest.raises(ImportError, match=r"kanejax.plots needs the package matplotlib: pip install 'kanejax\[plots\]'"):
            draw(found)
