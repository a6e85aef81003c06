"""Tell the whole story on emulated hardware, in under a minute."""

from __future__ import annotations

import typer


def demo() -> None:
    typer.echo("not yet")
