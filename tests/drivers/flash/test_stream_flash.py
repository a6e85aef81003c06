"""Flashing serial devices: registers and parameters, storing, and every way it can fail."""

from __future__ import annotations

import re
import struct
from pathlib import Path

import numpy as np
import pytest

from calib.calibration import Calibration, Gravity
from calib.errors import (
    AddressError,
    DeviceLostError,
    DriverError,
    FlashError,
    FlashStateError,
    RecordingFormatError,
)
from calib.model import SensorModel
from drivers.emulators.base import EmulatedSensor, EmulatorOptions, make_sensor
from drivers.emulators.serial_device import EmulatedSource, SerialDevice
from drivers.flash import make_target, mavlink, stream, vectornav, witmotion
from drivers.flash.backup import load_backup
from drivers.flash.procedure import Result, flash_device, restore_backup
from drivers.flash.stream import StreamTarget
from drivers.flash.text import TextTarget, load_template
from drivers.stream import StreamDriver

DEVICES = ["witmotion", "vectornav", "vectornav-ascii", "ardupilot", "px4"]


@pytest.fixture(autouse=True)
def quick(monkeypatch: pytest.MonkeyPatch) -> None:
    """An emulated device needs no time to store or restart."""
    for module in (witmotion, vectornav, mavlink):
        for name in ("PAUSE", "STORE", "RESTARTING"):
            if hasattr(module, name) and not (module is vectornav and name == "STORE"):
                monkeypatch.setattr(module, name, 0.0)
    monkeypatch.setattr(stream, "RETURN", 0.0)
    monkeypatch.setattr(mavlink, "ANSWER", 0.1)


def names_of(model: SensorModel) -> tuple[str, ...]:
    accel = [n for n in model.accel.parameters("accel") if not re.search(r"\.(x[yz]|yz)$", n)]
    return (*accel, *model.gyro.parameters("gyro"))


def truth(target: StreamTarget) -> Calibration:
    model = device_of(target).sensor.model
    bare = SensorModel(model.accel, model.gyro)
    names = names_of(bare)
    return Calibration(bare, names, np.eye(len(names)) * 1e-10, (), Gravity(9.80665))


def device_of(target: StreamTarget) -> SerialDevice:
    source = target._driver.source
    assert isinstance(source, EmulatedSource)
    return source.device


def target_for(name: str, seed: int = 2) -> StreamTarget:
    target = make_target(f"emulator://{name}?seed={seed}&speed=0")
    assert isinstance(target, StreamTarget)
    return target


def flash(
    target: StreamTarget, calibration: Calibration, folder: Path, *, persist: bool = True
) -> Result:
    return flash_device(
        target,
        calibration,
        backup=folder / "backup.json",
        persist=persist,
        duration=2.0,
        report=lambda text: None,
    )


@pytest.mark.parametrize("name", DEVICES)
def test_after_flashing_what_is_left_is_what_the_device_shows(name: str, tmp_path: Path) -> None:
    with target_for(name) as target:
        calibration = truth(target)
        result = flash(target, calibration, tmp_path)
        still = target.measure(10.0)
        left = result.left.model
        lsb = target.info.accel_lsb or 0.0, target.info.gyro_lsb or 0.0
    if name in ("ardupilot",):
        lsb = 9.80665e-3, 1e-3
    for k, triad in enumerate(("accel", "gyro")):
        values = getattr(still, triad)
        sigma = values.std(axis=0).max() / np.sqrt(len(values))
        true = np.array([[0, 0, 9.80665 if triad == "accel" else 0.0]])
        expected = getattr(left, triad).distort(true)[0]
        assert values.mean(axis=0) == pytest.approx(expected, abs=5 * sigma + lsb[k] / 2)
    clipped = any(row.clipped for row in result.plan.rows)
    limits = {"witmotion": (5e-4, 1e-6)}.get(name, (1e-5, 1e-5))
    assert clipped or np.abs(left.accel.bias).max() < limits[0]
    assert clipped or np.abs(left.gyro.bias).max() < limits[1]
    if name.startswith("vectornav"):
        assert left.accel.matrix == pytest.approx(np.eye(3), abs=3e-6)
        assert left.gyro.matrix == pytest.approx(np.eye(3), abs=3e-6)
        assert not result.plan.cannot_hold
    elif name in ("ardupilot", "px4"):
        assert left.accel.scale_factor_error == pytest.approx(0, abs=1e-6)
        assert left.gyro.matrix == pytest.approx(calibration.model.gyro.matrix)
        scaled = np.diag(1 / (1 + calibration.model.accel.scale_factor_error))
        assert left.accel.matrix == pytest.approx(scaled @ calibration.model.accel.matrix)
    else:
        assert left.accel.matrix == pytest.approx(calibration.model.accel.matrix)


