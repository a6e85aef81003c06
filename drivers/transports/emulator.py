"""``emulator://NAME?rate=200&seed=1``: an emulated chip or serial device, inside this process."""

from __future__ import annotations

from drivers.address import Address
from drivers.driver import Driver
from drivers.emulators import emulators
from drivers.transports.base import Transport


def _make(address: Address) -> Driver:
    emulator = emulators().get(address.target)
    if emulator is None:
        known = ", ".join(sorted(emulators()))
        raise address.error(f"no emulator is called {address.target!r}; known: {known}")
    return emulator.driver(address)


TRANSPORT = Transport("emulator", "emulator://mpu6050?rate=200&seed=1", _make)
