"""The errors that an emulated device has are the errors that a calibration finds in it."""

import threading
from pathlib import Path

import numpy as np
import pytest

from calib.calibrate import calibrate
from drivers.emulators.base import EmulatorOptions, make_sensor
from drivers.formats import read_recording
from drivers.record import RecordLimits, record
from drivers.transports import make_driver


@pytest.mark.parametrize("name", ["witmotion", "arduino"])
def test_calibration_finds_the_emulators_errors(name: str, tmp_path: Path) -> None:
    options = EmulatorOptions(rate=100.0, seed=11, motion="bench")
    sensor = make_sensor(options, default_rate=100.0)
    record(
        make_driver(f"emulator://{name}?rate=100&seed=11&motion=bench&speed=0"),
        tmp_path / "log.arrow",
        limits=RecordLimits(samples=sensor.script_length - 20),
        raw=None,
        reconnect=False,
        stop=threading.Event(),
        progress=lambda state: None,
    )
    found = calibrate(read_recording(tmp_path / "log.arrow"), gravity=9.80665)
    true = {
        **sensor.model.accel.parameters("accel"),
        **sensor.model.gyro.parameters("gyro"),
    }
    got = {
        **found.model.accel.parameters("accel"),
        **found.model.gyro.parameters("gyro"),
    }
    sigma = dict(zip(found.names, np.sqrt(np.diag(found.covariance)), strict=True))
    assert len(sigma) >= 21
    errors = np.array([(got[key] - true[key]) / sigma[key] for key in sigma])
    assert np.abs(errors).max() < 5
    assert 0.3 < np.sqrt(np.mean(errors**2)) < 2
