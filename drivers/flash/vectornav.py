"""VectorNav: registers 25 (accelerometer) and 84 (gyroscope), ``output = C @ (measured - B)``.

They hold bias, scale factor and misalignment whole. Values travel as text with six decimals, so
that is what they are rounded to. Source: VN-100 user manual, sections of these registers.
"""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from calib.calibration import Calibration
from calib.errors import BadFrameError, FlashError
from calib.recording import DeviceInfo
from calib.types import FloatArray
from drivers.dialects.vectornav import command
from drivers.flash.stream import StreamTarget, affine_action
from drivers.flash.target import Action, Native, Plan, Row, not_held
from drivers.stream import StreamDriver

REGISTERS = {"accel": 25, "gyro": 84}
DECIMALS = 6
ANSWER = 1.0
STORE = 3.0
RESTARTING = 1.0
UNITS = {"accel": "m/s²", "gyro": "rad/s"}


def _names(register: int) -> list[str]:
    matrix = [f"{register}.C{i}{j}" for i in "123" for j in "123"]
    return matrix + [f"{register}.B{i}" for i in "123"]


class VectorNavTarget(StreamTarget):
    """The compensation registers of a VectorNav device."""

    name = "compensation registers"
    volatile = True
    can_persist = True
    persist_note = " (keep it still for a second)"

    def __init__(self, driver: StreamDriver) -> None:
        super().__init__(driver)
        self._serial_number = ""

    @property
    def info(self) -> DeviceInfo:
        return replace(super().info, serial_number=self._serial_number)

    def open(self) -> None:
        super().open()
        (number,) = self._ask("VNRRG,3", "VNRRG,3", 1)
        # Digits that a float swallowed come back as digits.
        text = number if isinstance(number, str) else f"{number:.0f}"
        self._serial_number = text

    def read(self) -> Native:
        values: Native = {}
        for register in REGISTERS.values():
            answer = self._ask(f"VNRRG,{register}", f"VNRRG,{register}", 12)
            values |= dict(zip(_names(register), map(float, answer), strict=True))
        return values

    def write(self, values: Mapping[str, float]) -> None:
        for register in REGISTERS.values():
            words = ",".join(f"{values[name]:.{DECIMALS}f}" for name in _names(register))
            self._ask(f"VNWRG,{register},{words}", f"VNWRG,{register}", 12)

    def plan(self, old: Native, calibration: Calibration) -> Plan:
        rows: list[Row] = []
        new: Native = {}
        actions: list[Action] = []
        for triad, register in REGISTERS.items():
            names = _names(register)
            matrix, bias = _split([old[name] for name in names])
            model = getattr(calibration.model, triad)
            # t = K (m - b) with m = C0 (a - B0): C1 = K C0, B1 = B0 + C0⁻¹ b.
            inverse = np.linalg.inv(model.matrix)
            wanted = [*(inverse @ matrix).ravel(), *(bias + np.linalg.solve(matrix, model.bias))]
            held = np.round(np.array(wanted), DECIMALS)
            actions.append(affine_action(matrix, bias, *_split(held)))
            for k, name in enumerate(names):
                new[name] = float(held[k]) + 0.0
                group = f"{triad}.bias" if k >= 9 else f"{triad}.scale_factor_error, misalignment"
                rows.append(
                    Row(
                        name,
                        group,
                        old[name],
                        new[name],
                        wanted[k],
                        UNITS[triad] if k >= 9 else "1",
                    )
                )
        groups = ("bias", "scale_factor_error", "misalignment")
        held_groups = {f"{triad}.{group}" for triad in REGISTERS for group in groups}
        return Plan(tuple(rows), new, actions[0], actions[1], not_held(calibration, held_groups))

    def persist(self) -> None:
        self._ask("VNWNV", "VNWNV", 0, timeout=STORE)

    def restart(self) -> None:
        self._ask("VNRST", "VNRST", 0)
        time.sleep(RESTARTING)
        self._reconnect()

    def snippet(self, values: Mapping[str, float]) -> str:
        lines = ["# Send these lines after every power-on, or flash with --persist."]
        for register in REGISTERS.values():
            words = ",".join(f"{values[name]:.{DECIMALS}f}" for name in _names(register))
            lines.append(command(f"VNWRG,{register},{words}").decode("ascii").strip())
        return "\n".join(lines) + "\n"

    def _ask(
        self, body: str, key: str, count: int, *, timeout: float = ANSWER
    ) -> tuple[float | str, ...]:
        """Send a command; its answer must have at least `count` values."""
        reply = self._driver.ask(command(body), key, timeout)
        if len(reply.values) < count:
            raise BadFrameError(
                f"{self.address}: {body.split(',')[:2]} answered {len(reply.values)} values, "
                f"expected {count}"
            )
        if count == 12 and not all(isinstance(value, float) for value in reply.values):
            raise FlashError(f"{self.address}: {key} answered no numbers: {reply.values}")
        return reply.values[: count or None]


def _split(values: FloatArray | list[float]) -> tuple[FloatArray, FloatArray]:
    array = np.asarray(values, np.float64)
    return array[:9].reshape(3, 3), array[9:]
