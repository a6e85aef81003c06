"""The same chips and devices from the other side of the wire."""

from __future__ import annotations

from functools import cache

from calib.registry import discover
from drivers.emulators.base import Emulator


@cache
def emulators() -> dict[str, Emulator]:
    """Return every emulated device of this folder by its name."""
    return discover(__name__, __path__, attribute="EMULATOR", kind=Emulator, key="name")
