"""Flashing chips: what is written, what the output then is, and every way it can fail."""

from __future__ import annotations

import errno
import json
import signal
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from calib.calibration import Calibration, Gravity, Provenance
from calib.errors import (
    CalibrationFileError,
    DriverError,
    FlashError,
    FlashStateError,
    WrongDeviceError,
)
from calib.model import SensorModel
from calib.recording import DeviceInfo
from drivers.chips import chips, get_chip, normal_name
from drivers.emulators.base import EmulatedSensor
from drivers.emulators.chips.base import ChipModel
from drivers.emulators.i2c_bus import Message, fail_at
from drivers.flash import make_target
from drivers.flash.backup import load_backup
from drivers.flash.i2c import I2CTarget
from drivers.flash.procedure import flash_device, make_plan, restore_backup

PARTS = [
    normal_name(part)
    for chip in chips().values()
    if chip.biases
    for part in (*chip.models.values(), *chip.aliases)
]
SEED = 4


def url(part: str, **options: object) -> str:
    rate = min(get_chip(part).rates(), key=lambda r: abs(r - 200))
    more = "".join(f"&{key}={value}" for key, value in options.items())
    return f"emulator://{part}?rate={rate}&seed={SEED}&speed=0{more}"


def model_of(target: I2CTarget) -> ChipModel:
    (model,) = target._driver._connect().models.values()  # type: ignore[attr-defined]
    return model


def truth(target: I2CTarget, **changes: object) -> Calibration:
    """Return a perfect calibration of the emulated sensor, all of it determined."""
    model = model_of(target).source(100.0).model
    bare = SensorModel(model.accel, model.gyro)
    names = [n for n in bare.accel.parameters("accel") if "misalignment.x" not in n]
    names = [n for n in names if n != "accel.misalignment.yz"]
    names += list(bare.gyro.parameters("gyro"))
    names = list(changes.pop("names", names))  # type: ignore[call-overload]
    variance = np.full(len(names), 1e-10)
    device = DeviceInfo(chip=str(changes.pop("chip", "")))
    assert not changes
    return Calibration(
        bare,
        tuple(names),
        np.diag(variance),
        (),
        Gravity(9.80665),
        provenance=Provenance(device=device),
    )


def target_for(part: str, **options: object) -> I2CTarget:
    target = make_target(url(part, **options))
    assert isinstance(target, I2CTarget)
    return target


def flash(target: I2CTarget, calibration: Calibration, folder: Path):  # type: ignore[no-untyped-def]
    return flash_device(
        target,
        calibration,
        backup=folder / "backup.json",
        persist=False,
        duration=3.0,
        report=lambda text: None,
    )


@pytest.fixture
def python_handlers() -> Iterator[None]:
    """What a process starts with, whatever the runner of the tests has set."""
    handlers = {signal.SIGINT: signal.default_int_handler, signal.SIGTERM: signal.SIG_DFL}
    before = {number: signal.signal(number, handler) for number, handler in handlers.items()}
    yield
    for number, old in before.items():
        signal.signal(number, old)


@pytest.mark.parametrize("part", PARTS)
def test_after_flashing_the_bias_is_gone_to_half_a_count(part: str, tmp_path: Path) -> None:
    with target_for(part) as target:
        calibration = truth(target)
        result = flash(target, calibration, tmp_path)
        still = target.measure(10.0)
        sensor = model_of(target).source(100.0)
        fields = {f.parameter: f for f in target._driver.chip.biases[0]}
    rest = sensor.model.accel.matrix @ [0, 0, 9.80665], np.zeros(3)
    clipped = {row.parameter for row in result.plan.rows if row.clipped}
    for triad, expected in zip(("accel", "gyro"), rest, strict=True):
        mean = getattr(still, triad).mean(axis=0)
        sigma = getattr(still, triad).std(axis=0) / np.sqrt(len(still))
        for k, axis in enumerate("xyz"):
            name = f"{triad}.bias.{axis}"
            if name not in fields or name in clipped:
                assert name in result.plan.cannot_hold or name in clipped
                continue
            # half a count of the register, half of the output, and noise
            lsb = target.info.accel_lsb if triad == "accel" else target.info.gyro_lsb
            limit = fields[name].unit / 2 + lsb / 2 + 5 * sigma[k]
            assert abs(mean[k] - expected[k]) < limit, name
        # What is left for `apply` is what the device now shows, so nothing is corrected twice.
        left = getattr(result.left.model, triad)
        corrected = left.correct(mean[None])[0]
        true = np.array([0, 0, 9.80665]) if triad == "accel" else np.zeros(3)
        assert corrected == pytest.approx(true, abs=float(lsb + 5 * sigma.max()))
        original = getattr(calibration.model, triad)
        assert left.scale_factor_error == pytest.approx(original.scale_factor_error, abs=1e-12)
        assert left.misalignment == pytest.approx(original.misalignment, abs=1e-12)
    assert result.left.covariance == pytest.approx(calibration.covariance)


