"""The picture of the simulated study: whether intervals hold the truth, and how far estimates are off."""

from typing import NamedTuple

import numpy as np
from matplotlib.ticker import NullLocator
from scipy.stats import binom, norm

import kanejax as kj
from experiments.thesis import record

QUANTILE = 1.959963984540054
INK, GREY, RED, BLUE, GREEN, SAND = "#222222", "#9aa3ad", "#c8553d", "#1f4e79", "#3a8a5f", "#d9a441"
KINDS = {"mass": ("m",), "mc": ("mcx", "mcy", "mcz"), "I": ("Ixx", "Iyy", "Izz", "Ixy", "Ixz", "Iyz")}
KINDS |= {name: (name,) for name in ("damping", "coulomb_friction", "offset")}
TITLES = {
    "mass": "masses",
    "mc": "first moments",
    "I": "inertias",
    "damping": "viscous friction",
    "coulomb_friction": "Coulomb friction",
    "offset": "offsets",
}
# Values that differ by orders of magnitude are drawn to scale within these, in the units below, and beyond as their logarithms.
LINEAR = {"mass": 0.1, "mc": 0.02, "I": 0.005}
UNITS = {"mass": "kg", "mc": "kg m", "I": "kg m$^2$", "damping": "N m s", "coulomb_friction": "N m", "offset": "N m"}


class Errors(NamedTuple):
    """Of base parameters from many recordings, each (runs, nbase).

    `std` and `fit_std` are the library's, for the linear estimate and the fit of physical parameters; `white` is the linear
    estimate's if errors were independent of each other.
    """

    linear: np.ndarray
    std: np.ndarray
    white: np.ndarray
    fit: np.ndarray
    fit_std: np.ndarray


class Masses(NamedTuple):
    """Masses that are determined alone, relative errors and standard deviations (runs, masses)."""

    names: tuple[str, ...]
    errors: np.ndarray
    std: np.ndarray


class Values(NamedTuple):
    """Base parameters: true, nominal, found in one recording, and half of its 95 % intervals."""

    true: np.ndarray
    nominal: np.ndarray
    found: np.ndarray
    half: np.ndarray


class Shown:
    """The base parameters in the order of the picture: by kind, then base to tip."""

    def __init__(self, base: kj.BaseParameters) -> None:
        """Sort them."""
        names = [base.names[i] for i in base.independent]
        kinds = [next(kind for kind, parts in KINDS.items() if name.rpartition(".")[2] in parts) for name in names]
        self.order = np.array(sorted(range(len(names)), key=lambda i: list(KINDS).index(kinds[i])))
        self.names = [names[i].removeprefix("panda_").replace("coulomb_friction", "Coulomb") for i in self.order]
        self.kinds = [kinds[i] for i in self.order]

    def groups(self) -> list[tuple[str, int, int]]:
        """Each kind that there is, with its first and last place."""
        present = dict.fromkeys(self.kinds)
        return [(kind, self.kinds.index(kind), len(self.kinds) - 1 - self.kinds[::-1].index(kind)) for kind in present]


def picture(shown: Shown, white: Errors, coloured: Errors, values: Values, masses: Masses) -> record.Figure:
    """All of it, from many recordings and from the first of them."""
    runs = len(white.linear)
    figure = record.Figure(figsize=(16, 13), layout="constrained")
    figure.suptitle(
        f"A Panda's {len(shown.order)} base parameters from ten noisy seconds, {runs} times over", fontsize=17, weight="bold"
    )
    top, middle, bottom = figure.subfigures(3, 1, height_ratios=(1.25, 1.0, 0.9), squeeze=False)[:, 0]
    draw_coverage(top, shown, white, coloured)
    draw_values(middle, shown, values)
    scores, spread, each = bottom.subplots(1, 3, width_ratios=(1.0, 1.0, 1.0))
    draw_scores(scores, white)
    draw_bias(spread, shown, white)
    draw_masses(each, masses)
    return figure


