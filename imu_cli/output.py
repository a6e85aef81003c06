"""The only place that prints: tables, progress, JSON, and other people's units."""

from __future__ import annotations

import json
import sys
from functools import cache
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from rich.console import Console


@cache
def console() -> Console:
    """Return the console on standard output (rich honours NO_COLOR and pipes)."""
    from rich.console import Console

    return Console(highlight=False)


@cache
def messages() -> Console:
    """Return the console on standard error: warnings and progress, never results."""
    from rich.console import Console

    return Console(stderr=True, highlight=False)


def print_json(document: Any) -> None:
    """Write one JSON document to standard output, and nothing else there."""
    json.dump(document, sys.stdout, indent=2, ensure_ascii=False, allow_nan=False)
    sys.stdout.write("\n")


def warn(text: str) -> None:
    """Say something that the user should know but that does not stop the work."""
    messages().print(f"[yellow]warning:[/] {text}", soft_wrap=True)
