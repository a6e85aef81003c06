"""Correct a recording from file to file, in bounded memory."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace
from pathlib import Path

from calib.apply import Block, Corrector, Coverage, reads_temperature
from calib.calibration import Calibration
from calib.compare import device_mismatch
from calib.errors import RecordingError
from calib.recording import Recording
from calib.thermometer import Temperature, known_temperature
from calib.types import FloatArray
from drivers.formats import open_batches, open_writer

CORRECTED = "corrected_by"
"""Note in a corrected recording: which calibration it was corrected by."""


def corrected_batches(
    calibration: Calibration,
    batches: Iterable[Recording],
    *,
    name: str,
    coverage: Coverage,
    temperature: Temperature | None = None,
) -> Iterator[Recording]:
    """Yield the corrected batches of one recording.

    Parameters
    ----------
    calibration : Calibration
    batches : iterable of Recording
        In the order of time.
    name : str
        Of the calibration, for the recording's notes.
    coverage : Coverage
        Is filled in on the way.
    temperature : Temperature or None
        As in `calib.apply.Corrector`.

    Raises
    ------
    RecordingError
        If the recording was corrected before.
    """
    corrector: Corrector | None = None
    waiting: list[Recording] = []
    for batch in batches:
        if corrector is None:
            refuse_corrected(batch)
            interval = batch.interval or _interval(calibration)
            corrector = Corrector(calibration, interval, coverage, temperature)
        waiting.append(batch)
        block = Block(batch.time, batch.accel, batch.gyro, batch.temperature)
        yield from _emit(waiting, *corrector.add(block), name)
    if corrector is not None:
        yield from _emit(waiting, *corrector.finish(), name)


def apply_file(
    calibration: Calibration,
    log: Path | list[Path],
    out: Path,
    *,
    name: str,
    profile: str | None = None,
    imu: int | None = None,
    drop_invalid: bool = False,
    check_device: Callable[[str], None] = lambda _: None,
) -> Coverage:
    """Correct a recording and write it in the format of the suffix of `out`, whole or not at all.

    ``check_device`` is told once if the recording is of another device than the calibration.
    """
    coverage, temperature = Coverage(), None
    if reads_temperature(calibration):
        # What a thermometer reads is rounded and noisy: what it was is known from all of it.
        temperature = known_temperature(
            open_batches(log, profile=profile, imu=imu, drop_invalid=drop_invalid)
        )
    batches = corrected_batches(
        calibration,
        open_batches(log, profile=profile, imu=imu, drop_invalid=drop_invalid),
        name=name,
        coverage=coverage,
        temperature=temperature,
    )
    first = True
    with open_writer(out, atomic=True) as writer:
        for batch in batches:
            if first:
                first = False
                mismatch = device_mismatch(calibration.provenance.device, batch.device)
                if mismatch:
                    check_device(mismatch)
            writer.append(batch)
    return coverage


def refuse_corrected(recording: Recording) -> None:
    """Raise RecordingError if a recording was corrected before: nothing is corrected twice."""
    if CORRECTED in recording.notes:
        raise RecordingError(
            f"this recording was corrected by {recording.notes[CORRECTED]} already; give the "
            "recording as it was measured"
        )


def _interval(calibration: Calibration) -> float:
    return 0.01 if calibration.noise is None else 1.0 / calibration.noise.rate


def _emit(
    waiting: list[Recording], accel: FloatArray, gyro: FloatArray, name: str
) -> Iterator[Recording]:
    """Give the corrected samples back to the batches that they are of, as far as they reach."""
    at = 0
    while waiting and at < len(accel):
        batch = waiting[0]
        count = min(len(batch), len(accel) - at)
        part = batch if count == len(batch) else batch.slice(0, count)
        device = replace(
            part.device, accel_full_scale=None, gyro_full_scale=None, accel_lsb=None, gyro_lsb=None
        )
        yield replace(
            part,
            accel=accel[at : at + count],
            gyro=gyro[at : at + count],
            device=device,
            notes={**part.notes, CORRECTED: name},
        )
        at += count
        waiting[0] = batch.slice(count, len(batch)) if count < len(batch) else batch
        if count == len(batch):
            waiting.pop(0)
