"""A VectorNav VN-100 that streams ``$VNMAR`` sentences."""

from __future__ import annotations

from drivers.emulators.serial_device import serial_emulator
from drivers.emulators.vectornav import VectorNavDevice

EMULATOR = serial_emulator(
    "vectornav-ascii",
    "VectorNav VN-100, ASCII sentences, on a serial port",
    lambda sensor: VectorNavDevice(sensor, binary=False),
    default_rate=40.0,
    dialect="vectornav",
)
