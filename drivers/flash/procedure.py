"""How a device is flashed: prepare, back up, write, read back, measure, or put everything back.

Nothing is written before the backup is on disk. Whatever goes wrong after that, the old values are
written back and read back, which nothing interrupts; only if that fails too is the device left as
it is, and then the error says what it holds.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from pathlib import Path

import numpy as np

from calib.calibration import Calibration
from calib.errors import DriverError, FlashError, FlashStateError, WrongDeviceError
from calib.model import Triad
from calib.recording import DeviceInfo, Recording
from calib.types import FloatArray
from drivers.chips import normal_name
from drivers.flash.backup import Backup, load_backup, save_backup
from drivers.flash.interrupts import Interrupts
from drivers.flash.target import Action, Native, Plan, Target

BLOCKS = 10
"""Parts of a measurement whose means are compared, to see whether the device lay still."""
STILL_ACCEL, STILL_GYRO = 0.05, np.deg2rad(0.5)
"""m/s² and rad/s that block means may wander beyond their noise before it counts as motion."""
ACCEL_SLACK, ACCEL_FAR = 0.03, 0.25
"""m/s² that a calibrated accelerometer's size may be off after a power cycle and warm-up."""
SIGMAS = 5.0
"""Standard errors of a difference that are still chance, over six channels and many flashes."""
DRIFT = 0.1
"""Part of a shift that temperature may take away between two measurements a few seconds apart."""

Report = Callable[[str], None]


@dataclass(frozen=True, eq=False)
class Check:
    """One channel at rest, before and after: what changed, and what should have."""

    channel: str
    before: float
    after: float
    expected: float
    tolerance: float

    @property
    def good(self) -> bool:
        """Whether the output moved as it should, in size and sign."""
        return abs(self.after - self.expected) <= self.tolerance

    @property
    def visible(self) -> bool:
        """Whether the wanted change is large enough to be seen at all."""
        return abs(self.expected - self.before) > self.tolerance


@dataclass(frozen=True, eq=False)
class Result:
    """What was done, and what is left for ``apply``."""

    plan: Plan
    backup: Path
    checks: tuple[Check, ...]
    left: Calibration
    persisted: bool
    snippet: str


def check_identity(calibration: Calibration, info: DeviceInfo) -> None:
    """Refuse a device that is not the one that was calibrated.

    Raises
    ------
    WrongDeviceError
        If both say who they are, and differ.
    """
    known = calibration.provenance.device
    for what, ours, theirs in (
        ("chip", known.chip, info.chip),
        ("serial number", known.serial_number, info.serial_number),
    ):
        if ours and theirs and normal_name(ours) != normal_name(theirs):
            raise WrongDeviceError(
                f"the calibration is of {what} {ours}, this device is {theirs}: calibrate this "
                "one, or connect the other"
            )


def make_plan(target: Target, calibration: Calibration) -> tuple[Native, Plan]:
    """Read an open target and plan what to write; nothing is written."""
    check_identity(calibration, target.info)
    old = target.read()
    return old, target.plan(old, calibration)


def flash_device(
    target: Target,
    calibration: Calibration,
    *,
    backup: Path,
    persist: bool,
    duration: float,
    report: Report,
) -> Result:
    """Write a calibration into an open device.

    Parameters
    ----------
    backup : Path
        Where the old values go; it must not exist.
    persist : bool
        Also store them in non-volatile memory, restart, and read them back again.
    duration : float, s
        Of each measurement of the still device.
    report : callable
        Is told what is being done.

    Raises
    ------
    WrongDeviceError
        If it is another device; nothing was written.
    FlashError
        If anything failed, or was interrupted; the old values are back.
    FlashStateError
        If the old values could not be put back; the message says what is where.
    """
    if persist and not target.can_persist:
        raise ValueError(f"`persist`: {target.name} of this device are volatile by nature")
    if target.always_stored and not persist:
        raise FlashError(
            f"{target.name} of this device are stored in its memory as soon as they are set: add "
            "--persist to say that you want that. Nothing was written"
        )
    old, plan = make_plan(target, calibration)
    report("measuring the still device")
    before = target.measure(duration)
    _check_still(before, then="Nothing was written; lay it down, and flash again")
    _check_applies(calibration, plan, before)
    save_backup(_backup(target, old), backup)
    report(f"the old values are saved in {backup}")
    stored = target.always_stored
    with Interrupts() as interrupts:
        try:
            try:
                _write(target, plan.new, report)
                report("measuring the still device again")
                after = target.measure(duration)
                _check_still(after, then="Lay it down, and flash again")
                checks = _compare(before, after, plan)
                _judge(checks)
                if persist:
                    report(f"storing in non-volatile memory and restarting{target.persist_note}")
                    stored = True
                    _persist(target, plan.new)
            finally:
                interrupts.hold()  # within the outer `try`: one that comes now is still seen there
        except DriverError as error:
            _put_back(target, old, backup, error, persist=stored, report=report)
        except KeyboardInterrupt as interrupt:
            stop = FlashError("interrupted")
            _put_back(target, old, backup, stop, persist=stored, report=report, cause=interrupt)
    left = left_for_apply(calibration, plan, persisted=persist or not target.volatile)
    snippet = "" if persist else target.snippet(plan.new)
    return Result(plan, backup, checks, left, persist, snippet)


