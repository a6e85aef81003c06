"""Writing a calibration into the device: backup, write, read back, measure, roll back.

`make_target` finds what a device can hold; `drivers.flash.procedure` does the rest.
"""

from __future__ import annotations

from pathlib import Path

from drivers.address import parse_address
from drivers.flash.i2c import I2CTarget
from drivers.flash.target import Target
from drivers.transports import make_driver
from drivers.transports.i2c import I2CDriver


def make_target(url: str, *, template: Path | None = None) -> Target:
    """Return the flash target behind an address, not yet open.

    Parameters
    ----------
    template : Path or None
        The commands of a device that prints text lines, which only its user knows.

    Raises
    ------
    AddressError
        If the address is not understood, or names nothing that can be flashed.
    """
    address = parse_address(url)
    driver = make_driver(url)
    if isinstance(driver, I2CDriver):
        return I2CTarget(driver)
    raise address.error("this is no device that can be flashed")
