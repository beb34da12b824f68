"""The report and the record of an identification, of numbers that are made up here."""

import dataclasses
import json
import sys
from html.parser import HTMLParser

import jax.numpy as jnp
import numpy as np
import pytest

import kanejax as kj
from kanejax._identify.record import identification_record
from kanejax._identify.report.numbers import number, number_with_error, percent
from kanejax._identify.report.page import write_report
from kanejax._identify.report.pictures import thinned
from kanejax._identify.report.signals import errors, signal_names, signal_units
from kanejax._identify.report.tables import error_rows, parameter_groups
from kanejax._identify.report.verdict import inconsistent_bodies, sentences_on_fit, verdict
from kanejax._identify.result import BaseEstimates, Comparison, Estimate, Identification, Stage
from kanejax._parameters.parameterization import parameterization
from kanejax._parameters.plant import Drives, Plant
from kanejax._regression.information import Spectrum

ARM = """<mujoco><worldbody><body name="upper"><joint name="a&lt;b&gt; &amp; &quot;c&quot;" axis="0 1 0"/>
<geom size="0.1" mass="2" pos="0.2 0 0"/><body name="fore" pos="0.4 0 0"><joint name="lift" type="slide" axis="0 1 0"/>
<geom size="0.1" mass="1" pos="0.2 0 0"/><body name="tip" pos="0.4 0 0"/></body></body></worldbody></mujoco>"""
ODD, ESCAPED = 'a<b> & "c"', "a&lt;b&gt; &amp; &#34;c&#34;"
VOID = {"meta", "img", "br", "hr", "input", "link"}


