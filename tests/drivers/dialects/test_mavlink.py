"""Against pymavlink: what it writes we read, and what we write it reads."""

import struct

import numpy as np
import pytest

from calib.errors import AddressError, BadFrameError
from drivers.dialects.mavlink import (
    ARDUPILOT,
    DIALECT,
    MESSAGES,
    MavlinkParser,
    command_long,
    param_request,
    param_set,
)
from drivers.emulators.autopilot import ARDUPILOT_FIRMWARE, PX4_FIRMWARE, Autopilot, Firmware
from drivers.emulators.base import EmulatorOptions, make_sensor

mav1 = pytest.importorskip("pymavlink.dialects.v10.common", reason="needs pymavlink")
mav2 = pytest.importorskip("pymavlink.dialects.v20.common", reason="needs pymavlink")


def parser(**options: str) -> MavlinkParser:
    made = DIALECT.parser(options)
    assert isinstance(made, MavlinkParser)
    return made


def autopilot(firmware: Firmware) -> Autopilot:
    sensor = make_sensor(EmulatorOptions(seed=1), default_rate=50.0)
    return Autopilot(sensor, firmware=firmware)


def test_the_table_of_messages_is_pymavlinks() -> None:
    for message in MESSAGES.values():
        theirs = mav2.mavlink_map[message.number]
        assert theirs.crc_extra == message.crc_extra, message.name
        assert theirs.msgname == message.name
        assert theirs.unpacker.size == message.full
        assert mav1.mavlink_map[message.number].unpacker.size == message.size


@pytest.mark.parametrize("module", [mav1, mav2], ids=["v1", "v2"])
def test_reads_what_pymavlink_writes(module: object) -> None:
    link = module.MAVLink(None, srcSystem=3, srcComponent=7)  # type: ignore[attr-defined]
    data = b""
    for k in range(5):
        for message in (
            link.heartbeat_encode(2, ARDUPILOT, 0, 0, 3),
            link.attitude_encode(k, 0, 0, 0, 0, 0, 0),  # unknown to us: hopped over
            link.scaled_imu_encode(100 * k, 10, -20, 1000, k, -2, 3, 0, 0, 0),
        ):
            data += message.pack(link)
            link.seq = (link.seq + 1) % 256
    made = parser()
    samples = made.feed(data)
    assert np.allclose(samples.accel, np.array([0.01, -0.02, 1.0]) * 9.80665)
    assert np.allclose(samples.gyro[:, 0], np.arange(5) * 1e-3)
    assert samples.ticks is not None
    assert np.allclose(samples.ticks, np.arange(5) * 0.1)
    assert samples.temperature is None
    assert samples.lost.sum() == 0
    assert not made.counters
    assert DIALECT.recognise(data) == 1.0


@pytest.mark.parametrize("firmware", [PX4_FIRMWARE, ARDUPILOT_FIRMWARE], ids=["px4", "ardupilot"])
def test_pymavlink_reads_what_the_emulator_writes(firmware: Firmware) -> None:
    data = autopilot(firmware).stream(0, 120)
    theirs = [m for m in mav2.MAVLink(None).parse_buffer(data) if m.get_type() == firmware.message]
    ours = parser().feed(data)
    assert len(theirs) == len(ours) == 120
    scale = 1.0 if firmware is PX4_FIRMWARE else 9.80665e-3
    assert np.allclose(
        ours.accel, [[m.xacc * scale, m.yacc * scale, m.zacc * scale] for m in theirs]
    )
    assert ours.ticks is not None
    assert np.allclose(ours.ticks, [m.time_usec * 1e-6 for m in theirs])


def test_commands_are_what_pymavlink_would_send() -> None:
    link = mav2.MAVLink(None, srcSystem=255, srcComponent=190)
    theirs = link.param_set_encode(1, 1, b"CAL_ACC0_XOFF", 0.25, 9).pack(link)
    ours = param_set("CAL_ACC0_XOFF", struct.pack("<f", 0.25), 9, system=1, component=1)
    assert ours == bytes(theirs)
    theirs = link.param_request_read_encode(1, 1, b"INS_ACC_ID", -1).pack(link)
    assert param_request("INS_ACC_ID", system=1, component=1) == bytes(theirs)
    theirs = link.command_long_encode(1, 1, 246, 0, 1, 0, 0, 0, 0, 0, 0).pack(link)
    assert command_long(246, 1.0, system=1, component=1) == bytes(theirs)


def test_the_emulator_answers_parameters() -> None:
    device = autopilot(PX4_FIRMWARE)
    request = param_set("CAL_ACC0_XOFF", struct.pack("<f", 0.25), 9, system=1, component=1)
    answer = mav2.MAVLink(None).parse_buffer(device.receive(request[:7] + request[7:]))[0]
    assert (answer.param_id, answer.param_value) == ("CAL_ACC0_XOFF", 0.25)
    made = parser()
    made.feed(device.stream(0, 10) + device.receive(request))
    assert made.replies[-1].key == "PARAM_VALUE,CAL_ACC0_XOFF"
    damaged = bytearray(request)
    damaged[-1] ^= 1
    assert device.receive(bytes(damaged)) == b""


def test_missing_messages_are_counted_even_by_an_uneven_clock() -> None:
    link = mav2.MAVLink(None)
    data, generator, stamp = [], np.random.default_rng(0), 0
    for _ in range(100):
        stamp += int(20_000 * generator.uniform(0.6, 1.4))
        message = link.highres_imu_encode(stamp, *[0.5] * 6, 0, 0, 0, 0, 0, 0, 20, 0x3F)
        data.append(bytes(message.pack(link)))
        link.seq = (link.seq + 1) % 256
    whole = parser().feed(b"".join(data))
    assert whole.lost.sum() == 0
    cut = parser().feed(b"".join(data[:40] + data[43:]))
    assert np.flatnonzero(cut.lost).tolist() == [40]
    assert 1 <= cut.lost[40] <= 3


def test_values_that_were_not_updated_are_no_samples() -> None:
    link = mav2.MAVLink(None)
    data = b""
    for k, updated in enumerate([0x3F, 0x07, 0x3F]):
        message = link.highres_imu_encode(k * 1000, *[0.5] * 6, 0, 0, 0, 0, 0, 0, 20, updated)
        data += message.pack(link)
        link.seq += 1
    made = parser()
    assert made.feed(data).lost.tolist() == [0, 1]
    assert made.counters == {"stale_samples": 1}


def test_raw_imu_needs_a_unit() -> None:
    link = mav2.MAVLink(None)
    data = b""
    for k in range(300):
        data += link.raw_imu_encode(k * 1000, 1, 2, 3, 4, 5, 6, 7, 8, 9).pack(link)
        link.seq = (link.seq + 1) % 256
    with pytest.raises(BadFrameError, match="accel_lsb"):
        parser().feed(data)
    samples = parser(accel_lsb="0.01", gyro_lsb="0.001").feed(data)
    assert np.allclose(samples.accel[0], [0.01, 0.02, 0.03])


@pytest.mark.parametrize(
    "options", [{"message": "ATTITUDE"}, {"accel_lsb": "0.1"}, {"accel_lsb": "0", "gyro_lsb": "1"}]
)
def test_options_are_checked(options: dict[str, str]) -> None:
    with pytest.raises(AddressError):
        parser(**options)
