"""Registers, fields, bias fields and FIFO frames, on anything that hypothesis thinks of."""

from __future__ import annotations

import errno

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from calib.errors import DriverError, DriverTimeoutError
from drivers.chips import bosch, chips, get_chip
from drivers.chips.base import BiasField, Device, Field, Register, Setup
from drivers.chips.bmi270 import CHIP as BMI270
from drivers.emulators.base import EmulatorOptions
from drivers.emulators.i2c_bus import EmulatedBus, Message
from drivers.emulators.i2c_chips import host_clock, make_model

FIELDS = [field for chip in chips().values() for biases in chip.biases for field in biases]
octet = st.integers(0, 255)


@given(octet, st.integers(0, 7), st.integers(0, 7), octet)
def test_a_field_changes_only_its_own_bits(byte: int, a: int, b: int, value: int) -> None:
    field = Field(Register("R", 0), max(a, b), min(a, b))
    value &= (1 << field.width) - 1
    new = field.put(byte, value)
    assert field.get(new) == value
    assert (new ^ byte) & ~field.mask == 0


def test_a_value_that_does_not_fit_is_refused() -> None:
    with pytest.raises(ValueError, match="`value` 4 does not fit 2 bits"):
        Register("R", 0).field(1, 0).put(0, 4)


@given(st.sampled_from(FIELDS), st.data())
def test_bias_fields_round_trip_and_keep_reserved_bits(
    field: BiasField, data: st.DataObject
) -> None:
    value = data.draw(st.integers(field.minimum, field.maximum))
    before = {f.register: data.draw(octet) for f in field.fields}
    after = field.encode(value, before)
    assert field.decode(after) == value
    for register, byte in after.items():
        mask = sum(f.mask for f in field.fields if f.register == register)
        assert (byte ^ before[register]) & ~mask == 0
    with pytest.raises(ValueError, match="`value`"):
        field.encode(field.maximum + 1, before)


@pytest.mark.parametrize(
    ("part", "parameter", "value", "registers"),
    [
        # Worked by hand from the register maps.
        ("mpu6050", "accel.bias.x", -1, {0x06: 0xFF, 0x07: 0xFE}),
        ("mpu6500", "accel.bias.z", 258, {0x7D: 0x02, 0x7E: 0x04}),
        ("mpu6500", "gyro.bias.y", -2, {0x15: 0xFF, 0x16: 0xFE}),
        ("icm42688p", "gyro.bias.x", -1, {0x78: 0x0F, 0x77: 0xFF}),
        ("icm42688p", "gyro.bias.y", 0x123, {0x78: 0x10, 0x79: 0x23}),
        ("icm42688p", "accel.bias.x", 0x123, {0x7B: 0x10, 0x7C: 0x23}),
        ("icm42688p", "accel.bias.z", -2, {0x7E: 0xF0, 0x7F: 0xFE}),
        ("bmi160", "gyro.bias.z", -1, {0x77: 0x30, 0x76: 0xFF}),
        ("bmi270", "accel.bias.y", -3, {0x72: 0xFD}),
        ("lsm6dso", "accel.bias.y", 5, {0x74: 0x05}),
    ],
)
def test_bias_fields_are_where_the_register_maps_say(
    part: str, parameter: str, value: int, registers: dict[int, int]
) -> None:
    field = next(f for f in get_chip(part).biases[0] if f.parameter == parameter)
    blank = {f.register: 0 for f in field.fields}
    written = {register.address: byte for register, byte in field.encode(value, blank).items()}
    assert written == registers


def samples(count: int, seed: int) -> np.ndarray:  # type: ignore[type-arg]
    rows = np.zeros(count, bosch.FRAME)
    rng = np.random.default_rng(seed)
    rows["head"] = bosch.HEAD_BOTH
    for name in ("gyro", "accel"):
        rows[name] = rng.integers(-32768, 32768, (count, 3))
    return rows


@given(st.binary(max_size=300), st.sampled_from([1, 4]))
def test_any_bytes_are_taken_apart_without_an_error(data: bytes, config_length: int) -> None:
    frames = bosch.parse_frames(data, config_length=config_length)
    assert len(frames.accel) == len(frames.gyro) <= len(data) // 13
    assert frames.skipped >= 0


