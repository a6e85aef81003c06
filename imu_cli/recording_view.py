"""How a recording looks while it runs and when it is done; and how it is told to stop."""

from __future__ import annotations

import _thread
import signal
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from types import FrameType, TracebackType
from typing import TYPE_CHECKING, Any, Self

from imu_cli import output

if TYPE_CHECKING:
    from rich.status import Status

    from drivers.record import RecordState

PERIOD = 0.25
"""s between updates of the progress line."""


@contextmanager
def stop_on_signals() -> Iterator[threading.Event]:
    """Turn Ctrl-C, SIGTERM and a closed terminal into an event; a second one interrupts at once."""
    stop, asked = threading.Event(), threading.Event()  # nobody waits for the second

    def handle(number: int, frame: FrameType | None) -> None:
        if asked.is_set():
            raise KeyboardInterrupt
        asked.set()
        # Not from here: who waits for it in this very thread may hold its lock, for ever then.
        _thread.start_new_thread(stop.set, ())

    before = {number: signal.signal(number, handle) for number in (signal.SIGINT, *_heeded())}
    try:
        yield stop
    finally:
        for number, old in before.items():
            signal.signal(number, old)


@contextmanager
def interrupt_on_signals() -> Iterator[None]:
    """Let SIGTERM and a terminal that is closed interrupt as Ctrl-C does, unless it is ignored."""

    def handle(number: int, frame: FrameType | None) -> None:
        raise KeyboardInterrupt

    before = {number: signal.signal(number, handle) for number in _heeded()}
    try:
        yield
    finally:
        for number, old in before.items():
            signal.signal(number, old)


def _heeded() -> list[signal.Signals]:
    """Return SIGTERM and SIGHUP, but what is ignored (``nohup``)."""
    numbers = [signal.SIGTERM, *([signal.SIGHUP] if sys.platform != "win32" else [])]
    return [number for number in numbers if signal.getsignal(number) != signal.SIG_IGN]


class Progress:
    """One line on the terminal that says how a recording stands; silent in a pipe."""

    def __init__(self) -> None:
        self._status: Status | None = None
        self._shown = 0.0

    def __enter__(self) -> Self:
        console = output.messages()
        if console.is_terminal:
            self._status = console.status("waiting for the first samples")
            self._status.start()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        if self._status is not None:
            self._status.stop()

    def update(self, state: RecordState) -> None:
        """Show the state, a few times a second."""
        if self._status is None or time.monotonic() - self._shown < PERIOD:
            return
        self._shown = time.monotonic()
        self._status.update(progress_line(state))


def progress_line(state: RecordState) -> str:
    """Return the state of a recording as one line."""
    from drivers.record import HARMLESS

    if state.waiting:
        return f"{state.samples} samples; the device went away, waiting for it (Ctrl-C ends)"
    if not state.samples:
        return "waiting for the first samples"
    parts = [f"{state.duration:.1f} s", f"{state.samples} samples", f"{state.rate:.1f} Hz"]
    parts.append(f"lost {state.lost}")
    parts += [
        f"{name.replace('_', ' ')} {n}"
        for name, n in sorted(state.counters.items())
        if name not in HARMLESS
    ]
    parts.append(f"clipped {state.clipped}")
    if state.temperature is not None:
        parts.append(f"{state.temperature:.1f} °C")
    if state.moving is not None:
        parts.append("moving" if state.moving else "still")
    return " · ".join(parts)


def show_result(state: RecordState, path: Path, *, as_json: bool) -> None:
    """Print what was recorded and what was lost."""
    if as_json:
        output.print_json(to_json(state, path))
        return
    from drivers.record import HARMLESS

    if not state.samples:
        output.warn(f"no sample came; {path} was not written")
        return
    output.print_lines(
        f"{path}: {state.samples} samples in {state.duration:.3f} s, {state.rate:.3f} Hz by the "
        f"{state.clock} clock; ended by {state.ended_by}"
    )
    losses = [f"{state.lost} samples lost"] if state.lost else []
    losses += [
        f"{n} {name.replace('_', ' ')}"
        for name, n in sorted(state.counters.items())
        if name not in HARMLESS
    ]
    losses += [f"{state.reconnects} reconnects"] if state.reconnects else []
    if losses:
        output.warn(", ".join(losses))
    if state.clipped:
        output.warn(f"{state.clipped} samples at full scale: choose a larger range")


def to_json(state: RecordState, path: Path) -> dict[str, Any]:
    """Return the result of a recording as a JSON document."""
    return {
        "format": "imu-cal/recorded",
        "version": 1,
        "file": str(path) if state.samples else None,
        "samples": state.samples,
        "duration_s": state.duration,
        "rate_hz": state.rate,
        "clock": state.clock or None,
        "lost": state.lost,
        "counters": dict(sorted(state.counters.items())),
        "clipped": state.clipped,
        "reconnects": state.reconnects,
        "temperature_degc": state.temperature,
        "chip": state.device.chip or None,
        "ended_by": state.ended_by,
    }
