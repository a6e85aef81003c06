"""Writing a calibration into the device: backup, write, read back, measure, roll back.

`make_target` finds what a device can hold; `drivers.flash.procedure` does the rest.
"""

from __future__ import annotations

from pathlib import Path

from drivers.address import parse_address
from drivers.flash.i2c import I2CTarget
from drivers.flash.mavlink import MavlinkTarget
from drivers.flash.stream import StreamTarget
from drivers.flash.target import Target
from drivers.flash.text import TextTarget, load_template
from drivers.flash.vectornav import VectorNavTarget
from drivers.flash.witmotion import WitMotionTarget
from drivers.stream import StreamDriver
from drivers.transports import make_driver
from drivers.transports.i2c import I2CDriver

STREAM_TARGETS: dict[str, type[StreamTarget]] = {
    "mavlink": MavlinkTarget,
    "vectornav": VectorNavTarget,
    "witmotion": WitMotionTarget,
}


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
    if isinstance(driver, StreamDriver) and address.scheme != "replay":
        name = driver.dialect.name if driver.dialect is not None else ""
        if name == "text":
            if template is None:
                raise address.error("what a text device understands only you know: add --template")
            return TextTarget(driver, load_template(template))
        if name in STREAM_TARGETS:
            return STREAM_TARGETS[name](driver)
        if not name:
            known = ", ".join((*STREAM_TARGETS, "text"))
            raise address.error(f"say what it is before it is written to: add dialect= ({known})")
    raise address.error("this is no device that can be flashed")