def draw_coverage(figure: record.Figure, shown: Shown, white: Errors, coloured: Errors) -> None:
    """Of each parameter, the share of 95 % intervals that hold the truth."""
    upper, lower = figure.subplots(2, 1, sharex=True, height_ratios=(1.5, 1.0))
    runs, places = len(white.linear), np.arange(len(shown.order))
    low, high = (100 * binom.ppf(p, runs, 0.95) / runs for p in (0.025, 0.975))
    series = {
        upper: (
            ("fit of physical parameters", white.fit, white.fit_std, GREEN, "D"),
            ("linear estimate", white.linear, white.std, BLUE, "o"),
            ("linear, intervals for white noise", white.linear, white.white, GREY, "x"),
        ),
        lower: (
            ("linear estimate", coloured.linear, coloured.std, BLUE, "o"),
            ("linear, intervals for white noise", coloured.linear, coloured.white, RED, "x"),
        ),
    }
    for axes, lines in series.items():
        plain(axes)
        axes.axhspan(low, high, color=SAND, alpha=0.25, linewidth=0, label="what exact intervals would show, 95 %")
        axes.axhline(95, color=SAND, linewidth=1)
        for label, error, std, color, marker in lines:
            share = 100 * np.mean(np.abs(error) < QUANTILE * std, axis=0)[shown.order]
            text = f"{label}: {share.mean():.1f} %"
            axes.plot(places, share, marker, color=color, markersize=5 if marker != "x" else 6, alpha=0.9, label=text)
        axes.set_ylabel("intervals that hold [%]")
        axes.legend(
            loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=4, fontsize=9, frameon=False, borderpad=0, columnspacing=1.2
        )
    least = 100 * min(np.mean(np.abs(e) < QUANTILE * s, axis=0).min() for _, e, s, _, _ in series[upper])
    upper.set_ylim(least - 1.5, 100.7)
    lower.set_ylim(0, 104)
    lower.set_xlim(-0.8, len(places) - 0.2)
    lower.set_xticks(places, shown.names, rotation=90, fontsize=7.5)
    upper.set_title("White torque noise of 5 %: 95 % intervals", loc="left", fontsize=11.5)
    lower.set_title("Coloured torque noise (each sample 0.9 like the one before)", loc="left", fontsize=11.5)


def draw_values(figure: record.Figure, shown: Shown, values: Values) -> None:
    """One recording: true, nominal and estimated values with intervals."""
    groups = shown.groups()
    panels = figure.subplots(1, len(groups), width_ratios=[last - first + 3 for _, first, last in groups], squeeze=False)[0]
    true, nominal, found, half = (part[shown.order] for part in values)
    for axes, (kind, first, last) in zip(panels, groups, strict=True):
        plain(axes)
        chosen = slice(first, last + 1)
        places = np.arange(first, last + 1)
        axes.plot(places, nominal[chosen], "o", color=RED, markerfacecolor="none", markersize=5, label="nominal")
        axes.plot(places, true[chosen], "_", color=INK, markersize=11, markeredgewidth=1.6, label="true")
        axes.errorbar(
            places, found[chosen], half[chosen], fmt="o", color=BLUE, markersize=3, capsize=2, linewidth=1.2, label="found, 95 %"
        )
        if kind in LINEAR:
            axes.set_yscale("asinh", linear_width=LINEAR[kind])
            axes.yaxis.set_minor_locator(NullLocator())
            axes.set_yticks(
                [side * size for side in (-1, 1) for size in (0.01, 0.03, 0.1, 0.3, 1.0, 3.0) if size > LINEAR[kind]] + [0.0]
            )
            axes.yaxis.set_major_formatter("{x:g}")
            ends = np.concatenate((true[chosen], nominal[chosen], (found - half)[chosen], (found + half)[chosen]))
            axes.set_ylim(1.3 * ends.min(), 1.3 * ends.max())
        axes.set_title(f"{TITLES[kind]} [{UNITS[kind]}]", loc="left", fontsize=10.5)
        axes.set_xticks(places, shown.names[chosen], rotation=90, fontsize=6.5)
        axes.set_xlim(first - 0.8, last + 0.8)
    panels[0].legend(frameon=False, fontsize=9, loc="best")
    figure.suptitle("One recording: what was said, what is, and what was found", x=0.005, ha="left", fontsize=11.5)


