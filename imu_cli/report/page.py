"""A report as one HTML file: no network, charts to hover and zoom, prints to A4."""

from __future__ import annotations

import json
from functools import singledispatch
from importlib import resources
from typing import Any

import jinja2
import numpy as np
import plotly.graph_objects as go
import plotly.io
from markupsafe import Markup, escape

from imu_cli.report.model import HeatMap, Paragraph, Plot, Report, Series, Sphere, Table

COLOURS = ("#8a8f98", "#0b6bcb", "#c2410c", "#15803d", "#7c3aed", "#b91c1c", "#0f766e")
"""Of series by their place, the first one for what was before."""
SHAPES = (
    ("circle", "o"),
    ("diamond", "D"),
    ("square", "s"),
    ("triangle-up", "^"),
    ("cross", "P"),
    ("x", "X"),
)
"""Of points, as Plotly and as Matplotlib call them."""
SHEET = 670
"""Pixels between the margins of a sheet of A4."""
_LAYOUT: dict[str, Any] = {
    "template": "plotly_white",
    "font": {"family": "system-ui, sans-serif", "size": 13},
    "margin": {"l": 64, "r": 16, "t": 32, "b": 48},
    "height": 380,
    "legend": {"orientation": "h", "y": -0.3, "yanchor": "top"},
}


def render_page(report: Report) -> str:
    """Return the report as one self-contained HTML page."""
    figures = [b for b in report.blocks if not isinstance(b, Table | Paragraph)]
    environment = jinja2.Environment(
        autoescape=True, undefined=jinja2.StrictUndefined, trim_blocks=True, lstrip_blocks=True
    )
    environment.filters["breakable"] = _breakable
    source = resources.files("imu_cli.report").joinpath("page.html.j2").read_text(encoding="utf-8")
    return environment.from_string(source).render(
        report=report,
        blocks=[(_kind(block), block) for block in report.blocks],
        figures={
            block.title: plotly.io.to_html(
                draw(block),
                full_html=False,
                include_plotlyjs=False,
                config={"displaylogo": False, "responsive": True},
            )
            for block in figures
        },
        sheet=SHEET,
        plotly=plotly.offline.get_plotlyjs() if figures else "",
        document=json.dumps(report.document, ensure_ascii=False, allow_nan=False).replace(
            "</", "<\\/"
        ),
    )


def _breakable(text: object) -> Markup:
    """Return text whose names may be broken after an underscore, and nowhere else."""
    return Markup("_<wbr>").join(escape(text).split("_"))


def _kind(block: object) -> str:
    if isinstance(block, Table):
        return "table"
    return "paragraph" if isinstance(block, Paragraph) else "chart"


def colour_of(series: Series, place: int) -> str:
    """Return the colour of a series: its own, or that of its place among the others."""
    return COLOURS[(place if series.colour is None else series.colour) % len(COLOURS)]


@singledispatch
def draw(chart: object) -> Any:
    """Return the Plotly figure of a chart."""
    raise TypeError(f"no way to draw {type(chart).__name__}")


@draw.register
def _(chart: Plot) -> Any:
    figure = go.Figure()
    for place, series in enumerate(chart.series):
        common = {"x": series.x, "y": series.y, "name": series.name}
        colour = colour_of(series, place)
        text = list(series.text) or None
        if series.kind == "bars":
            figure.add_bar(**common, hovertext=text, marker={"color": colour})
        else:
            mode = "lines" if series.kind == "line" else "markers"
            symbol = SHAPES[series.shape % len(SHAPES)][0]
            figure.add_scatter(
                **common,
                mode=mode,
                hovertext=text,
                line={"color": colour},
                marker={"size": 5, "color": colour, "symbol": symbol},
            )
    for start, stop in chart.shaded:
        figure.add_vrect(x0=start, x1=stop, fillcolor="#94a3b8", opacity=0.18, line_width=0)
    figure.update_layout(**_LAYOUT, xaxis_title=chart.x_label, yaxis_title=chart.y_label)
    figure.update_layout(showlegend=len(chart.series) > 1)
    return figure


@draw.register
def _(chart: Sphere) -> Any:
    u, v = np.mgrid[0 : np.pi : 13j, 0 : 2 * np.pi : 25j]
    ball = (np.sin(u) * np.cos(v), np.sin(u) * np.sin(v), np.cos(u))
    figure = go.Figure()
    figure.add_surface(
        x=ball[0] * 0.99,
        y=ball[1] * 0.99,
        z=ball[2] * 0.99,
        opacity=0.25,
        showscale=False,
        colorscale=[[0, "#cbd5e1"], [1, "#cbd5e1"]],
        hoverinfo="skip",
    )
    x, y, z = chart.points.T
    figure.add_scatter3d(
        x=x,
        y=y,
        z=z,
        mode="markers",
        hovertext=list(chart.text),
        marker={"size": 5, "color": COLOURS[1]},
    )
    axis = {"range": [-1.1, 1.1], "tickvals": [-1, 0, 1]}
    figure.update_layout(
        **{**_LAYOUT, "height": 420},
        showlegend=False,
        scene={
            "aspectmode": "cube",
            **{f"{a}axis": {**axis, "title": a} for a in "xyz"},
        },
    )
    return figure


@draw.register
def _(chart: HeatMap) -> Any:
    figure = go.Figure(
        go.Heatmap(
            z=chart.values,
            x=list(chart.labels),
            y=list(chart.labels),
            zmin=-1,
            zmax=1,
            colorscale="RdBu",
            reversescale=True,
        )
    )
    figure.update_layout(**{**_LAYOUT, "height": 560, "margin": {"l": 190, "b": 190, "t": 32}})
    figure.update_yaxes(autorange="reversed")
    return figure
