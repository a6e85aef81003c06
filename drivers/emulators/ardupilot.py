"""An autopilot that runs ArduPilot, over MAVLink."""

from __future__ import annotations

from drivers.emulators.autopilot import ARDUPILOT_FIRMWARE, Autopilot
from drivers.emulators.serial_device import serial_emulator

EMULATOR = serial_emulator(
    "ardupilot",
    "ArduPilot autopilot, MAVLink on a serial port",
    lambda sensor: Autopilot(sensor, firmware=ARDUPILOT_FIRMWARE),
    default_rate=50.0,
    dialect="mavlink",
)
