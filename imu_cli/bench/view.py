"""The session's place on the terminal; in a pipe, a line for each new instruction instead."""

from __future__ import annotations

import time
from types import TracebackType
from typing import Self

from rich.live import Live

from imu_cli import output
from imu_cli.bench.screen import Header, render
from imu_cli.bench.session import Status
from imu_cli.bench.words import instruction

PERIOD = 0.1
"""s between redraws."""


class Screen:
    """Shows a session while it runs."""

    def __init__(self, *, enabled: bool) -> None:
        self._enabled = enabled
        self._live: Live | None = None
        self._drawn = 0.0
        self._said = ""

    def __enter__(self) -> Self:
        console = output.messages()
        if self._enabled and console.is_terminal:
            self._live = Live(console=console, screen=True, auto_refresh=False)
            self._live.start()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        if self._live is not None:
            self._live.stop()

    def show(self, status: Status, header: Header) -> None:
        """Draw the state, a few times a second; without a terminal, say what is new."""
        if self._live is not None:
            now = time.monotonic()
            if now - self._drawn >= PERIOD or status.done:
                self._drawn = now
                self._live.update(render(status, header), refresh=True)
            return
        text = status.repeat or (instruction(status.choice.action) if status.choice else "")
        if self._enabled and text and text != self._said and not status.moving:
            self._said = text
            output.messages().print(f"{header.elapsed:6.1f} s  {text}", soft_wrap=True)