def restore_backup(target: Target, path: Path, *, persist: bool, report: Report) -> Native:
    """Write a backup's values into an open device and read them back.

    Raises
    ------
    CalibrationFileError
        If the backup cannot be used.
    WrongDeviceError
        If it is of another device; nothing was written.
    FlashStateError
        If they could not be written or read back.
    """
    backup = load_backup(path)
    if normal_name(backup.chip) != normal_name(target.info.chip):
        raise WrongDeviceError(f"{path} is of {backup.chip}, this device is {target.info.chip}")
    if backup.serial_number and target.info.serial_number not in ("", backup.serial_number):
        raise WrongDeviceError(
            f"{path} is of number {backup.serial_number}, this is {target.info.serial_number}"
        )
    if backup.target != target.name:
        raise WrongDeviceError(f"{path} holds {backup.target}, this device has {target.name}")
    try:
        with Interrupts(held=True):
            _write(target, backup.values, report)
            if persist:
                _persist(target, backup.values)
    except DriverError as error:
        raise FlashStateError(
            f"the backup could not be restored: {error}. {_state(target, backup.values)}"
        ) from error
    return backup.values


def left_for_apply(calibration: Calibration, plan: Plan, *, persisted: bool) -> Calibration:
    """Return the calibration of the flashed device, so that nothing is corrected twice."""
    model = replace(
        calibration.model,
        accel=_after(calibration.model.accel, plan.accel),
        gyro=_after(calibration.model.gyro, plan.gyro),
    )
    jacobian = _jacobian(calibration.names, plan)
    poses = calibration.poses
    if poses is not None:
        poses = replace(poses, accel=plan.accel(poses.accel), gyro=plan.gyro(poses.gyro))
    note = "bias and scale are corrected in the device"
    if not persisted:
        note += ", as long as it stays powered or runs its start-up snippet"
    provenance = calibration.provenance
    return replace(
        calibration,
        model=model,
        covariance=jacobian @ calibration.covariance @ jacobian.T,
        poses=poses,
        provenance=replace(provenance, notes=dict(provenance.notes) | {"flashed": note}),
    )


def _after(triad: Triad, action: Action) -> Triad:
    """M' = A (I + S + M) t + A b + d."""
    return Triad.from_matrix(action.matrix @ triad.matrix, action(triad.bias[None])[0])


def _jacobian(names: tuple[str, ...], plan: Plan) -> FloatArray:
    """Derivative of the parameters left by those before; the map is affine, so it is exact."""
    jacobian = np.eye(len(names))
    for triad, action in (("accel", plan.accel), ("gyro", plan.gyro)):
        zero = _after(Triad(), action).parameters(triad)
        for column, name in enumerate(names):
            if name.startswith(f"{triad}."):
                unit = _after(Triad().with_parameters({name: 1.0}), action).parameters(triad)
                for row, other in enumerate(names):
                    if other.startswith(f"{triad}."):
                        jacobian[row, column] = unit[other] - zero[other]
    return jacobian


# ---- steps ----


def _backup(target: Target, values: Native) -> Backup:
    now = datetime.now(UTC).isoformat(timespec="seconds")
    info = target.info
    return Backup(target.address, info.chip, info.serial_number, target.name, now, dict(values))


def _write(target: Target, values: Native, report: Report) -> None:
    """Write, read back and compare exactly; once more if they differ."""
    for attempt in (1, 2):
        target.write(values)
        wrong = _differences(target.read(), values)
        if not wrong:
            return
        if attempt == 1:
            report(f"read back other values ({wrong[0]}); writing once more")
    raise FlashError(
        "the device acknowledged the values but does not hold them: " + "; ".join(wrong)
    )


def _differences(got: Native, expected: Native) -> list[str]:
    return [
        f"{name} is {got.get(name, float('nan')):g}, written was {value:g}"
        for name, value in expected.items()
        if got.get(name) != value
    ]


def _persist(target: Target, values: Native) -> None:
    target.persist()
    target.restart()
    wrong = _differences(target.read(), values)
    if wrong:
        raise FlashError("after a restart the device holds other values: " + "; ".join(wrong))


def _put_back(
    target: Target,
    old: Native,
    backup: Path,
    error: DriverError,
    *,
    persist: bool,
    report: Report,
    cause: BaseException | None = None,
) -> None:
    """Restore the old values and raise what went wrong."""
    report(f"failed: {error}; putting the old values back, without interruption")
    retry = f"`imu-cal flash --restore {backup} '{target.address}'`"
    try:
        try:
            _write(target, old, report)
        except DriverError:
            target.close()  # it may have gone and come back
            target.open()
            _write(target, old, report)
        if persist:
            _persist(target, old)
    except DriverError as second:
        raise FlashStateError(
            f"{error}. The old values could not be put back: {second}. {_state(target, old)} "
            f"They are safe in {backup}: when the device answers again, run {retry}"
        ) from (cause or error)
    raise FlashError(f"{error}. The old values are back, and were read back") from (cause or error)


