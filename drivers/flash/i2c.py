"""Bias registers of I2C chips, by their declarations in `drivers.chips`.

They shift the output and hold nothing else: scale factor and misalignment stay with ``apply``.
Registers are read, modified and written, so that factory trim and reserved bits are kept.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np

from calib.calibration import Calibration
from calib.errors import DeviceLostError, DriverError
from calib.recording import DeviceInfo, Recording, join
from calib.types import FloatArray
from drivers.chips.base import BiasField, BiasSet, Register
from drivers.flash.target import Action, Native, Plan, Row, Target, determined_bias, not_held
from drivers.transports.i2c import I2CDriver

SETTLE = 0.2
"""s after a write until the low-pass has forgotten what was before."""


class I2CTarget(Target):
    """The bias registers of the chip behind an `I2CDriver`."""

    name = "bias registers"

    def __init__(self, driver: I2CDriver) -> None:
        super().__init__(driver.address)
        self._driver = driver
        driver.background = False  # its registers are ours, and a bank is selected for one user

    @property
    def info(self) -> DeviceInfo:
        return self._driver.info

    def open(self) -> None:
        self._driver.open()
        if not self._driver.chip.biases:
            chip = self._driver.info.chip
            self._driver.close()
            raise DriverError(
                f"{self.address}: {chip} has no bias registers that imu-cal knows; correct its "
                "recordings with `imu-cal apply` instead"
            )

    def close(self) -> None:
        self._driver.close()

    @property
    def registers(self) -> dict[str, Register]:
        """Every register that flashing reads and may write, by its name."""
        sets = self._driver.chip.biases
        return {r.name: r for biases in sets for field in biases for r in field.registers}

    def read(self) -> Native:
        device = self._driver.device
        try:
            device.forget_bank()
            return {name: float(device.read(r)[0]) for name, r in self.registers.items()}
        except OSError as error:
            raise self._lost("reading its bias registers", error) from error

    def write(self, values: Mapping[str, float]) -> None:
        device, registers = self._driver.device, self.registers
        try:
            for name, value in values.items():
                device.write(registers[name], int(value))
        except OSError as error:
            raise self._lost(f"writing {name}", error) from error

    def plan(self, old: Native, calibration: Calibration) -> Plan:
        before = {r: int(old[name]) for name, r in self.registers.items()}
        biases = {t: determined_bias(calibration, t) for t in ("accel", "gyro")}
        present = self._shift(before)
        wanted = present - np.concatenate([biases["accel"], biases["gyro"]])
        wanted = np.where(np.isnan(wanted), present, wanted)
        chosen, after = self._choose(before, wanted)
        shift = self._shift(after) - present
        rows = tuple(self._row(field, before, after, wanted) for field in chosen)
        held = {field.parameter.rsplit(".", 1)[0] for field in chosen}
        return Plan(
            rows,
            {r.name: float(after[r]) for r in self.registers.values()},
            Action(shift=shift[:3]),
            Action(shift=shift[3:]),
            not_held(calibration, held),
        )

    def _choose(
        self, before: dict[Register, int], wanted: FloatArray
    ) -> tuple[BiasSet, dict[Register, int]]:
        """Return the finest set that holds every value, or the coarsest if none does."""
        for biases in self._driver.chip.biases:
            after, clipped = dict(before), False
            for field in biases:
                for enable, value in field.enable:
                    after[enable.register] = enable.put(after[enable.register], value)
            for field in biases:
                counts = wanted[_channel(field)] / (field.sign * field.unit)
                value = round(counts)
                clipped |= not field.minimum <= value <= field.maximum
                after |= field.encode(min(max(value, field.minimum), field.maximum), after)
            if not clipped:
                break
        return biases, after

    def _shift(self, values: Mapping[Register, int]) -> FloatArray:
        shift = np.zeros(6)
        for field in (field for biases in self._driver.chip.biases for field in biases):
            shift[_channel(field)] += field.shift(values)
        return shift

    def _row(
        self,
        field: BiasField,
        before: dict[Register, int],
        after: dict[Register, int],
        wanted: FloatArray,
    ) -> Row:
        counts = float(wanted[_channel(field)] / (field.sign * field.unit))
        new = field.decode(after)
        accel = field.parameter.startswith("accel")
        size = f"{field.weight * 1000:.3g} mg" if accel else f"{field.weight:.3g} °/s"
        return Row(
            name="+".join(f.register.name for f in field.fields),
            parameter=field.parameter,
            old=field.decode(before),
            new=new,
            wanted=counts,
            unit=f"x {size}",
            clipped=abs(counts - new) > 0.5 + 1e-9,
            note="" if field.acts(before) else "was switched off",
        )

    def measure(self, duration: float) -> Recording:
        driver = self._driver
        try:
            driver.restart_stream(SETTLE)
        except OSError as error:
            raise self._lost("being measured", error) from error
        batches: list[Recording] = []
        first = math.nan
        while not batches or batches[-1].time[-1] - first < duration:
            batch = driver.read(1.0)
            if batch is None:
                raise DeviceLostError(f"{self.address}: no samples came for 1 s")
            first = batch.time[0] if not batches else first
            batches.append(batch)
        return join(batches)

    def snippet(self, values: Mapping[str, float]) -> str:
        driver, registers = self._driver, self.registers
        lines = [
            f"# {self.info.chip}: run this after every power-on, before measuring.",
            "import smbus2",
            "",
            "with smbus2.SMBus(1) as bus:  # the number of your bus",
        ]
        address, bank = driver.device.address, None
        select = driver.chip.bank_select
        for name, value in values.items():
            register = registers[name]
            if select is not None and register.bank != bank:
                bank = register.bank
                code = select.put(0, bank or 0)
                lines.append(
                    f"    bus.write_byte_data(0x{address:02X}, 0x{select.register.address:02X}, "
                    f"0x{code:02X})  # bank {bank}"
                )
            lines.append(
                f"    bus.write_byte_data(0x{address:02X}, 0x{register.address:02X}, "
                f"0x{int(value):02X})  # {name}"
            )
        if select is not None:
            lines.append(
                f"    bus.write_byte_data(0x{address:02X}, 0x{select.register.address:02X}, 0x00)"
            )
        return "\n".join(lines) + "\n"

    def _lost(self, what: str, error: OSError) -> DriverError:
        if isinstance(error, DriverError):
            return error
        return DeviceLostError(f"{self.address}: the chip stopped answering while {what}: {error}")


def _channel(field: BiasField) -> int:
    triad, _, axis = field.parameter.split(".")
    return "xyz".index(axis) + (3 if triad == "gyro" else 0)