@pytest.mark.parametrize("name", ["witmotion", "vectornav"])
def test_without_persist_a_restart_forgets_and_with_it_remembers(name: str, tmp_path: Path) -> None:
    with target_for(name) as target:
        before = target.read()
        result = flash(target, truth(target), tmp_path, persist=False)
        assert result.snippet.startswith("# Send")
        assert target.read() == result.plan.new
        device_of(target).power_cycle()
        assert target.read() == before
        (tmp_path / "backup.json").unlink()
        stored = flash(target, truth(target), tmp_path, persist=True)
        assert not stored.snippet
        device_of(target).power_cycle()
        assert target.read() == stored.plan.new


@pytest.mark.parametrize("name", DEVICES)
def test_restoring_a_backup(name: str, tmp_path: Path) -> None:
    with target_for(name) as target:
        before = target.read()
        flash(target, truth(target), tmp_path)
        assert target.read() != before
        restore_backup(target, tmp_path / "backup.json", persist=True, report=lambda text: None)
        device_of(target).power_cycle()
        assert target.read() == before
    assert load_backup(tmp_path / "backup.json").values == before


@pytest.mark.parametrize("name", ["ardupilot", "px4"])
def test_parameters_that_are_stored_at_once_need_persist(name: str, tmp_path: Path) -> None:
    with target_for(name) as target:
        old = target.read()
        with pytest.raises(FlashError, match=r"add --persist.*Nothing was written"):
            flash(target, truth(target), tmp_path, persist=False)
        assert target.read() == old


def test_a_second_correction_builds_on_the_first(tmp_path: Path) -> None:
    """A device that already holds C0 and B0 gets their composition, not a replacement."""
    with target_for("vectornav") as target:
        rng = np.random.default_rng(3)
        held = target.read()
        for k, key in enumerate(held):
            held[key] = round(held[key] + 0.02 * rng.normal() * (1 if k < 21 else 0.1), 6)
        target.write(held)
        # The calibration is of the output as it is now: out = C0 (M t + b - B0).
        model = device_of(target).sensor.model
        triads = {}
        for triad, register in vectornav.REGISTERS.items():
            matrix, bias = vectornav._split([held[n] for n in vectornav._names(register)])
            old = getattr(model, triad)
            triads[triad] = type(old).from_matrix(matrix @ old.matrix, matrix @ (old.bias - bias))
        bare = SensorModel(**triads)
        names = (*bare.accel.parameters("accel"), *bare.gyro.parameters("gyro"))
        calibration = Calibration(bare, names, np.eye(24) * 1e-10, (), Gravity(9.80665))
        flash(target, calibration, tmp_path)
        still = target.measure(10.0)
    sigma = still.accel.std() / np.sqrt(len(still))
    assert still.accel.mean(axis=0) == pytest.approx([0, 0, 9.80665], abs=5 * sigma)
    assert still.gyro.mean(axis=0) == pytest.approx(np.zeros(3), abs=5 * still.gyro.std() / 30)


# ---- faults ----