def _state(target: Target, old: Native) -> str:
    """Say what the device holds, as far as it answers."""
    try:
        wrong = _differences(target.read(), old)
    except (DriverError, ValueError):
        lost = "it has its power-on values again once it was without power"
        return "The device does not answer, so what it holds is not known" + (
            f" ({lost})." if target.volatile else "."
        )
    if not wrong:
        return "It holds the old values now."
    return "It now holds other values than before: " + "; ".join(wrong) + "."


# ---- judging ----


def _check_still(recording: Recording, *, then: str) -> None:
    for name, values, limit in (
        ("accel", recording.accel, STILL_ACCEL),
        ("gyro", recording.gyro, STILL_GYRO),
    ):
        means = _block_means(values)
        noise = values.std(axis=0) / np.sqrt(len(values) / BLOCKS)
        spread = means.max(axis=0) - means.min(axis=0)
        if (spread > limit + SIGMAS * noise).any():
            raise FlashError(
                f"the device moved while it was measured ({name} wandered by {spread.max():.3g}). "
                f"{then}"
            )


def _check_applies(calibration: Calibration, plan: Plan, still: Recording) -> None:
    """Refuse what would make it worse: another device's calibration, or one flashed already.

    At rest the gyroscope must come nearer to 0, and the size of the corrected specific force must
    agree with gravity at least as well with the bias taken off as without.
    """
    again = "it was flashed already, is another device, or moves. Nothing was written; record and "
    again += "calibrate again"
    rate = still.gyro.mean(axis=0)
    planned = plan.gyro(rate[None])[0]
    slack = SIGMAS * np.array([_error(column) for column in still.gyro.T])
    slack += still.device.gyro_lsb or 0.0
    bias = calibration.model.gyro.bias
    known = np.array([f"gyro.bias.{axis}" in calibration.names for axis in "xyz"])
    # A turn-on bias moves by tenths of a degree/s; one that is already gone differs by all of it.
    far = np.abs(rate - bias) > np.deg2rad(0.5) + 0.5 * np.abs(bias)
    if (known & (far | (np.abs(planned) > np.abs(rate) + slack))).any():
        raise FlashError(
            f"the resting gyroscope reads {_dps(rate)} °/s, the calibration's bias is "
            f"{_dps(bias)} °/s: {again}"
        )
    if all(f"accel.bias.{axis}" in calibration.names for axis in "xyz"):
        force, model = still.accel.mean(axis=0), calibration.model.accel
        gravity = calibration.gravity.value
        with_bias = float(np.linalg.norm(model.correct(force[None])))
        without = float(np.linalg.norm(np.linalg.solve(model.matrix, force)))
        worse = abs(with_bias - gravity) > abs(without - gravity) + ACCEL_SLACK
        if worse or abs(with_bias - gravity) > ACCEL_FAR:
            raise FlashError(
                f"at rest the corrected accelerometer reads {with_bias:.3f} m/s², gravity is "
                f"{gravity:.3f}, and without the bias it reads {without:.3f}: {again}"
            )


def _dps(values: FloatArray) -> str:
    return ", ".join(f"{v:.2f}" for v in np.rad2deg(values))


def _compare(before: Recording, after: Recording, plan: Plan) -> tuple[Check, ...]:
    out = []
    info = before.device
    for triad, action, lsb in (
        ("accel", plan.accel, info.accel_lsb),
        ("gyro", plan.gyro, info.gyro_lsb),
    ):
        first, second = getattr(before, triad), getattr(after, triad)
        expected = action(first.mean(axis=0)[None])[0]
        for k, axis in enumerate("xyz"):
            error = np.hypot(_error(first[:, k]), _error(second[:, k]))
            start, end = float(first[:, k].mean()), float(second[:, k].mean())
            # Half a count of rounding before, half after.
            tolerance = SIGMAS * error + (lsb or 0.0) + DRIFT * abs(expected[k] - start)
            out.append(Check(f"{triad}.{axis}", start, end, float(expected[k]), float(tolerance)))
    return tuple(out)


def _error(values: FloatArray) -> float:
    """Standard error of a mean, from block means, which see slow noise too."""
    return float(_block_means(values).std(ddof=1) / np.sqrt(BLOCKS))


def _block_means(values: FloatArray) -> FloatArray:
    size = len(values) // BLOCKS
    if size == 0:
        raise FlashError(f"only {len(values)} samples came: measure for longer (--measure)")
    blocks = values[: size * BLOCKS].reshape(BLOCKS, size, *values.shape[1:])
    return np.asarray(blocks.mean(axis=1))


def _judge(checks: tuple[Check, ...]) -> None:
    """Require that every channel moved as it should, in size and in sign."""
    for check in checks:
        if not check.good:
            moved, wanted = check.after - check.before, check.expected - check.before
            raise FlashError(
                f"at rest {check.channel} moved by {moved:+.4g}, it should have moved by "
                f"{wanted:+.4g} (±{check.tolerance:.2g}); the device does not act on what it "
                "holds as expected, or it was moved"
            )
