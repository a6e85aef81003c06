"""A report's charts as one PNG or SVG, for terminals without a browser."""

from __future__ import annotations

from functools import singledispatch
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from imu_cli.report.model import Chart, HeatMap, Plot, Report, Sphere
from imu_cli.report.page import COLOURS, SHAPES, colour_of

SUFFIXES = (".png", ".svg")


def write_picture(report: Report, path: Path) -> None:
    """Draw every chart of a report, one below the other.

    Raises
    ------
    ValueError
        If the suffix is not .png or .svg, or the report has no chart.
    """
    if path.suffix.lower() not in SUFFIXES:
        raise ValueError(f"`path` must end in {' or '.join(SUFFIXES)}, got {path.name!r}")
    charts = [block for block in report.blocks if isinstance(block, Chart)]
    if not charts:
        raise ValueError("`report` has no chart to draw")
    figure = Figure(figsize=(9, sum(_height(chart) for chart in charts)), layout="constrained")
    ratios = [_height(chart) for chart in charts]
    grid = figure.add_gridspec(len(charts), 1, height_ratios=ratios)
    for k, chart in enumerate(charts):
        draw_axes(chart, figure, grid[k])
    figure.suptitle(report.verdict, fontsize=11, wrap=True)
    figure.savefig(path, dpi=120)


def _height(chart: object) -> float:
    return 3.0 if isinstance(chart, Plot) else 5.5


@singledispatch
def draw_axes(chart: object, figure: Figure, place: Any) -> None:
    """Draw a chart into its place in the grid."""
    raise TypeError(f"no way to draw {type(chart).__name__}")


@draw_axes.register
def _(chart: Plot, figure: Figure, place: Any) -> None:
    axes = figure.add_subplot(place)
    bars = [series for series in chart.series if series.kind == "bars"]
    width = 0.8 / max(1, len(bars))
    for k, series in enumerate(chart.series):
        colour = colour_of(series, k)
        if series.kind == "bars":
            shift = (bars.index(series) - (len(bars) - 1) / 2) * width
            axes.bar(series.x + shift, series.y, width, label=series.name, color=colour)
        elif series.kind == "line":
            axes.plot(series.x, series.y, lw=0.7, label=series.name, color=colour)
        else:
            shape = SHAPES[series.shape % len(SHAPES)][1]
            axes.plot(series.x, series.y, shape, ms=2.5, label=series.name, color=colour)
    for start, stop in chart.shaded:
        axes.axvspan(start, stop, color="#94a3b8", alpha=0.18, lw=0)
    axes.set(title=chart.title, xlabel=chart.x_label, ylabel=chart.y_label)
    axes.grid(alpha=0.3)
    if len(chart.series) > 1:
        axes.legend(loc="upper right", fontsize=8, ncols=3)


@draw_axes.register
def _(chart: Sphere, figure: Figure, place: Any) -> None:
    axes: Any = figure.add_subplot(place, projection="3d")
    u, v = np.mgrid[0 : np.pi : 13j, 0 : 2 * np.pi : 25j]
    ball = (np.sin(u) * np.cos(v), np.sin(u) * np.sin(v), np.cos(u))
    axes.plot_wireframe(*ball, color="#cbd5e1", lw=0.5)
    axes.scatter(*chart.points.T, color=COLOURS[1], s=18)
    axes.set(title=chart.title, xlabel="x", ylabel="y", zlabel="z")
    axes.set_box_aspect((1, 1, 1))


@draw_axes.register
def _(chart: HeatMap, figure: Figure, place: Any) -> None:
    axes = figure.add_subplot(place)
    image = axes.imshow(chart.values, vmin=-1, vmax=1, cmap="RdBu_r")
    ticks = range(len(chart.labels))
    axes.set_xticks(ticks, list(chart.labels), rotation=90, fontsize=6)
    axes.set_yticks(ticks, list(chart.labels), fontsize=6)
    axes.set_title(chart.title)
    figure.colorbar(image, ax=axes, shrink=0.8)
