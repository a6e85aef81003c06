"""The I2C driver: options, identity, samples through FIFO and bursts, overflow, losses, times."""

from __future__ import annotations

import errno
import itertools
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from calib.errors import (
    AddressError,
    DeviceLostError,
    DeviceNotFoundError,
    WrongDeviceError,
)
from calib.recording import Recording
from drivers.address import parse_address
from drivers.chips import chips, get_chip, normal_name
from drivers.chips.base import Chip, Setup
from drivers.driver import Driver
from drivers.emulators.base import EmulatorOptions, make_sensor
from drivers.emulators.i2c_bus import EmulatedBus, Fault, Message, fail_at
from drivers.emulators.i2c_chips import ANY_FIRMWARE, host_clock, make_model
from drivers.i2c_scan import identify
from drivers.sample_times import DeviceTimes, SampleTimes
from drivers.transports import make_driver, open_driver
from drivers.transports.i2c import I2CDriver, setup_from_options

PARTS = [normal_name(part) for chip in chips().values() for part in chip.models.values()]


def collect(driver: Driver, n: int) -> Recording:
    batches = []
    got = 0
    while got < n:
        batch = driver.read(1.0)
        assert batch is not None
        batches.append(batch)
        got += len(batch)
    return Recording(
        time=np.concatenate([b.time for b in batches]),
        accel=np.concatenate([b.accel for b in batches]),
        gyro=np.concatenate([b.gyro for b in batches]),
        clock="host",
        lost=np.concatenate([b.lost for b in batches if b.lost is not None]),
        temperature=None
        if batches[0].temperature is None
        else np.concatenate([b.temperature for b in batches if b.temperature is not None]),
    )


@pytest.mark.parametrize("fifo", ["on", "off"])
@pytest.mark.parametrize("part", PARTS)
def test_every_part_gives_what_its_sensor_measures(part: str, fifo: str) -> None:
    rate = 100.0
    with open_driver(f"emulator://{part}?rate={rate:g}&seed=3&speed=0&fifo={fifo}") as driver:
        real = driver.info.rate
        assert real is not None
        recording = collect(driver, 400)
        lsb = driver.info.accel_lsb, driver.info.gyro_lsb
    sensor = make_sensor(EmulatorOptions(rate=real, seed=3), default_rate=real)
    temperature = sensor.measure(0, 1)[1]
    true = sensor.model.distort(sensor.state)
    count = len(recording)
    for got, expected, sigma, step in (
        (recording.accel, true.accel[0], sensor._sigma[0], lsb[0]),
        (recording.gyro, true.gyro[0], sensor._sigma[3], lsb[1]),
    ):
        # five standard errors of the mean, and half a count of rounding
        assert np.abs(got.mean(axis=0) - expected).max() < 5 * sigma / np.sqrt(count) + step / 2
        assert got.std(axis=0) == pytest.approx(np.hypot(sigma, step / np.sqrt(12)), rel=0.2)
    assert recording.temperature is not None
    assert recording.temperature == pytest.approx(temperature[0], abs=0.6)
    assert recording.samples_lost == 0
    assert np.diff(recording.time[50:]) == pytest.approx(1 / real, rel=0.35)
    assert recording.duration == pytest.approx((count - 1) / real, rel=0.02)


@pytest.mark.parametrize("part", PARTS)
def test_overflow_is_counted_to_the_sample(part: str) -> None:
    rate = min(get_chip(part).rates(), key=lambda r: abs(r - 300))
    with open_driver(f"emulator://{part}?rate={rate}&seed=1&speed=0") as driver:
        assert isinstance(driver, I2CDriver)
        first = collect(driver, 2000)  # long enough to know the rate to 1e-4
        driver._clock.sleep(20.0)
        later = collect(driver, 200)
        real = driver.info.rate
    assert driver.counters["fifo_overflows"] == 1
    span = (later.time[-1] - first.time[-1]) * real
    assert len(later) + later.samples_lost == pytest.approx(span, abs=2)
    assert later.samples_lost > 15 * rate