@given(st.lists(st.integers(0, 6), max_size=6), st.integers(0, 40), st.integers(0, 2**32))
def test_frames_between_other_frames_are_found_and_a_cut_one_is_left(
    counts: list[int], cut: int, seed: int
) -> None:
    others = [b"\x40\x07", b"\x48\x01", b"\x44\x01\x02\x03"]
    stream, expected, skipped = b"", [], 0
    for k, count in enumerate(counts):
        rows = samples(count, seed + k)
        stream += rows.tobytes() + others[k % 3]
        expected.append(rows)
        skipped += 7 * (k % 3 == 0)
    tail = samples(1, seed).tobytes()[:-1]
    frames = bosch.parse_frames(stream + tail[: min(cut, 12)], config_length=1)
    whole = np.concatenate([*expected, samples(0, 0)])
    assert (frames.accel == whole["accel"]).all()
    assert (frames.gyro == whole["gyro"]).all()
    assert frames.skipped == skipped
    assert not frames.damaged


def test_waiting_has_an_end() -> None:
    class Silent:
        def read(self, address: int, register: int, count: int) -> bytes:
            return bytes(count)

        def write(self, address: int, register: int, data: bytes) -> None:
            raise AssertionError

        def close(self) -> None:
            pass

    device = Device(Silent(), 0x68, sleep=lambda wait: None)
    field = Register("STATUS", 0x03).field(1)
    with pytest.raises(DriverTimeoutError, match=r"waking: STATUS \(0x03\) did not become 1"):
        device.wait(field, 1, timeout=0.1, what="waking")


@pytest.mark.parametrize("part", ["icm20948", "icm42688p"])
def test_banks_are_selected_once_and_again_when_forgotten(part: str) -> None:
    chip = get_chip(part)
    written: list[bytes] = []

    def watch(number: int, messages: tuple[Message, ...]) -> None:
        if messages[0].data[0] == chip.bank_select.register.address:  # type: ignore[union-attr]
            written.append(messages[0].data[1:])

    bus = EmulatedBus({0x68: make_model(part, EmulatorOptions())}, fault=watch)
    device = Device(bus, 0x68, bank_select=chip.bank_select)
    first, second = Register("A", 0x10, 1), Register("B", 0x11, 2)
    for register in (first, first, second, second, first):
        device.read(register)
    codes = [chip.bank_select.put(0, bank) for bank in (1, 2, 1)]  # type: ignore[union-attr]
    assert written == [bytes([code]) for code in codes]
    device.forget_bank()
    device.read(first)
    assert len(written) == 4


@pytest.mark.parametrize("chip", chips())
def test_a_reset_brings_the_power_on_registers_back(chip: str) -> None:
    model = make_model(next(iter(get_chip(chip).models.values())), EmulatorOptions())
    place = get_chip(chip).addresses[0]
    before = {bank: bytes(page) for bank, page in model._memory.items()}
    device = Device(
        EmulatedBus({place: model}),
        place,
        bank_select=get_chip(chip).bank_select,
        sleep=lambda wait: None,
    )
    setup = Setup(*get_chip(chip).default_ranges, get_chip(chip).default_rate, firmware=bytes(32))
    clock = host_clock(0)
    model._clock = clock.now
    get_chip(chip).configure(device, setup)
    get_chip(chip).reset(device)
    for register in model.defaults():
        if register.name not in ("PWR_MGMT_1",):  # a reset leaves the clock chosen and it awake
            assert model.peek(register) == before[register.bank or 0][register.address]


@pytest.mark.parametrize(
    ("firmware", "message"), [(None, "config_file=PATH"), (b"", "whole words"), (b"abc", "3 bytes")]
)
def test_a_bmi270_without_its_configuration_says_so(firmware: bytes | None, message: str) -> None:
    bus = EmulatedBus({0x68: make_model("bmi270", EmulatorOptions())})
    device = Device(bus, 0x68, sleep=lambda wait: None)
    with pytest.raises(DriverError, match=message):
        BMI270.configure(device, Setup(4, 500, 100, firmware=firmware))


def test_a_bmi270_takes_its_configuration_whole() -> None:
    model = make_model("bmi270", EmulatorOptions())
    device = Device(EmulatedBus({0x68: model}), 0x68, sleep=lambda wait: None)
    firmware = np.random.default_rng(1).bytes(8192)
    BMI270.configure(device, Setup(4, 500, 100, firmware=firmware))
    assert bytes(model.configuration) == firmware  # type: ignore[attr-defined]


def test_nobody_at_an_address_does_not_acknowledge() -> None:
    with pytest.raises(OSError) as error:
        EmulatedBus({}).read(0x68, 0, 1)
    assert error.value.errno == errno.EREMOTEIO
