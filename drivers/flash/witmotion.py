"""WitMotion: bias registers 05 to 0A, 16 bits, subtracted from the output.

Accelerometer 1/10000 g, gyroscope 1/10000 °/s, as the maker's protocol text for AXOFFSET to
HZOFFSET states. Writes need an unlock, which lasts 10 s.
"""

from __future__ import annotations

import time
from collections.abc import Mapping

import numpy as np

from calib.calibration import Calibration
from calib.gravity import STANDARD_GRAVITY as G
from calib.types import FloatArray
from drivers.dialects.witmotion import RESTART, SAVE, UNLOCK, read_register, write_register
from drivers.flash.stream import StreamTarget
from drivers.flash.target import Action, Native, Plan, Row, determined_bias, not_held

REGISTERS = {
    "AXOFFSET": 0x05,
    "AYOFFSET": 0x06,
    "AZOFFSET": 0x07,
    "GXOFFSET": 0x08,
    "GYOFFSET": 0x09,
    "GZOFFSET": 0x0A,
}
PARAMETERS = [f"{triad}.bias.{axis}" for triad in ("accel", "gyro") for axis in "xyz"]
UNITS = np.repeat([G / 10000, np.deg2rad(1) / 10000], 3)
LIMIT = 32767
ANSWER = 1.0
PAUSE = 0.05
"""s that the device needs between two writes."""
STORE = 0.5
RESTARTING = 1.0


class WitMotionTarget(StreamTarget):
    """The bias registers of a WitMotion device."""

    name = "bias registers"
    volatile = True
    can_persist = True

    def read(self) -> Native:
        answers: list[int] = []
        for first in (0x05, 0x09):
            answers += self._driver.ask(read_register(first), "registers", ANSWER).values
        return dict(zip(REGISTERS, map(float, answers[:6]), strict=True))

    def write(self, values: Mapping[str, float]) -> None:
        self._unlock()
        for name, value in values.items():
            self._driver.send(write_register(REGISTERS[name], int(value)))
            time.sleep(PAUSE)

    def plan(self, old: Native, calibration: Calibration) -> Plan:
        bias = np.concatenate([determined_bias(calibration, t) for t in ("accel", "gyro")])
        before = np.array([old[name] for name in REGISTERS])
        wanted: FloatArray = before + np.nan_to_num(bias) / UNITS
        after = np.clip(np.rint(wanted), -LIMIT, LIMIT)
        rows = tuple(
            Row(
                name,
                PARAMETERS[k],
                float(before[k]),
                float(after[k]),
                float(wanted[k]),
                "x 0.1 mg" if k < 3 else "x 0.0001 °/s",
                clipped=bool(abs(wanted[k] - after[k]) > 0.5),
            )
            for k, name in enumerate(REGISTERS)
        )
        shift = -(after - before) * UNITS
        return Plan(
            rows,
            dict(zip(REGISTERS, after.tolist(), strict=True)),
            Action(shift=shift[:3]),
            Action(shift=shift[3:]),
            not_held(calibration, {"accel.bias", "gyro.bias"}),
        )

    def persist(self) -> None:
        self._unlock()
        self._driver.send(SAVE)
        time.sleep(STORE)

    def restart(self) -> None:
        self._unlock()
        self._driver.send(RESTART)
        time.sleep(RESTARTING)
        self._reconnect()

    def snippet(self, values: Mapping[str, float]) -> str:
        commands = [UNLOCK] + [write_register(REGISTERS[n], int(v)) for n, v in values.items()]
        lines = ["# Send these bytes after every power-on, 50 ms apart, or flash with --persist."]
        return "\n".join(lines + [command.hex(" ") for command in commands]) + "\n"

    def _unlock(self) -> None:
        self._driver.send(UNLOCK)
        time.sleep(PAUSE)
