"""An autopilot that runs PX4, over MAVLink."""

from __future__ import annotations

from drivers.emulators.autopilot import PX4_FIRMWARE, Autopilot
from drivers.emulators.serial_device import serial_emulator

EMULATOR = serial_emulator(
    "px4",
    "PX4 autopilot, MAVLink on a serial port",
    lambda sensor: Autopilot(sensor, firmware=PX4_FIRMWARE),
    default_rate=50.0,
    dialect="mavlink",
)