@pytest.mark.parametrize(
    ("name", "kth"), [("witmotion", 3), ("vectornav", 1), ("vectornav", 2), ("px4", 4)]
)
def test_a_disconnect_in_the_middle_of_a_write(name: str, kth: int, tmp_path: Path) -> None:
    target = target_for(name)
    target.open()
    before = target.read()
    source = target._driver.source
    send, opened = source.write, source.open
    count = 0

    def write(data: bytes) -> None:
        nonlocal count
        count += is_write(data)
        if count >= kth:
            raise DeviceLostError("the port went away while writing")
        send(data)

    def reopen() -> None:
        raise DeviceLostError("no such port")

    source.write, source.open = write, reopen  # type: ignore[method-assign]
    with pytest.raises(FlashStateError, match="could not be put back") as error:
        flash(target, truth(target), tmp_path)
    assert "does not answer" in str(error.value)
    assert "flash --restore" in str(error.value)
    source.write, source.open = send, opened  # type: ignore[method-assign]
    with target:
        assert (target.read() == before) == (kth == 1)
        restore_backup(target, tmp_path / "backup.json", persist=True, report=lambda text: None)
        assert target.read() == before


def is_write(data: bytes) -> bool:
    """Whether a command changes something: WitMotion, VectorNav, MAVLink PARAM_SET (23)."""
    wit = data[:2] == b"\xff\xaa" and 0x05 <= data[2] <= 0x0A
    return wit or b"VNWRG" in data or (data[:1] == b"\xfd" and data[7] == 23)


def test_a_locked_witmotion_acknowledges_nothing_and_is_found_out(tmp_path: Path) -> None:
    with target_for("witmotion") as target:
        device = device_of(target)
        receive = device.receive

        def locked(data: bytes) -> bytes:
            device.unlocked = False  # type: ignore[attr-defined]
            return receive(data)

        device.receive = locked  # type: ignore[method-assign]
        with pytest.raises(FlashError, match="acknowledged the values but does not hold them"):
            flash(target, truth(target), tmp_path)


def test_an_echo_with_the_right_name_and_another_value_is_refused(tmp_path: Path) -> None:
    """What a library's setter takes for success."""
    with target_for("ardupilot") as target:
        before = target.read()
        device = device_of(target)
        setter = device._set  # type: ignore[attr-defined]

        def bounded(name: str, raw: bytes, kind: int) -> bytes:
            (value,) = struct.unpack("<f", raw)
            if name == "INS_ACCSCAL_Y" and value != 1.0:
                raw = struct.pack("<f", 1.25)
            return bytes(setter(name, raw, kind))

        device._set = bounded  # type: ignore[attr-defined]
        with pytest.raises(FlashError, match=r"INS_ACCSCAL_Y = .* was not accepted.*are back"):
            flash(target, truth(target), tmp_path)
        assert target.read() == before


def test_a_rotated_autopilot_is_refused() -> None:
    target = target_for("px4")
    device_of(target).parameters["SENS_BOARD_ROT"] = (struct.pack("<i", 8), 6)  # type: ignore[attr-defined]
    with pytest.raises(DriverError, match="SENS_BOARD_ROT is set"):
        target.open()
    assert not target._driver.is_open


def test_persist_that_does_not_hold_is_found_after_the_restart(tmp_path: Path) -> None:
    with target_for("vectornav") as target:
        device = device_of(target)
        before = target.read()
        answer = device._answer  # type: ignore[attr-defined]
        device._answer = lambda line: (  # type: ignore[attr-defined]
            b"$VNWNV*57\r\n" if b"VNWNV" in line else answer(line)
        )
        with pytest.raises(FlashError, match=r"after a restart the device holds other values"):
            flash(target, truth(target), tmp_path)
        assert target.read() == before


# ---- text ----