def draw_scores(axes: record.Axes, white: Errors) -> None:
    """Errors over their standard deviations, against the normal distribution."""
    plain(axes)
    bins = np.linspace(-4.5, 4.5, 46).tolist()
    for label, error, std, color in (
        ("linear estimate", white.linear, white.std, BLUE),
        ("fit", white.fit, white.fit_std, GREEN),
    ):
        scores = (error / std).ravel()
        text = f"{label}: spread {scores.std():.2f}"
        axes.hist(scores, bins, density=True, histtype="stepfilled", color=color, alpha=0.25)
        axes.hist(scores, bins, density=True, histtype="step", color=color, linewidth=1.6, label=text)
    at = np.linspace(-4.5, 4.5, 300)
    axes.plot(at, norm.pdf(at), color=INK, linewidth=1.4, label="normal: spread 1")
    axes.set(xlabel="error / standard deviation", yticks=[], xlim=(-4.5, 4.5), ylim=(0, 0.68))
    axes.set_title("Errors over the standard deviations that were given", loc="left", fontsize=11.5)
    axes.legend(frameon=False, fontsize=9, loc="upper left")


def draw_bias(axes: record.Axes, shown: Shown, white: Errors) -> None:
    """Mean errors in standard errors, sorted, beside those of as many unbiased estimates."""
    plain(axes)
    runs, count = white.linear.shape
    for label, error, color, marker in (("linear estimate", white.linear, BLUE, "o"), ("fit", white.fit, GREEN, "D")):
        scores = np.sort(np.sqrt(runs) * error.mean(0) / error.std(0, ddof=1))
        axes.plot(norm.ppf((np.arange(count) + 0.5) / count), scores, marker, color=color, markersize=4, label=label)
    ends = np.array([-2.7, 2.7])
    axes.plot(ends, ends, color=INK, linewidth=1.2, label="without bias")
    axes.set(xlabel="as normal numbers would be", ylabel="mean error / its standard error")
    axes.set_title(f"Bias: means over {runs} recordings", loc="left", fontsize=11.5)
    axes.legend(frameon=False, fontsize=9, loc="upper left")


def draw_masses(axes: record.Axes, masses: Masses) -> None:
    """Relative errors of masses where nothing else of the bodies is sought."""
    plain(axes)
    sizes = 100 * np.abs(masses.errors)
    boxes = axes.boxplot(sizes, whis=(5, 95), showfliers=False, patch_artist=True, widths=0.55, medianprops={"color": INK})
    for box, small in zip(boxes["boxes"], sizes.mean(0) < 5, strict=True):
        box.set(facecolor=BLUE if small else GREY, alpha=0.55)
    for place, mean in enumerate(sizes.mean(0), 1):
        said = f"{mean:.2f} %" if mean < 10 else f"{mean:.0f} %"
        axes.annotate(
            said,
            (place, 1.5 * np.percentile(sizes[:, place - 1], 95)),
            ha="center",
            fontsize=8.5,
            color=INK,
        )
    axes.axhline(1.0, color=RED, linewidth=1.2)
    axes.set_yscale("log")
    axes.set_ylim(0.01, 6 * np.percentile(sizes, 95, axis=0).max())
    axes.set_xticks(range(1, len(masses.names) + 1), [name.removeprefix("panda_") for name in masses.names])
    axes.set_ylabel("error of the mass [%]")
    axes.set_title("Masses alone; whiskers 5 to 95 %, means above them", loc="left", fontsize=11.5)


def plain(axes: record.Axes) -> None:
    axes.spines[["top", "right"]].set_visible(False)
    axes.grid(axis="y", color="#e6e6e6", linewidth=0.6)
    axes.set_axisbelow(True)