@pytest.mark.parametrize("part", PARTS)
def test_reserved_bits_and_other_registers_are_kept(part: str, tmp_path: Path) -> None:
    with target_for(part) as target:
        model = model_of(target)
        rng = np.random.default_rng(1)
        for register in target.registers.values():
            model.poke(register, int(rng.integers(256)))
        # Not the trim of a real part, so what the output does is not looked at here.
        old, plan = make_plan(target, truth(target))
        target.write(plan.new)
        new = target.read()
        assert new == plan.new
        masks = dict.fromkeys(target.registers, 0)
        for field in (f for biases in target._driver.chip.biases for f in biases):
            for part_field in (*field.fields, *(f for f, _ in field.enable)):
                masks[part_field.register.name] |= part_field.mask
        for name, mask in masks.items():
            assert (int(old[name]) ^ int(new[name])) & ~mask & 0xFF == 0, name


def test_mpu6050_keeps_bit_0_and_the_factory_trim(tmp_path: Path) -> None:
    with target_for("mpu6050") as target:
        before = target.read()
        bias = truth(target).model.accel.bias
        flash(target, truth(target), tmp_path)
        after = target.read()
    for k, axis in enumerate("XYZ"):
        old = int(before[f"{axis}A_OFFS_H"]) << 8 | int(before[f"{axis}A_OFFS_L"])
        new = int(after[f"{axis}A_OFFS_H"]) << 8 | int(after[f"{axis}A_OFFS_L"])
        assert old & 1 == new & 1
        signed = [v - 65536 if v & 0x8000 else v for v in (old, new)]
        # 1/2048 g a count of the 16-bit word, and only even steps
        assert (signed[1] - signed[0]) / 2048 * 9.80665 == pytest.approx(-bias[k], abs=0.0048)


def test_undetermined_parameters_are_left_alone(tmp_path: Path) -> None:
    with target_for("mpu9250") as target:
        names = ["gyro.bias.x", "gyro.bias.z"]
        model = truth(target).model
        calibration = truth(target, names=names)
        gyro = model.gyro.with_parameters({"gyro.bias.y": 0.0})
        calibration = Calibration(
            SensorModel(gyro=gyro), tuple(names), np.eye(2) * 1e-10, (), Gravity(9.80665)
        )
        result = flash(target, calibration, tmp_path)
    changed = {row.parameter for row in result.plan.rows if row.old != row.new}
    assert changed == {"gyro.bias.x", "gyro.bias.z"}


def test_what_does_not_fit_is_clipped_and_left(tmp_path: Path) -> None:
    with target_for("lsm6dso") as target:
        calibration = truth(target)
        accel = calibration.model.accel.with_parameters({"accel.bias.y": 30.0})
        _, plan = make_plan(
            target,
            Calibration(
                SensorModel(accel, calibration.model.gyro),
                calibration.names,
                calibration.covariance,
                (),
                Gravity(9.80665),
            ),
        )
    row = next(r for r in plan.rows if r.parameter == "accel.bias.y")
    assert row.clipped
    assert row.new == 127  # 30 m/s² to subtract, 127 x 1/64 g is the most it holds
    assert plan.accel.shift[1] == pytest.approx(-127 / 64 * 9.80665)
    assert any(name.startswith("gyro.bias") for name in plan.cannot_hold)


def test_a_chip_without_bias_registers_says_what_to_do_instead() -> None:
    target = make_target(url("lsm6ds3"))
    with pytest.raises(DriverError, match=r"no bias registers.*imu-cal apply"):
        target.open()