TEMPLATE = """
[units]
accel = "mg"
gyro = "deg/s"
sign = -1
decimals = 3
[read]
command = "get"
reply = "# bias {ax} {ay} {az} {gx} {gy} {gz}"
[write]
command = "set {ax} {ay} {az} {gx} {gy} {gz}"
reply = "# ok"
[persist]
command = "save"
reply = "# saved"
"""


class Sketch(SerialDevice):
    """Prints lines; obeys get, set and save."""

    def __init__(self, sensor: EmulatedSensor) -> None:
        super().__init__(sensor)
        self.saved = np.zeros(6)
        self.power_cycle()

    def power_cycle(self) -> None:
        self.bias = self.saved.copy()
        self.buffer = b""

    def stream(self, start: int, stop: int) -> bytes:
        signals, _ = self.sensor.measure(start, stop)
        unit = np.repeat([9.80665e-3, np.pi / 180], 3)
        rows = np.hstack(signals) - self.bias * unit
        lines = (
            b"%d,%.4f,%.4f,%.4f,%.5f,%.5f,%.5f\n" % (k * 5000, *row)
            for k, row in enumerate(rows.tolist(), start)
        )
        return b"".join(lines)

    def receive(self, data: bytes) -> bytes:
        self.buffer += data
        *lines, self.buffer = self.buffer.split(b"\n")
        out = b""
        for line in lines:
            verb, *words = line.split()
            if verb == b"get":
                out += b"# bias " + b" ".join(b"%.3f" % v for v in self.bias) + b"\n"
            elif verb == b"set":
                self.bias = np.array([float(w) for w in words])
                out += b"# ok\n"
            elif verb == b"save":
                self.saved = self.bias.copy()
                out += b"# saved\n"
        return out


def text_target(template: Path) -> TextTarget:
    from drivers.dialects import dialects

    sensor = make_sensor(EmulatorOptions(seed=3), default_rate=200.0)
    options = {
        "columns": "t,ax,ay,az,gx,gy,gz",
        "time_unit": "us",
        "accel_unit": "m/s^2",
        "gyro_unit": "rad/s",
    }
    source = EmulatedSource(lambda: Sketch(sensor), 0.0)
    driver = StreamDriver("emulator://sketch", source, dialects()["text"], options)
    return TextTarget(driver, load_template(template))


def test_a_text_device_is_commanded_by_its_template(tmp_path: Path) -> None:
    template = tmp_path / "t.toml"
    template.write_text(TEMPLATE)
    with text_target(template) as target:
        before = target.read()
        result = flash(target, truth(target), tmp_path)
        device_of(target).power_cycle()
        assert target.read() == result.plan.new
        still = target.measure(5.0)
        left = result.left.model
        expected = left.accel.distort(np.array([[0, 0, 9.80665]]))[0]
        assert still.accel.mean(axis=0) == pytest.approx(expected, abs=5e-3)
        assert np.abs(left.accel.bias).max() <= 0.0005 * 9.80665e-3 * 1.01
        restore_backup(target, tmp_path / "backup.json", persist=True, report=lambda text: None)
        assert target.read() == before
    with pytest.raises(AddressError, match="add --template"):
        make_target("emulator://arduino")


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (("sign = -1", "sign = 2"), "sign must be"),
        (('accel = "mg"', 'accel = "furlong"'), "accel must be one of"),
        (("decimals = 3", "decimals = 3.5"), "decimals"),
        (("[write]", "[wrote]"), r"\[write\] needs a command"),
        (('{gz}"\nreply', '"\nreply'), "must hold the same"),
        (("[units]", "[units"), "cannot read the template"),
    ],
)
def test_bad_templates(change: tuple[str, str], message: str, tmp_path: Path) -> None:
    path = tmp_path / "t.toml"
    path.write_text(TEMPLATE.replace(*change, 1))
    with pytest.raises(RecordingFormatError, match=message):
        load_template(path)


def test_what_cannot_be_flashed() -> None:
    with pytest.raises(AddressError, match="add dialect="):
        make_target("serial:///dev/ttyUSB0")
