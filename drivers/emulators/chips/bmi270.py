"""BMI270 from the bus's side: it measures once any configuration has been uploaded."""

from __future__ import annotations

from typing import ClassVar

from drivers.chips import bmi270 as r
from drivers.chips.base import Register
from drivers.emulators.chips.bmi160 import Bmi160Model


class Bmi270Model(Bmi160Model):
    """Keeps what was uploaded in ``configuration``."""

    chip_name: ClassVar[str] = "bmi270"
    fifo_config: ClassVar[Register] = r.FIFO_CONFIG_1
    fifo_length: ClassVar[Register] = r.FIFO_LENGTH_0
    fifo_port: ClassVar[Register] = r.FIFO_DATA
    status: ClassVar[Register] = r.STATUS

    def defaults(self) -> dict[Register, int]:
        self.configuration = bytearray()
        return {
            r.STATUS: 0x10,
            r.ACC_CONF: 0xA8,
            r.ACC_RANGE: 0x02,
            r.GYR_CONF: 0xA9,
            r.FIFO_DOWNS: 0x88,
            r.FIFO_CONFIG_0: 0x02,
            r.FIFO_CONFIG_1: 0x10,
            r.PWR_CONF: 0x03,
        }

    def runs(self) -> bool:
        initialised = self.peek(r.MESSAGE) == r.INITIALISED
        return initialised and self.peek(r.PWR_CTRL) & 0x06 == 0x06

    def ranges(self) -> tuple[int, int]:
        return self.peek(r.ACC_RANGE) & 0x03, self.peek(r.GYR_RANGE) & 0x07

    def write(self, data: bytes) -> None:
        if len(data) > 1 and data[0] == r.INIT_DATA.address:
            word = self.peek(r.INIT_ADDR_0) | self._page(None)[r.INIT_ADDR_0.address + 1] << 4
            end = 2 * word + len(data) - 1
            self.configuration.extend(bytes(max(0, end - len(self.configuration))))
            self.configuration[2 * word : end] = data[1:]
            return
        super().write(data)

    def on_write(self, address: int, value: int) -> int:
        if address == r.INIT_CTRL.address and value == 1:
            self.poke(r.MESSAGE, r.INITIALISED if self.configuration else 2)
        return super().on_write(address, value)


MODEL = Bmi270Model
