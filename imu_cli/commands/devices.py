"""List serial ports and the chips on I2C buses."""

from __future__ import annotations

from typing import Annotated

import typer


def devices(
    json: Annotated[bool, typer.Option("--json", help="Print the list as JSON.")] = False,
) -> None:
    """List serial ports and the chips on I2C buses.

    An I2C chip is asked for its identity register and nothing else: clocks and other chips have
    the same addresses.
    """
    from drivers.i2c_scan import scan_buses
    from drivers.transports.serial import list_serial_ports
    from imu_cli import devices_view as view

    view.show(list_serial_ports(), scan_buses(), as_json=json)
