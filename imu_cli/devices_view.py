"""How devices are listed."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from imu_cli import output

if TYPE_CHECKING:
    from drivers.i2c_scan import Found
    from drivers.transports.serial import SerialPort


def show(ports: Sequence[SerialPort], chips: Sequence[Found], *, as_json: bool) -> None:
    """Print serial ports, I2C chips, and what kept us from looking."""
    if as_json:
        output.print_json(to_json(ports, chips))
        return
    from rich.table import Table

    table = Table(box=None, pad_edge=False)
    for heading in ("address", "device", "USB id", "serial number", ""):
        table.add_column(heading)
    for port in ports:
        identity = "" if port.vid is None else f"{port.vid:04x}:{port.pid:04x}"
        table.add_row(
            port.url,
            "" if port.description == "n/a" else port.description,
            identity,
            port.serial_number or "",
            port.problem,
        )
    for chip in chips:
        if not chip.problem:
            table.add_row(chip.url, chip.chip, "", "", "")
    if table.rows:
        output.print_lines(table)
    else:
        output.print_lines(
            "no serial port and no IMU on an I2C bus. Is the device plugged in, with a cable that "
            "carries data? `imu-cal emulate` runs one without hardware"
        )
    for chip in chips:
        if chip.problem:
            output.warn(chip.problem)


def to_json(ports: Sequence[SerialPort], chips: Sequence[Found]) -> dict[str, Any]:
    """Return the devices as a JSON document."""
    return {
        "format": "imu-cal/devices",
        "version": 1,
        "serial": [
            {
                "address": port.url,
                "path": port.path,
                "description": port.description,
                "vid": port.vid,
                "pid": port.pid,
                "serial_number": port.serial_number,
                "problem": port.problem or None,
            }
            for port in ports
        ],
        "i2c": [
            {"address": chip.url, "bus": chip.bus, "chip": chip.chip}
            for chip in chips
            if not chip.problem
        ],
        "problems": [chip.problem for chip in chips if chip.problem],
    }
