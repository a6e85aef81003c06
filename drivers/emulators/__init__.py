"""The same chips and devices from the other side of the wire."""

from __future__ import annotations

from functools import cache

from calib.registry import discover
from drivers.emulators.base import Emulator


@cache
def emulators() -> dict[str, Emulator]:
    """Return every emulated device by its name: those of this folder, and the I2C chips."""
    from drivers.emulators.i2c_chips import chip_emulators

    found = discover(__name__, __path__, attribute="EMULATOR", kind=Emulator, key="name")
    return found | chip_emulators()
