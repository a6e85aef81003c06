"""The session on the terminal: one screen that changes in place, nothing that scrolls."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from rich.console import Group, RenderableType
from rich.layout import Layout
from rich.panel import Panel
from rich.table import Table
from rich.text import Text

from calib.calibration import parameter_unit
from calib.types import FloatArray
from imu_cli.bench.session import Status
from imu_cli.bench.words import describe_axis, instruction, turn_rule
from imu_cli.report.units import people_unit

MAP_WIDTH, MAP_HEIGHT = 30, 11
SHORT_NAMES = {
    "accel.bias": "accel bias",
    "accel.scale_factor_error": "accel scale",
    "accel.misalignment": "accel misalign",
    "gyro.bias": "gyro bias",
    "gyro.scale_factor_error": "gyro scale",
    "gyro.misalignment": "gyro misalign",
}
ENOUGH = 60.0
"""° about an axis, both ways, before it is shown as covered."""


@dataclass(frozen=True)
class Header:
    """What is known beside the session: the device and how it is read."""

    address: str
    chip: str
    rate: float
    lost: int
    elapsed: float


def render(status: Status, header: Header) -> RenderableType:
    """Return the whole screen."""
    layout = Layout()
    layout.split_column(
        Layout(_head(status, header), size=3),
        Layout(_instruction(status), size=6),
        Layout(name="body"),
    )
    layout["body"].split_row(Layout(_covered(status), size=MAP_WIDTH + 4), Layout(_errors(status)))
    return layout


def _head(status: Status, header: Header) -> Panel:
    recording = status.recording
    state = Text("MOVING", "bold yellow") if status.moving else Text("STILL", "bold green")
    temperature = ""
    if recording is not None and recording.temperature is not None:
        temperature = f"{recording.temperature[-1]:.1f} °C  "
    text = Text.assemble(
        (header.chip or header.address, "bold"),
        f"  {header.rate:.0f} Hz  {temperature}",
        (f"{header.lost} lost", "red" if header.lost else "dim"),
        f"  {header.elapsed:.0f} s  ",
        state,
    )
    return Panel(text, title="imu-cal bench", title_align="left")


def _instruction(status: Status) -> Panel:
    lines: list[Text] = []
    if status.done:
        lines.append(Text("Done: every target is met.", "bold green"))
    elif status.repeat:
        lines.append(Text(status.repeat, "bold yellow"))
    if not status.done:
        if status.choice is None:
            lines.append(Text("Hold the sensor still on the table.", "bold"))
        else:
            lines.append(Text(instruction(status.choice.action), "bold"))
            rule = turn_rule(status.choice.action)
            lines.append(Text(f"{rule} Why: {_why(status)}", "dim"))
    for text in status.warnings[:1]:
        lines.append(Text(text, "yellow"))
    return Panel(Group(*lines), title="next", title_align="left")


def _why(status: Status) -> str:
    choice = status.choice
    assert choice is not None
    name = choice.worst
    if choice.ratio_before > 50:
        return f"{name} is not determined yet."
    return (
        f"{name} is {choice.ratio_before:.1f} times its target; this brings the worst to "
        f"{choice.ratio_after:.1f}."
    )


def _covered(status: Status) -> Panel:
    ups = status.ups
    lines = [Text(line) for line in sphere_map(ups)]
    counts = Text(f"{len(ups)} poses, {status.turns} turns", "dim")
    choice = status.choice
    if choice is not None:
        axis = choice.action.axis * np.sign(choice.action.angle)
        counts.append(f"; next about {describe_axis(axis)}")
    return Panel(Group(*lines, counts), title="where up has been", title_align="left")


def sphere_map(ups: FloatArray) -> list[str]:
    """Return the sphere of up directions as lines of text.

    A cylindrical equal-area map: columns are the angle from +X about +Z, rows the sine of the
    elevation, so that equal areas of the sphere take equal areas of the screen. Faces are marked.
    """
    grid = [[" "] * MAP_WIDTH for _ in range(MAP_HEIGHT)]
    marks = {"X": (1, 0, 0), "Y": (0, 1, 0), "x": (-1, 0, 0), "y": (0, -1, 0)}
    for mark, direction in marks.items():
        row, column = _cell(np.array(direction, np.float64))
        grid[row][column] = mark
    for column in range(0, MAP_WIDTH, 6):
        grid[0][column], grid[-1][column] = "Z", "z"
    for up in ups:
        row, column = _cell(up)
        grid[row][column] = "●"
    return ["".join(row) for row in grid]


def _cell(up: FloatArray) -> tuple[int, int]:
    longitude = np.arctan2(up[1], up[0]) % (2 * np.pi)
    column = int((longitude + np.pi / 4) / (2 * np.pi) * MAP_WIDTH) % MAP_WIDTH
    row = int((1 - up[2]) / 2 * MAP_HEIGHT)
    return min(row, MAP_HEIGHT - 1), column


def _errors(status: Status) -> Panel:
    table = Table(box=None, pad_edge=False, padding=(0, 1, 0, 0))
    table.add_column("standard error", no_wrap=True)
    table.add_column("now", no_wrap=False)
    table.add_column("target", justify="right", no_wrap=True)
    for row in _groups(status):
        table.add_row(*row)
    content = Group(table, Text(), _turned(status))
    return Panel(content, title="accuracy of every parameter", title_align="left")


def _groups(status: Status) -> list[tuple[str, Text, str]]:
    """Return a row for each group of parameters: every axis, green once it meets its target."""
    groups: dict[str, list[str]] = {}
    for name in status.targets:
        groups.setdefault(name.rpartition(".")[0], []).append(name)
    rows = []
    for group, names in groups.items():
        unit, factor = people_unit(parameter_unit(names[0]))
        now = Text()
        for name in names:
            error = status.errors[name]
            axis = name.rpartition(".")[2]
            if error is None:
                now.append(f"{axis}\u00a0-  ", "red")
            else:
                met = error <= status.targets[name]
                now.append(f"{axis}\u00a0{_short(error * factor)}  ", "green" if met else "yellow")
        wanted = sorted({status.targets[name] * factor for name in names})
        rows.append((SHORT_NAMES[group], now, f"{'/'.join(f'{w:.3g}' for w in wanted)} {unit}"))
    return rows


def _short(value: float) -> str:
    return f"{value:.1e}" if value < 1e-3 else f"{value:.2g}"


def _turned(status: Status) -> Text:
    """Return how far it was turned about each axis, both ways."""
    degrees = np.degrees(status.turned)
    text = Text("turned  ", "bold")
    for axis, (forward, back) in zip("xyz", degrees, strict=True):
        style = "green" if min(forward, back) > ENOUGH else "yellow"
        text.append(f"{axis}\u00a0+{forward:.0f}°\u00a0-{back:.0f}°  ", style)
    return text
