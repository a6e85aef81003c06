"""Which IMUs answer on the I2C buses, by their identity registers only; nothing is written."""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path

from calib.errors import DriverError
from drivers.chips import chips, normal_name
from drivers.chips.base import Bus, Chip
from drivers.smbus import SmbusBus


def identify(bus: Bus, place: int) -> list[tuple[str, Chip]]:
    """Return the parts that could answer at an address, by their identity registers only.

    Raises
    ------
    OSError
        If nothing answers there.
    """
    found = []
    for chip in chips().values():
        if place in chip.addresses:
            _, part = ask_identity(bus, place, chip)
            if part:
                found.append((part, chip))
    return found


def ask_identity(bus: Bus, place: int, chip: Chip) -> tuple[int, str]:
    """Return what a chip's identity register reads, and the part that it stands for ('')."""
    register = chip.identity.address
    value = bus.read(place, register, 1)[0]
    part = chip.models.get(value, "")
    if part and register == 0 and _is_clock(bus, place):
        part = ""
    return value, part


def _is_clock(bus: Bus, place: int) -> bool:
    """Whether registers 0 to 6 read as a calendar: real-time clocks live at 0x68 too.

    A DS3231 at 24 s reads 0x24 from register 0 as a BMI270 does. Day of week, day and month are
    never zero in a clock; in the chips these registers are status bits and empty data.
    """
    data = bus.read(place, 0, 7)
    date, month = _bcd(data[4] & 0x3F), _bcd(data[5] & 0x1F)
    return 1 <= data[3] <= 7 and 1 <= date <= 31 and 1 <= month <= 12


def _bcd(byte: int) -> int:
    return 10 * (byte >> 4) + (byte & 0x0F)


@dataclass(frozen=True)
class Found:
    """What a scan saw: an IMU at an address, or (``problem``) why a bus could not be read."""

    bus: str
    address: int | None = None
    chip: str = ""
    url: str = ""
    problem: str = ""


def scan_buses(folder: Path = Path("/dev")) -> list[Found]:
    """Look for IMUs on every I2C bus, reading identity registers only; nothing is written."""
    if not sys.platform.startswith("linux"):
        return []
    out: list[Found] = []
    for path in sorted(folder.glob("i2c-[0-9]*"), key=lambda p: int(p.name[4:])):
        try:
            bus = SmbusBus(str(path))
        except DriverError as error:
            out.append(Found(str(path), problem=str(error)))
            continue
        try:
            out += _scan(bus, path)
        finally:
            bus.close()
    return out


def _scan(bus: Bus, path: Path) -> list[Found]:
    out = []
    for place in sorted({a for chip in chips().values() for a in chip.addresses}):
        try:
            answers = identify(bus, place)
        except OSError:
            continue
        name = path.name[4:] if str(path.parent) == "/dev" else str(path)
        for part, _ in answers:
            url = f"i2c://{name}/0x{place:02x}?chip={normal_name(part)}"
            out.append(Found(str(path), place, part, url))
    return out