def test_another_device_is_refused(tmp_path: Path) -> None:
    with target_for("mpu6050") as target:
        with pytest.raises(WrongDeviceError, match="of chip MPU-9250, this device is MPU-6050"):
            flash(target, truth(target, chip="MPU-9250"), tmp_path)
        flash(target, truth(target, chip="mpu6050"), tmp_path)


def test_flashing_twice_is_refused(tmp_path: Path) -> None:
    with target_for("mpu6050") as target:
        calibration = truth(target)
        flash(target, calibration, tmp_path)
        held = target.read()
        with pytest.raises(FlashError, match=r"flashed already.*Nothing\s+was written"):
            flash(target, calibration, tmp_path / "again")
        assert target.read() == held


def test_a_small_bias_is_not_corrected_twice_either(tmp_path: Path) -> None:
    with target_for("mpu6050") as target:
        names = ["gyro.bias.x"]
        bias = 0.004  # rad/s, 0.23 °/s
        source = model_of(target).source
        model_of(target).source = lambda rate: _small(source(rate), bias)
        model_of(target)._sensor = None
        gyro = model_of(target).source(200.0).model.gyro
        calibration = Calibration(
            SensorModel(gyro=gyro), tuple(names), np.eye(1) * 1e-10, (), Gravity(9.80665)
        )
        flash(target, calibration, tmp_path)
        (tmp_path / "backup.json").unlink()
        with pytest.raises(FlashError, match="flashed already"):
            flash(target, calibration, tmp_path)


def _small(sensor: EmulatedSensor, bias: float) -> EmulatedSensor:
    gyro = sensor.model.gyro
    gyro = type(gyro)(np.array([bias, 0, 0]), gyro.scale_factor_error, gyro.misalignment)
    sensor.model = SensorModel(sensor.model.accel, gyro)
    return sensor


def test_a_moving_device_is_refused(tmp_path: Path) -> None:
    with target_for("mpu6050", motion="bench") as target:
        state = model_of(target).source(200.0).state
        turning = float(np.argmax(np.linalg.norm(state.rate, axis=1) > 0.5)) / 200.0
        target._driver._clock.sleep(turning - model_of(target).now() - 1.0)
        with pytest.raises(FlashError, match=r"moved while it was measured.*Nothing was written"):
            flash(target, truth(target), tmp_path)
    assert not (tmp_path / "backup.json").exists()


def test_a_device_that_is_moved_afterwards_is_put_back(tmp_path: Path) -> None:
    with target_for("mpu6050", motion="bench") as target:
        state = model_of(target).source(200.0).state
        turning = float(np.argmax(np.linalg.norm(state.rate, axis=1) > 0.5)) / 200.0
        target._driver._clock.sleep(turning - model_of(target).now() - 4.0)
        old = target.read()
        with pytest.raises(FlashError, match=r"moved while it was measured.*values are back"):
            flash(target, truth(target), tmp_path)
        assert target.read() == old


# ---- faults ----


def writes(messages: tuple[Message, ...], first: int, last: int) -> bool:
    data = messages[0].data
    return len(messages) == 1 and len(data) > 1 and first <= data[0] <= last


@pytest.mark.parametrize("kth", range(1, 13))
def test_an_error_at_any_write_puts_everything_back(kth: int, tmp_path: Path) -> None:
    with target_for("mpu6050") as target:
        old = target.read()
        count = 0

        def fault(n: int, messages: tuple[Message, ...]) -> int | None:
            nonlocal count
            count += writes(messages, 0x06, 0x18)
            return errno.EIO if count == kth and writes(messages, 0x06, 0x18) else None

        target._driver._connect().fault = fault  # type: ignore[attr-defined]
        with pytest.raises(FlashError, match="The old values are back, and were read back") as e:
            flash(target, truth(target), tmp_path)
        assert e.value.exit_code == 8
        assert target.read() == old
    assert load_backup(tmp_path / "backup.json").values == old


