"""The only place that prints: tables, progress, JSON, and other people's units."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import cache
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from rich.console import Console
    from rich.text import Text


@cache
def console() -> Console:
    """Return the console on standard output (rich honours NO_COLOR and pipes)."""
    from rich.console import Console

    return Console(highlight=False, markup=False, emoji=False)


@cache
def messages() -> Console:
    """Return the console on standard error: warnings and progress, never results."""
    from rich.console import Console

    return Console(stderr=True, highlight=False, markup=False, emoji=False)


def styled(*parts: str | tuple[str, str]) -> Text:
    """Return a line of text; a part with a style is a pair, such as ``("done", "bold green")``."""
    from rich.text import Text

    return Text.assemble(*parts)


def print_json(document: Any) -> None:
    """Write one JSON document to standard output, and nothing else there.

    Letters that the output's encoding does not have are escaped.
    """
    text = json.dumps(document, indent=2, ensure_ascii=False, allow_nan=False)
    try:
        text.encode(sys.stdout.encoding)
    except UnicodeEncodeError:
        text = json.dumps(document, indent=2, allow_nan=False)
    sys.stdout.write(f"{text}\n")


def print_lines(*items: Any) -> None:
    """Print lines of text and tables as results; lines are not wrapped, tables fit the screen."""
    from rich.text import Text

    for item in items:
        console().print(item, soft_wrap=isinstance(item, (str, Text)), crop=False)


def print_now(line: str) -> None:
    """Print one line and hand it on at once, for a program that waits for it."""
    sys.stdout.write(f"{line}\n")
    sys.stdout.flush()


def write_bytes(data: bytes) -> None:
    """Pass bytes of a stream on to standard output at once."""
    if data:
        sys.stdout.buffer.write(data)
        sys.stdout.buffer.flush()


def warn(text: str) -> None:
    """Say something that the user should know but that does not stop the work."""
    messages().print(styled(("warning:", "yellow"), f" {text}"), soft_wrap=True)


@contextmanager
def working(text: str) -> Iterator[Callable[[str], None]]:
    """Say on standard error what is being done, while it is; only to a terminal."""
    if not sys.stderr.isatty():
        yield lambda _: None
        return
    with messages().status(text) as status:
        yield status.update


def show_unit(serial_number: str, attempts: list[dict[str, Any]], *, as_json: bool) -> None:
    """Print every attempt of one unit."""
    from rich.table import Table

    if as_json:
        print_json(
            {
                "format": "imu-cal/history",
                "version": 1,
                "serial_number": serial_number,
                "attempts": attempts,
            }
        )
        return
    if not attempts:
        console().print(f"unit {serial_number}: never run")
        return
    for attempt in attempts:
        console().print(
            styled(
                (serial_number, "bold"),
                f" attempt {attempt['attempt']} at {attempt['station']}, "
                f"{attempt['started'][:19]} UTC: ",
                (attempt["outcome"], "bold"),
                f" {attempt['reason']}",
            )
        )
        table = Table(box=None, pad_edge=False)
        for heading in ("check", "value", "low", "high", "", ""):
            table.add_column(heading, justify="left" if heading in ("check", "") else "right")
        for check in attempt["checks"]:
            table.add_row(
                check["name"],
                *(
                    "-" if check[key] is None else f"{check[key]:.5g}"
                    for key in ("value", "low", "high")
                ),
                check["unit"],
                "ok" if check["passed"] else check["action"],
            )
        if attempt["checks"]:
            console().print(table)


def show_line(summary: dict[str, Any], *, as_json: bool) -> None:
    """Print yield, capability, outliers and drifts of a line."""
    from rich.table import Table

    if as_json:
        print_json(summary)
        return
    if not summary["runs"]:
        console().print("no runs yet")
        return
    counts = ", ".join(f"{n} {name}" for name, n in summary["outcomes"].items() if n)
    share = summary["yield"]
    first = summary["first_pass_yield"]
    console().print(
        f"{summary['units']} units in {summary['runs']} runs: {counts}\n"
        f"yield {'-' if share is None else f'{share:.1%}'}, "
        f"first pass {'-' if first is None else f'{first:.1%}'}"
    )
    table = Table(box=None, pad_edge=False)
    for heading in ("parameter", "units", "mean", "std dev", "", "Cpk", "95 %"):
        table.add_column(heading, justify="left" if heading in ("parameter", "") else "right")
    for row in summary["capability"]:
        interval = row["cpk_interval"]
        table.add_row(
            row["name"],
            str(row["count"]),
            f"{row['mean']:.4g}",
            f"{row['deviation']:.2g}",
            row["unit"],
            "-" if row["cpk"] is None else f"{row['cpk']:.2f}",
            "-" if interval is None else f"{interval[0]:.2f} to {interval[1]:.2f}",
        )
    console().print(table)
    for item in summary["outliers"]:
        console().print(
            f"outlier: unit {item['serial_number']}, {item['name']} = {item['value']:.4g} "
            f"({item['score']:+.1f} robust standard deviations, p = {item['p_value']:.1g})"
        )
    for item in summary["drifts"]:
        console().print(
            f"drift: station {item['station']}, {item['name']} moves by "
            f"{item['slope_per_day']:.2g} a day (p = {item['p_value']:.1g})"
        )
