"""The Linux adapter: what is said when a bus cannot be opened, and SMBus-only adapters."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

from calib.errors import DeviceNotFoundError, DevicePermissionError, DriverError
from drivers.i2c_scan import scan_buses
from drivers.smbus import SmbusBus

smbus2 = pytest.importorskip("smbus2", reason="I2C is Linux only")


class FakeSmbus:
    """An adapter without plain I2C, or one that cannot be opened."""

    problem: OSError | None = None

    def __init__(self, path: str) -> None:
        if self.problem is not None:
            raise self.problem
        self.funcs = smbus2.I2cFunc.SMBUS_READ_I2C_BLOCK
        self.fd = 0
        self.written: list[tuple[int, int, list[int]]] = []

    def read_i2c_block_data(self, address: int, register: int, count: int) -> list[int]:
        return list(range(register, register + count))

    def write_i2c_block_data(self, address: int, register: int, data: list[int]) -> None:
        self.written.append((address, register, data))

    def close(self) -> None:
        raise OSError(107, "Transport endpoint is not connected")


@pytest.mark.parametrize(
    ("problem", "kind", "message"),
    [
        (PermissionError(13, "denied"), DevicePermissionError, "join the i2c group"),
        (FileNotFoundError(2, "gone"), DeviceNotFoundError, "i2c-dev module"),
        (OSError(25, "Inappropriate ioctl"), DriverError, "cannot open it as an I2C bus"),
    ],
)
def test_why_a_bus_cannot_be_opened(
    monkeypatch: pytest.MonkeyPatch, problem: OSError, kind: type[DriverError], message: str
) -> None:
    monkeypatch.setattr(FakeSmbus, "problem", problem)
    monkeypatch.setattr(smbus2, "SMBus", FakeSmbus)
    with pytest.raises(kind, match=message):
        SmbusBus("/dev/i2c-1")


def test_a_scan_says_when_permission_is_missing(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    (tmp_path / "i2c-3").touch()
    monkeypatch.setattr(FakeSmbus, "problem", PermissionError(13, "denied"))
    monkeypatch.setattr(smbus2, "SMBus", FakeSmbus)
    (found,) = scan_buses(tmp_path)
    assert found.address is None
    assert "i2c group" in found.problem


def test_an_adapter_with_smbus_calls_only(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(smbus2, "SMBus", FakeSmbus)
    bus = SmbusBus("/dev/i2c-1")
    assert bus.read(0x68, 0x3B, 14) == bytes(range(0x3B, 0x3B + 14))
    bus.write(0x68, 0x6B, b"\x01")
    assert bus._bus.written == [(0x68, 0x6B, [1])]
    with pytest.raises(DriverError, match="fifo=off"):
        bus.read(0x68, 0x74, 112)
    bus.close()  # an adapter that was pulled out is gone, and says so


def test_other_systems_are_told(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    (tmp_path / "i2c-3").touch()
    monkeypatch.setattr(sys, "platform", "darwin")
    with pytest.raises(DeviceNotFoundError, match="on Linux only"):
        SmbusBus("/dev/i2c-1")
    assert scan_buses(tmp_path) == []
