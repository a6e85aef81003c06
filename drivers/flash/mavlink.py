"""Autopilots over MAVLink: ArduPilot and PX4 calibration parameters.

``output = (raw - offset) * scale`` for each axis; the gyroscope has offsets only. Parameters are
32-bit floats and are stored as soon as they are set. A library's parameter setter may take any
answer with the right name: here the value that comes back is compared.
"""

from __future__ import annotations

import struct
import time
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from calib.calibration import Calibration
from calib.errors import DriverError, DriverTimeoutError, FlashError, WrongDeviceError
from calib.types import FloatArray
from drivers.dialects.mavlink import ARDUPILOT, PX4, command_long, param_request, param_set
from drivers.flash.stream import StreamTarget, affine_action
from drivers.flash.target import Native, Plan, Row, not_held
from drivers.stream import StreamDriver

REAL32 = 9
REBOOT = 246
HEARTBEAT = 3.0
ANSWER = 1.0
TRIES = 3
RESTARTING = 3.0


@dataclass(frozen=True)
class Names:
    """One firmware's parameters; ``{}`` stands for X, Y or Z."""

    firmware: str
    accel_bias: str
    accel_scale: str
    gyro_bias: str
    rotation: str

    @property
    def all(self) -> list[str]:
        """Every parameter that is read and written."""
        forms = (self.accel_bias, self.accel_scale, self.gyro_bias)
        return [form.format(axis) for form in forms for axis in "XYZ"]


FIRMWARES = {
    ARDUPILOT: Names(
        "ArduPilot", "INS_ACCOFFS_{}", "INS_ACCSCAL_{}", "INS_GYROFFS_{}", "AHRS_ORIENTATION"
    ),
    PX4: Names("PX4", "CAL_ACC0_{}OFF", "CAL_ACC0_{}SCALE", "CAL_GYRO0_{}OFF", "SENS_BOARD_ROT"),
}


class MavlinkTarget(StreamTarget):
    """The calibration parameters of an autopilot."""

    name = "calibration parameters"
    volatile = False
    can_persist = True
    always_stored = True

    def __init__(self, driver: StreamDriver) -> None:
        super().__init__(driver)
        self._names = FIRMWARES[ARDUPILOT]
        self._place = {"system": 1, "component": 1}

    def open(self) -> None:
        super().open()
        try:
            _, autopilot, system, component = self._driver.ask(b"", "HEARTBEAT", HEARTBEAT).values
            if autopilot not in FIRMWARES:
                raise WrongDeviceError(
                    f"{self.address}: autopilot {autopilot} is neither ArduPilot (3) nor PX4 (12)"
                )
            self._names = FIRMWARES[autopilot]
            self._place = {"system": system, "component": component}
            self._refuse_rotation()
        except DriverError:
            self.close()
            raise

    def _refuse_rotation(self) -> None:
        """Parameters act in the sensor's axes, the stream is in the board's: they must agree."""
        try:
            raw, *_ = self._ask(self._names.rotation, ANSWER / 2)
        except DriverTimeoutError:
            return  # it has no such parameter
        if raw != bytes(4):
            raise DriverError(
                f"{self.address}: {self._names.rotation} is set, so that the stream's axes are not "
                "the sensor's; set it to 0, record, calibrate and flash, and set it again"
            )

    def read(self) -> Native:
        return {name: self._value(name) for name in self._names.all}

    def _value(self, name: str) -> float:
        for attempt in range(TRIES):
            try:
                raw, *_ = self._ask(name, ANSWER)
                return float(struct.unpack("<f", raw)[0])
            except DriverTimeoutError:
                if attempt == TRIES - 1:
                    raise
        raise AssertionError

    def _ask(self, name: str, timeout: float) -> tuple[bytes, int]:
        values = self._driver.ask(
            param_request(name, **self._place), f"PARAM_VALUE,{name}", timeout
        ).values
        return values[0], values[1]

    def write(self, values: Mapping[str, float]) -> None:
        for name, value in values.items():
            raw = struct.pack("<f", value)
            request = param_set(name, raw, REAL32, **self._place)
            for _ in range(TRIES):
                try:
                    echo = self._driver.ask(request, f"PARAM_VALUE,{name}", ANSWER).values[0]
                except DriverTimeoutError:
                    continue
                if echo == raw:
                    break
            else:
                raise FlashError(f"{self.address}: {name} = {value:.7g} was not accepted")

    def plan(self, old: Native, calibration: Calibration) -> Plan:
        names, model = self._names, calibration.model
        bias, scale = self._vector(old, names.accel_bias), self._vector(old, names.accel_scale)
        gyro = self._vector(old, names.gyro_bias)
        if (scale == 0).any():
            raise FlashError(f"{self.address}: a scale parameter is 0: reset the calibration first")
        # m = (raw - o0) s0; without b and S: s1 = s0 / (1 + S), o1 = o0 + b / s0.
        wanted = {
            names.accel_bias: bias + model.accel.bias / scale,
            names.accel_scale: scale / (1 + model.accel.scale_factor_error),
            names.gyro_bias: gyro + model.gyro.bias,
        }
        new, rows = Native(), []
        groups = dict(
            zip(wanted, ("accel.bias", "accel.scale_factor_error", "gyro.bias"), strict=True)
        )
        units = dict(zip(wanted, ("m/s²", "1", "rad/s"), strict=True))
        for form, values in wanted.items():
            for k, axis in enumerate("XYZ"):
                name = form.format(axis)
                new[name] = float(np.float32(values[k]))
                rows.append(
                    Row(
                        name,
                        f"{groups[form]}.{axis.lower()}",
                        old[name],
                        new[name],
                        float(values[k]),
                        units[form],
                    )
                )
        return Plan(
            tuple(rows),
            new,
            affine_action(
                np.diag(scale),
                bias,
                np.diag(self._vector(new, names.accel_scale)),
                self._vector(new, names.accel_bias),
            ),
            affine_action(np.eye(3), gyro, np.eye(3), self._vector(new, names.gyro_bias)),
            not_held(calibration, set(groups.values())),
        )

    def persist(self) -> None:
        """Do nothing: they were stored when they were set."""

    def restart(self) -> None:
        try:
            self._driver.ask(
                command_long(REBOOT, 1.0, **self._place), f"COMMAND_ACK,{REBOOT}", ANSWER
            )
        except DriverTimeoutError:
            self._driver.send(command_long(REBOOT, 1.0, **self._place))
        time.sleep(RESTARTING)
        self._reconnect()

    @staticmethod
    def _vector(values: Mapping[str, float], form: str) -> FloatArray:
        return np.array([values[form.format(axis)] for axis in "XYZ"])
