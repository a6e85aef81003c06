"""Ways to reach a device: serial port, I2C bus, replayed file, emulator; one file each."""

from __future__ import annotations

from functools import cache

from calib.registry import discover
from drivers.address import parse_address
from drivers.driver import Driver
from drivers.transports.base import Transport


@cache
def transports() -> dict[str, Transport]:
    """Return every transport of this folder by its scheme."""
    return discover(__name__, __path__, attribute="TRANSPORT", kind=Transport, key="scheme")


def make_driver(url: str) -> Driver:
    """Return the driver for an address, not yet open; no I/O happens.

    Raises
    ------
    AddressError
        If the address or one of its options is not understood.
    """
    address = parse_address(url)
    transport = transports().get(address.scheme)
    if transport is None:
        known = ", ".join(f"{t.scheme}:// (as in {t.example})" for t in transports().values())
        raise address.error(f"unknown scheme {address.scheme}://; known: {known}")
    return transport.make(address)


def open_driver(url: str) -> Driver:
    """Return the open driver for an address; use it in ``with``, which closes it.

    Raises
    ------
    AddressError
        If the address is not understood.
    DriverError
        If the device cannot be opened.
    """
    driver = make_driver(url)
    driver.open()
    return driver
