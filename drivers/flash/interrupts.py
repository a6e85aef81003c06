"""What may interrupt a flash: Ctrl-C, SIGTERM and SIGHUP, but only until values are put back."""

from __future__ import annotations

import signal
import sys
import threading
from types import FrameType, TracebackType
from typing import Any, Self

SIGNALS = [signal.SIGINT, signal.SIGTERM, *([signal.SIGHUP] if sys.platform != "win32" else [])]


class Interrupts:
    """Signals that do what they did before, until `hold`; from then on they do nothing.

    One that would end the process raises KeyboardInterrupt instead. Signals that were ignored stay
    so. In a thread other than the main one, which no signal interrupts, this does nothing.
    """

    def __init__(self, *, held: bool = False) -> None:
        self._held = held
        self._before: dict[int, Any] = {}

    def __enter__(self) -> Self:
        if threading.current_thread() is threading.main_thread():
            for number in SIGNALS:
                # None is a handler that was not set from Python, and could not be set again.
                if signal.getsignal(number) not in (signal.SIG_IGN, None):
                    self._before[number] = signal.getsignal(number)
                    signal.signal(number, self._handle)
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        for number, before in self._before.items():
            signal.signal(number, before)

    def hold(self) -> None:
        """Let nothing interrupt from here to the end of the `with` block."""
        self._held = True

    def _handle(self, number: int, frame: FrameType | None) -> None:
        if self._held:
            return
        before = self._before[number]
        if not callable(before):
            raise KeyboardInterrupt
        before(number, frame)