def comparison(name, n=200, size=0.1):
    ts = np.linspace(0, 2, n)
    measured = np.stack((np.sin(3 * ts), 2 * np.cos(5 * ts)), 1)
    weight = np.ones_like(measured)
    weight[: n // 4, 1] = 0
    measured = np.where(weight > 0, measured, np.nan)
    return Comparison(name, ts, measured, measured * (1 + size), measured * 1.5, weight)


def identification(**changes):
    model = kj.load(ARM)
    nominal = Plant(model, Drives.ideal(model))
    sought = parameterization(nominal, ["damping", "inertia"])
    phi = 1.25 * sought.phi0
    kinds = ("alone", "in combination", "not at all")
    estimates = []
    for i, (name, unit) in enumerate(zip(sought.names, sought.units, strict=True)):
        std = 0.0123 if i % 3 == 0 else np.nan
        value = float(phi[i])
        ends = (value - 2 * std, value + 2 * std)
        estimates.append(Estimate(name, unit, float(sought.phi0[i]), value, std, *ends, kinds[i % 3]))
    correlation = np.array([[1, 0.95, -0.2], [0.95, 1, 0], [-0.2, 0, 1]])
    fields = {
        "plant": Plant(model.replace(mass=1.25 * model.mass), nominal.drives),
        "nominal": nominal,
        "parameterization": sought,
        "phi": phi,
        "estimates": tuple(estimates),
        "base": BaseEstimates(
            ("upper.Iyy - 0.16 fore.m", "fore.m", "<x>"), np.zeros(3), np.ones(3), np.array([0.1, 0.2, np.nan]), correlation, 12.5
        ),
        "sentences": ("No signal depends on 'upper.m' <really>.", "low-passed at 3 Hz"),
        "stages": (Stage("inverse dynamics", True, "nothing changes any more", 4, 123.4, np.array([0.1, 0.2])),),
        "training": (comparison("first"), comparison("second")),
        "validation": (comparison("<held> out", size=0.2),),
        "noise": Spectrum(np.linspace(0, 50, 20), np.geomspace(1e-2, 1e-5, 40).reshape(20, 2)),
        "consistency": np.array([0.1, 0.2, np.nan]),
    }
    return Identification(**{**fields, **changes})


class Page(HTMLParser):
    """Checks that tags are closed in order, and gathers texts, attributes and tags."""

    def __init__(self, text):
        super().__init__()
        self.stack, self.tags, self.attributes, self.texts = [], [], [], []
        self.feed(text)
        self.close()
        assert not self.stack

    def handle_starttag(self, tag, attrs):
        self.tags.append(tag)
        self.attributes += [(tag, *pair) for pair in attrs]
        if tag not in VOID:
            self.stack.append(tag)

    def handle_startendtag(self, tag, attrs):
        self.tags.append(tag)
        self.attributes += [(tag, *pair) for pair in attrs]

    def handle_endtag(self, tag):
        assert self.stack, tag
        assert self.stack.pop() == tag

    def handle_data(self, data):
        self.texts.append(data)


@pytest.fixture(scope="module")
def html(tmp_path_factory):
    path = tmp_path_factory.mktemp("report") / "report.html"
    notes = ("first: low-passed at 3 Hz", "shapes <ignored>")
    write_report(identification(), path, title="Arm <1>", inputs={"Robot": "arm & co.urdf"}, notes=notes)
    return path.read_text(encoding="utf-8")


def test_page_is_well_formed(html):
    page = Page(html)
    ids = [value for _, key, value in page.attributes if key == "id"]
    assert len(ids) == len(set(ids))
    targets = {value[1:] for tag, key, value in page.attributes if tag in ("a", "use") and key == "href"}
    assert targets <= set(ids)
    assert {value for _, key, value in page.attributes if key == "aria-labelledby"} <= set(ids)
    for name in ("clip-path", "fill"):
        used = {value[5:-1] for _, key, value in page.attributes if key == name and value.startswith("url(#")}
        assert used <= set(ids)
    assert page.tags.count("h1") == 1


def test_page_needs_nothing_else(html):
    page = Page(html)
    for tag, key, value in page.attributes:
        if key in ("src", "href", "xlink:href", "data", "srcset"):
            assert value.startswith(("#", "data:image/png;base64,")), (tag, key, value)
    assert not {"link", "script", "iframe", "object", "img"} & set(page.tags)
    assert "http" not in html
    assert "@import" not in html
    assert "url(" not in html.replace("url(#", "")
    assert len(html) < 500_000


def test_names_are_escaped(html):
    assert ODD not in html
    assert ESCAPED in html
    for text in ("Arm &lt;1&gt;", "arm &amp; co.urdf", "&lt;held&gt; out", "&lt;really&gt;", "shapes &lt;ignored&gt;", "&lt;x&gt;"):
        assert text in html
    assert "<x>" not in html
    texts = "".join(Page(html).texts)
    assert ODD in texts
    assert "lift" in texts


def test_every_picture_is_there(html):
    page = Page(html)
    labels = [value for tag, key, value in page.attributes if (tag, key) == ("svg", "aria-label")]
    # Two signals of three runs, two spectra, and the correlations.
    assert len(labels) == 2 * 3 + 2 + 1
    assert len([label for label in labels if label.startswith(ODD)]) == 4
    assert page.tags.count("figure") == len(labels)
    assert "var(--predicted)" in html
    assert "#0102" not in html


def test_numbers_are_there(html):
    texts = "".join(Page(html).texts)
    # Half as much again as measured.
    assert "50.0\u00a0%" in texts
    assert "20.0\u00a0%" in texts
    for text in ("upper.Iyy \u2212 0.16 fore.m", "in combination", "not at all", "no. 1 and no. 2", "0.95", "12.5", "no mass"):
        assert text in texts
    # The second sentence is a note of the first run.
    assert texts.count("low-passed at 3 Hz") == 1


def test_page_without_this_and_that(tmp_path):
    base = BaseEstimates((), np.zeros(0), np.zeros(0), np.zeros(0), np.zeros((0, 0)), 1.0)
    silent = Spectrum(np.linspace(0, 1, 3), np.zeros((3, 2)))
    bare = identification(base=base, validation=(), training=(comparison("one"),), sentences=(), noise=silent)
    write_report(bare, tmp_path / "report.html")
    texts = "".join(Page((tmp_path / "report.html").read_text(encoding="utf-8")).texts)
    assert "There are none." in texts
    assert "There are no residuals." in texts
    assert "No run was held out" in texts
    assert "run by run" not in texts


@pytest.mark.slow
def test_long_runs_make_no_large_page(tmp_path):
    runs = tuple(comparison(f"run {i}", n=20_000) for i in range(60))
    write_report(identification(training=runs[:50], validation=runs[50:]), tmp_path / "report.html")
    text = (tmp_path / "report.html").read_text(encoding="utf-8")
    assert len(text) < 3_000_000
    assert "26 more runs are not drawn" in text
    assert "run 49" in text


def test_report_is_the_same_again(html, tmp_path):
    notes = ("first: low-passed at 3 Hz", "shapes <ignored>")
    write_report(identification(), tmp_path / "again.html", title="Arm <1>", inputs={"Robot": "arm & co.urdf"}, notes=notes)
    assert (tmp_path / "again.html").read_text(encoding="utf-8") == html


@pytest.mark.parametrize("package", ["jinja2", "matplotlib"])
def test_missing_package(package, tmp_path, monkeypatch):
    # This is how Python marks a module that cannot be imported.
    monkeypatch.setitem(sys.modules, package, None)
    with pytest.raises(ImportError, match=rf"a report needs the package {package}: pip install 'kanejax\[report\]'"):
        write_report(identification(), tmp_path / "report.html")
    assert not (tmp_path / "report.html").exists()


def test_thinned_lines_keep_extremes_and_gaps():
    random = np.random.default_rng(0)
    ts, values = np.arange(10_007.0), random.normal(size=10_007)
    values[3000:4000] = np.nan
    values[5000] = 50.0
    few_ts, few = thinned(ts, values, 100)
    assert len(few) <= 2 * 101
    assert np.all(np.diff(few_ts) >= 0)
    assert np.nanmax(few) == 50.0
    assert np.nanmin(few) == np.nanmin(values)
    assert np.isnan(few[(few_ts > 3200) & (few_ts < 3800)]).all()
    real = ~np.isnan(few)
    np.testing.assert_array_equal(few[real], values[few_ts[real].astype(int)])
    assert thinned(ts[:150], values[:150], 100)[1] is not None
    np.testing.assert_array_equal(thinned(ts[:150], values[:150], 100)[1], values[:150])


def test_errors_against_norms():
    runs = (comparison("a"), comparison("b", n=50, size=0.3))
    found = errors(runs)
    measured, predicted = (np.concatenate([getattr(run, key) for run in runs]) for key in ("measured", "predicted"))
    counts = np.concatenate([run.weight for run in runs]) > 0
    for j in range(2):
        m, p = measured[counts[:, j], j], predicted[counts[:, j], j]
        np.testing.assert_allclose(found.relative[j], np.linalg.norm(m - p) / np.linalg.norm(m))
        np.testing.assert_allclose(found.rms[j], np.sqrt(np.mean(m * m)))
        np.testing.assert_allclose(found.nominal[j], 0.5)
    dead = runs[0]._replace(weight=np.zeros_like(runs[0].weight))
    assert np.isnan(errors((dead,)).relative).all()


def test_signals():
    made = identification()
    assert signal_names(made) == (ODD, "lift")
    assert signal_units(made) == ("N m", "N")
    driven = Plant(made.plant.model, made.plant.drives.replace(gain=jnp.array([2.0, 1.0])))
    assert signal_units(identification(plant=driven)) == ("signal", "N")


def test_verdict():
    findings = {finding.text.split()[0]: finding for finding in verdict(identification())}
    assert [finding.kind for finding in verdict(identification())] == ["good", "good", "good", "note", "note"]
    assert findings["On"].text.startswith("On 1 held-out run (200 samples), the residuals are 20.0\u00a0% to 20.0\u00a0%")
    assert "more than 1.5 times those of the fit" in findings["Held-out"].text
    kinds = [estimate.determined for estimate in identification().estimates]
    counts = [kinds.count(kind) for kind in ("alone", "in combination", "not at all")]
    assert f"determines {counts[0]} alone and {counts[1]} only in combination with others; {counts[2]}" in findings["Of"].text


def test_verdict_on_bad_news():
    stages = (*identification().stages, Stage("simulation", False, "it diverged", 3, np.nan, np.full(2, np.nan)))
    worse = comparison("held out", size=0.7)
    said = ("The stage 'simulation' did not converge: it diverged.", "Something else.")
    made = identification(stages=stages, sentences=said, consistency=np.array([0.1, -0.01, np.nan]), validation=(worse,))
    texts = [(finding.kind, finding.text) for finding in verdict(made)]
    assert texts[0] == ("bad", "Stage 'simulation' did not converge: it diverged.")
    assert texts[1] == ("bad", "No rigid body can have the mass distribution of 'fore'.")
    assert texts[2][0] == "bad"
    assert "predicted no better than by the nominal plant" in texts[3][1]
    assert inconsistent_bodies(made) == ("fore",)
    assert sentences_on_fit(made, ()) == ["Something else."]
    # A nan is no proof of consistency; a body without mass needs none.
    assert inconsistent_bodies(identification(consistency=np.array([np.nan, 0.1, np.nan]))) == ("upper",)
    assert sentences_on_fit(identification(), ("second: low-passed at 3 Hz",)) == ["No signal depends on 'upper.m' <really>."]


def test_typeset_numbers():
    assert number(-1.5e-7) == "\u22121.5\u00d710\u207b\u2077"
    assert number(12345.678) == "1.235\u00d710\u2074"
    assert number(float("nan")) == number(float("inf")) == "\u2014"
    assert number_with_error(1.23456, 0.0123) == ("1.235", "0.012")
    assert number_with_error(-0.00001, 0.01) == ("0.000", "0.010")
    assert number_with_error(5.0, float("nan")) == ("5", "\u2014")
    assert percent(0.1234) == "12.3\u00a0%"
    assert percent(3e-5) == "0.003\u00a0%"
    assert percent(0.0) == "0.0\u00a0%"
    assert percent(20.0) == "over 1000\u00a0%"


def test_parameters_are_grouped_by_owner():
    groups = dict(parameter_groups(identification()))
    assert list(groups) == [ODD, "lift", "upper", "fore"]
    assert [row["label"] for row in groups["upper"]][:3] == ["m", "mcx", "mcy"]
    assert groups[ODD][0]["unit"] == "N m s/rad"
    assert {row["unit"] for row in groups["upper"]} == {"kg", "kg m", "kg m\u00b2"}
    with_interval = next(row for row in groups["upper"] if row["whiskers"])
    nominal, value, (lower, upper) = with_interval["whiskers"]
    assert 0 <= min(nominal, lower) < value < max(nominal, upper) <= 100
    row = error_rows(identification())[0]
    assert [group["nominal_bar"] for group in row.groups] == [100.0, 100.0]
    assert row.groups[0]["relative_bar"] == 40.0


def test_record_is_json():
    made = identification()
    record = identification_record(made, {"seed": 3, "files": ("a.csv",)})
    again = json.loads(json.dumps(record, allow_nan=False))
    assert again == record
    assert again["seed"] == 3
    assert again["files"] == ["a.csv"]
    assert {"python", "kanejax", "jax", "numpy"} <= set(again["versions"])
    for estimate, entry in zip(made.estimates, again["parameters"], strict=True):
        assert entry["name"] == estimate.name
        assert entry["value"] == estimate.value
        assert entry["std"] == (None if np.isnan(estimate.std) else estimate.std)
    np.testing.assert_array_equal(again["base_parameters"]["correlation"], made.base.correlation)
    assert again["base_parameters"]["std"][2] is None
    assert again["consistency"] == {"upper": 0.1, "fore": 0.2, "tip": None}
    np.testing.assert_array_equal(again["identified"]["model"]["mass"], made.plant.model.mass)
    np.testing.assert_array_equal(again["nominal"]["model"]["mass"], made.nominal.model.mass)
    np.testing.assert_array_equal(again["identified"]["drives"]["stribeck_speed"], [0.1, 0.1])
    assert again["identified"]["model"]["joint_range"] == [[None, None]] * 2
    assert [(run["name"], run["use"]) for run in again["runs"]][-1] == ("<held> out", "validation")
    np.testing.assert_allclose(again["runs"][-1]["relative_error"], 0.2)
    assert "bfloat16" not in json.dumps(record)
    assert identification_record(dataclasses.replace(made, sentences=()))["sentences"] == []