@pytest.mark.parametrize("n", [1, 7, 40, 100])
def test_eio_at_any_transaction_loses_nothing(n: int, tmp_path: Path) -> None:
    with target_for("mpu6050") as target:
        old = target.read()
        bus = target._driver._connect()
        bus.transactions = 0  # type: ignore[attr-defined]
        bus.fault = fail_at(n, errno.EIO)  # type: ignore[attr-defined]
        with pytest.raises(DriverError):
            flash(target, truth(target), tmp_path)
        assert target.read() == old


def test_a_disconnect_in_the_middle_of_a_write_says_what_is_known(tmp_path: Path) -> None:
    target = target_for("mpu6050")
    target.open()
    old = target.read()
    gone = False

    def fault(n: int, messages: tuple[Message, ...]) -> int | None:
        nonlocal gone
        gone |= writes(messages, 0x0A, 0x0A)
        return errno.EREMOTEIO if gone else None

    bus = target._driver._connect()
    bus.fault = fault  # type: ignore[attr-defined]
    with pytest.raises(FlashStateError, match="could not be put back") as error:
        flash(target, truth(target), tmp_path)
    assert error.value.exit_code == 9
    for part in ("does not answer", "power-on values", "backup.json", "flash --restore"):
        assert part in str(error.value)
    target.close()
    # It comes back without having lost power: half written.
    bus.fault = None  # type: ignore[attr-defined]
    with target:
        assert target.read() != old
        restore_backup(target, tmp_path / "backup.json", persist=False, report=lambda t: None)
        assert target.read() == old


def test_a_device_that_comes_back_after_power_loss_is_restored(tmp_path: Path) -> None:
    with target_for("mpu6050") as target:
        old = target.read()
        model = model_of(target)
        state = "on"

        def fault(n: int, messages: tuple[Message, ...]) -> int | None:
            nonlocal state
            if state == "on" and writes(messages, 0x15, 0x15):
                state = "off"
                model.power_cycle()
                return errno.EREMOTEIO
            if state == "off":  # the first try to restore still finds nobody
                state = "back"
                return errno.EREMOTEIO
            return None

        target._driver._connect().fault = fault  # type: ignore[attr-defined]
        with pytest.raises(FlashError, match="The old values are back"):
            flash(target, truth(target), tmp_path)
        assert target.read() == old


def test_a_device_that_acknowledges_but_does_not_store(tmp_path: Path) -> None:
    with target_for("mpu6050") as target:
        old = target.read()
        model = model_of(target)
        store = model.on_write

        def forget(address: int, value: int) -> int:
            return (
                model.peek(target.registers["YG_OFFSET_L"])
                if address == 0x16
                else store(address, value)
            )

        model.on_write = forget  # type: ignore[method-assign]
        with pytest.raises(FlashError, match=r"acknowledged.*YG_OFFSET_L is 0"):
            flash(target, truth(target), tmp_path)
        assert target.read() == old


def test_one_retry_is_made(tmp_path: Path) -> None:
    with target_for("mpu6050") as target:
        model = model_of(target)
        store, refused = model.on_write, []

        def once(address: int, value: int) -> int:
            if address == 0x16 and not refused:
                refused.append(value)
                return 0x55
            return store(address, value)

        model.on_write = once  # type: ignore[method-assign]
        flash(target, truth(target), tmp_path)
        assert refused


@pytest.mark.parametrize("factor", [-1.0, 0.0, 0.5, 2.0])
def test_a_wrong_sign_or_weight_is_found_by_measuring(factor: float, tmp_path: Path) -> None:
    with target_for("mpu6050") as target:
        old = target.read()
        model = model_of(target)
        shift = model.bias_shift
        model.bias_shift = lambda: factor * shift()  # type: ignore[method-assign]
        with pytest.raises(FlashError, match=r"at rest .* it should have moved by"):
            flash(target, truth(target), tmp_path)
        assert target.read() == old


def test_the_backup_is_on_disk_before_anything_is_written(tmp_path: Path) -> None:
    with target_for("mpu6050") as target:
        (tmp_path / "backup.json").write_text("older")
        old = target.read()
        with pytest.raises(CalibrationFileError, match="never written over"):
            flash(target, truth(target), tmp_path)
        assert target.read() == old


