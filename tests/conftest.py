"""Fixtures that tests of drivers and of the command line share."""

from __future__ import annotations

import os
import threading
from collections.abc import Callable, Iterator
from typing import Any

import pytest

# Three test processes on two cores: threads within each would only get in the way. The variable is
# read when numpy is first imported, and handed on to the commands that tests start.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

from drivers.emulators import emulators
from drivers.emulators.base import EmulatorOptions


class PtyDevice:
    """`address` to record from; `unplug` makes the device go away."""

    def __init__(self, name: str, options: EmulatorOptions) -> None:
        self._ready = threading.Event()
        self._stop = threading.Event()
        self.address = ""
        self._thread = threading.Thread(
            target=emulators()[name].serve, args=(options, self._announce, self._stop), daemon=True
        )
        self._thread.start()
        assert self._ready.wait(5)

    def _announce(self, address: str) -> None:
        self.address = address
        self._ready.set()

    @property
    def path(self) -> str:
        return self.address.removeprefix("serial://").split("?")[0]

    def unplug(self) -> None:
        self._stop.set()
        self._thread.join(5)


PtyFactory = Callable[..., PtyDevice]


@pytest.fixture
def pty_device() -> Iterator[PtyFactory]:
    """Make emulated serial devices on ptys; they are gone after the test."""
    if os.name != "posix":
        pytest.skip("ptys need a POSIX system")
    made: list[PtyDevice] = []

    def make(name: str, **options: Any) -> PtyDevice:
        made.append(PtyDevice(name, EmulatorOptions(**options)))
        return made[-1]

    yield make
    for device in made:
        device.unplug()