@pytest.mark.parametrize("part", PARTS)
def test_auto_finds_the_part(part: str) -> None:
    place = chips_address(part)[0]
    bus = EmulatedBus({place: make_model(part, EmulatorOptions())})
    assert [normal_name(name) for name, _ in identify(bus, place)] == [part]


def chips_address(part: str) -> tuple[int, ...]:
    return get_chip(part).addresses


class DummyModel:
    """Answers every register from a table, as some other chip at this address."""

    def __init__(self, registers: dict[int, int]) -> None:
        self.registers = registers
        self.pointer = 0

    def write(self, data: bytes) -> None:
        assert len(data) == 1, "a scan writes nothing"
        self.pointer = data[0]

    def read(self, count: int) -> bytes:
        return bytes(self.registers.get(self.pointer + k, 0) for k in range(count))


@pytest.mark.parametrize("seconds", range(60))
def test_a_clock_is_not_taken_for_an_imu(seconds: int) -> None:
    bcd = (seconds // 10) << 4 | seconds % 10
    clock = DummyModel({0: bcd, 1: 0x59, 2: 0x23, 3: 6, 4: 0x21, 5: 0x91, 6: 0x26})
    assert identify(EmulatedBus({0x68: clock}), 0x68) == []  # type: ignore[dict-item]
    halted = DummyModel(clock.registers | {0: bcd | 0x80})
    assert identify(EmulatedBus({0x68: halted}), 0x68) == []  # type: ignore[dict-item]


def in_process(part: str, chip: str = "auto", fault: Fault | None = None) -> I2CDriver:
    place = chips_address(part)[0]
    clock = host_clock(0)
    bus = EmulatedBus({place: make_model(part, EmulatorOptions(), clock=clock.now)}, fault=fault)
    setup = setup_from_options(parse_address("i2c://1/0x68?rate=200"))

    def with_firmware(c: Chip) -> Setup:
        return replace(setup(c), firmware=ANY_FIRMWARE)

    return I2CDriver(
        "i2c://1/0x68",
        connect=lambda: bus,
        place=place,
        chip=chip,
        setup=with_firmware,
        clock=clock,
    )


def test_wrong_chip_says_which_one_answered() -> None:
    driver = in_process("mpu6050", chip="mpu9250")
    with pytest.raises(WrongDeviceError, match=r"0x75 reads 0x68.*it is an MPU-6050.*mpu6050"):
        driver.open()
    assert not driver.is_open


def test_unknown_chip_and_nobody() -> None:
    driver = in_process("mpu6050")
    driver._connect = lambda: EmulatedBus({0x68: DummyModel({})})  # type: ignore[dict-item]
    with pytest.raises(WrongDeviceError, match="no IMU that imu-cal knows"):
        driver.open()
    driver._connect = lambda: EmulatedBus({})
    with pytest.raises(DeviceNotFoundError, match=r"nothing answers at 0x68.*wiring"):
        driver.open()


def test_a_chip_that_vanishes_is_lost() -> None:
    driver = in_process("mpu6050", fault=fail_at(200, errno.EREMOTEIO, stays=True))
    driver.open()
    with pytest.raises(DeviceLostError, match="stopped answering"):
        collect(driver, 100_000)
    driver.close()


def test_one_burst_per_sample_reads_all_words_in_one_transaction() -> None:
    seen: list[tuple[Message, ...]] = []

    def watch(number: int, messages: tuple[Message, ...]) -> None:
        seen.append(messages)

    driver = in_process("mpu6050", fault=watch)
    driver._fifo = False
    with driver:
        seen.clear()
        collect(driver, 3)
    bursts = [m for m in seen if m[0].data == b"\x3b"]
    assert [m[1].count for m in bursts] == [14, 14, 14]


@pytest.mark.parametrize(
    ("url", "message"),
    [
        ("i2c://1", "expected BUS/ADDRESS"),
        ("i2c://1/0x68?chip=mpu6051", "not known.*MPU-6050"),
        ("i2c://1/0x6A?chip=mpu6050", "lives at 0x68 or 0x69"),
        ("i2c://1/0x68?chip=mpu6050&rate=5000", "nearest: 1000 Hz"),
        ("i2c://1/0x68?chip=mpu6050&accel_range=3", "2, 4, 8, 16 g"),
        ("i2c://1/0x68?chip=mpu6050&gyro_range=300", "250, 500, 1000, 2000 °/s"),
        ("i2c://1/0x68?chip=mpu6050&filter=7", "188, 98, 42, 20, 10, 5"),
        ("i2c://1/0x68?chip=mpu6050&fifo=yes", "fifo=yes"),
        ("i2c://1/0x68?chip=mpu6050&odr=5", "unknown option 'odr'"),
        ("emulator://mpu6050?rate=nan", "not a number"),
    ],
)
def test_bad_addresses(url: str, message: str) -> None:
    with pytest.raises(AddressError, match=message):
        make_driver(url)


def test_missing_bus_is_named() -> None:
    with pytest.raises(DeviceNotFoundError, match=r"/dev/i2c-99.*i2c-dev"):
        open_driver("i2c://99/0x68?chip=mpu6050")


@given(
    st.lists(st.tuples(st.integers(1, 80), st.integers(0, 500), st.floats(-0.2, 2.0)), min_size=1),
    st.sampled_from([50.0, 1000.0]),
)
def test_times_rise_whatever_the_host_does(
    reads: list[tuple[int, int, float]], rate: float
) -> None:
    times = SampleTimes(rate, 0.0, age=0.5 / rate)
    now, last = 0.0, -np.inf
    for count, lost, late in reads:
        now += max((count + lost) / rate + late, 0.0)
        got = times.take(count, lost, now)
        assert len(got) == count
        assert got[0] > last
        assert (np.diff(got) > 0).all()
        last = got[-1]


def test_a_device_clock_is_unwrapped_and_shows_what_is_missing() -> None:
    times = DeviceTimes(100.0, 1.0)
    index = np.r_[0:95, 98:130, 640:660]  # 3 missing in a batch; 510 in a pause of five turns
    cuts = [0, 40, 95, 127, 147]
    got, lost = [], []
    for begin, end in itertools.pairwise(cuts):
        part = index[begin:end]
        now = part[-1] / 100 + 0.013
        t, n = times.take(np.mod(part / 100 + 0.7, 1.0), now)
        got.append(t)
        lost.append(n)
    assert np.concatenate(got) == pytest.approx(index / 100, abs=1e-9)
    expected = np.zeros(147, int)
    expected[95], expected[127] = 3, 510
    assert np.concatenate(lost).tolist() == expected.tolist()


def test_the_recording_says_which_clock_it_has() -> None:
    for part, clock in (("icm42688p", "device"), ("mpu6050", "host")):
        with open_driver(f"emulator://{part}?rate=200&speed=0") as driver:
            batch = driver.read(1.0)
            assert batch is not None
            assert batch.clock == clock


def test_times_follow_the_device_not_the_jitter_of_reads() -> None:
    rng = np.random.default_rng(5)
    true_rate, nominal = 1012.0, 1000.0
    times = SampleTimes(nominal, 0.0, age=0.0005)
    now, index, out = 0.0, 0, []
    while now < 60:
        now += 0.01 + rng.exponential(0.002)
        count = int(now * true_rate) - index
        index += count
        out.append(times.take(count, 0, now))
    got = np.concatenate(out)
    assert np.diff(got).min() > 0
    late = got[10_000:]
    fit = np.polyfit(np.arange(late.size), late, 1)
    assert 1 / fit[0] == pytest.approx(true_rate, rel=2e-5)
    assert np.std(late - np.polyval(fit, np.arange(late.size))) < 0.3 / true_rate