def test_ctrl_c_puts_everything_back(tmp_path: Path) -> None:
    with target_for("mpu6050") as target:
        old = target.read()
        done = False

        def fault(n: int, messages: tuple[Message, ...]) -> int | None:
            nonlocal done
            if writes(messages, 0x14, 0x14) and not done:
                done = True
                raise KeyboardInterrupt
            return None

        target._driver._connect().fault = fault  # type: ignore[attr-defined]
        with pytest.raises(FlashError, match=r"interrupted.*old values are back"):
            flash(target, truth(target), tmp_path)
        assert target.read() == old


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
@pytest.mark.parametrize("failed", [True, False], ids=["failed", "interrupted"])
@pytest.mark.usefixtures("python_handlers")
def test_no_signal_interrupts_putting_back(number: int, failed: bool, tmp_path: Path) -> None:
    """Neither a second Ctrl-C, nor a first one after another failure."""
    with target_for("mpu6050") as target:
        old = target.read()
        begun = False

        def fault(n: int, messages: tuple[Message, ...]) -> int | None:
            nonlocal begun
            if not (begun or writes(messages, 0x14, 0x14)):
                return None
            first, begun = not begun, True
            if first and failed:
                return errno.EIO
            signal.raise_signal(number)
            return None

        target._driver._connect().fault = fault  # type: ignore[attr-defined]
        with pytest.raises(FlashError, match="old values are back"):
            flash(target, truth(target), tmp_path)
        target._driver._connect().fault = None  # type: ignore[attr-defined]
        assert target.read() == old
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler


@pytest.mark.usefixtures("python_handlers")
def test_no_signal_interrupts_a_restore(tmp_path: Path) -> None:
    with target_for("mpu6050") as target:
        old = target.read()
        flash(target, truth(target), tmp_path)

        def fault(n: int, messages: tuple[Message, ...]) -> None:
            signal.raise_signal(signal.SIGINT)

        target._driver._connect().fault = fault  # type: ignore[attr-defined]
        restore_backup(target, tmp_path / "backup.json", persist=False, report=lambda t: None)
        target._driver._connect().fault = None  # type: ignore[attr-defined]
        assert target.read() == old


# ---- backups ----


def test_a_backup_of_another_chip_is_refused(tmp_path: Path) -> None:
    with target_for("mpu6050") as target:
        flash(target, truth(target), tmp_path)
    with target_for("mpu9250") as other, pytest.raises(WrongDeviceError, match="is of MPU-6050"):
        restore_backup(other, tmp_path / "backup.json", persist=False, report=lambda t: None)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"format": "other"}, "no backup"),
        ({"version": 2}, "version 2"),
        ({"values": {}}, "damaged"),
        ({"values": {"XA_OFFS_H": True}}, "damaged"),
        ({"chip": 3}, "whose values"),
    ],
)
def test_damaged_backups(change: dict[str, object], message: str, tmp_path: Path) -> None:
    with target_for("mpu6050") as target:
        flash(target, truth(target), tmp_path)
    path = tmp_path / "backup.json"
    path.write_text(json.dumps(json.loads(path.read_text()) | change))
    with pytest.raises(CalibrationFileError, match=message):
        load_backup(path)


@pytest.mark.parametrize("text", ["", "{", "[]", "\x00"])
def test_no_backup_at_all(text: str, tmp_path: Path) -> None:
    path = tmp_path / "b.json"
    path.write_text(text)
    with pytest.raises(CalibrationFileError):
        load_backup(path)
    with pytest.raises(CalibrationFileError, match="cannot read"):
        load_backup(tmp_path / "missing.json")


@pytest.mark.parametrize("part", ["mpu6050", "icm42688p", "icm20948", "bmi270", "lsm6dsox"])
def test_the_start_up_snippet_does_what_flash_did(part: str, tmp_path: Path) -> None:
    with target_for(part) as target:
        result = flash(target, truth(target), tmp_path)
        held = target.read()
        model = model_of(target)

        class Bus:
            def __enter__(self):
                return self

            def __exit__(self, *args: object) -> None:
                pass

            def write_byte_data(self, address: int, register: int, value: int) -> None:
                model.write(bytes([register, value]))

        model.power_cycle()
        code = result.snippet.replace("import smbus2", "").replace("smbus2.SMBus(1)", "Bus()")
        exec(code, {"Bus": Bus})
        assert target.read() == held
