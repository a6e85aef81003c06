"""Every term of a sensor, from a calibration file through `simulate`, `apply` and `show`.

A new file in `calib/effects` is tested here with no edit.
"""

from functools import cache
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner, Result

from calib.calibration import Calibration, Gravity
from calib.effects import effects
from calib.effects.base import Effect, TransformEffect
from calib.effects.text import parse_term
from calib.model import SensorModel
from calib.recording import Recording
from drivers.calibration_file import load_calibration, save_calibration
from drivers.formats import read_recording
from imu_cli.app import app

SECONDS, RATE = 60.0, 50.0
SENSOR = [effect for effect in effects().values() if effect.kind == "sensor"]
ROUNDING = 1e-12

LEFT = 0.25
"""Of the error signal, at most, that `apply` leaves without noise: settling depends on the moments
at which turns are seen to end."""


def run(*arguments: object) -> Result:
    result = CliRunner().invoke(app, [str(a) for a in arguments])
    assert result.exit_code == 0, result.output + result.stderr
    return result


def simulated(path: Path, motion: str, *options: object, seed: int = 5) -> Recording:
    run(
        *("simulate", "--motion", motion, "--duration", f"{SECONDS}s", "--rate", RATE),
        *("--seed", seed, *options, "-o", path),
    )
    return read_recording(path)


@cache
def ideal(motion: str, folder: Path) -> Recording:
    return simulated(folder / f"{motion}.arrow", motion, "--noise", 0)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("ideal")


def off(first: Recording, second: Recording) -> np.ndarray:
    """Root-mean-square difference of each channel, (6,), m/s² and rad/s."""
    n = min(len(first), len(second))
    left = np.hstack((first.accel[:n] - second.accel[:n], first.gyro[:n] - second.gyro[:n]))
    return np.sqrt(np.mean(left**2, axis=0))


@pytest.mark.parametrize("effect", SENSOR, ids=lambda effect: effect.slug)
def test_a_calibration_with_an_effect_simulates_corrects_and_shows_it(
    effect: Effect, tmp_path: Path, folder: Path
) -> None:
    motion = "vibrating" if "vibration" in effect.reads else "bench"
    term = parse_term(effect.slug, span=(0.0, SECONDS))
    cal = tmp_path / "sensor.json"
    model = SensorModel(terms=(term,))
    save_calibration(Calibration(model, (), np.zeros((0, 0)), (), Gravity(9.80665)), cal)
    assert load_calibration(cal).model.terms == (term,)
    assert effect.slug in run("show", cal).stdout

    # As the option alone would, to the bit.
    log = tmp_path / "log.arrow"
    found = simulated(log, motion, "--noise", 0, "--sensor", cal)
    alone = simulated(tmp_path / "alone.arrow", motion, "--noise", 0, "--effect", effect.slug)
    assert not off(found, alone).any()

    true = ideal(motion, folder)
    before = off(found, true)
    assert before.any()
    run("apply", cal, log, "-o", tmp_path / "fixed.arrow")
    after = off(read_recording(tmp_path / "fixed.arrow"), true)
    if isinstance(effect, TransformEffect) and effect.stage == "readout":
        # What was rounded away is gone, and stays as it is.
        np.testing.assert_allclose(after, before, rtol=1e-9)
        return
    # Motion that is sampled more finely is the same but for rounding.
    touched = before > ROUNDING
    assert (after[touched] < LEFT * before[touched]).all()
    assert (after[~touched] < ROUNDING).all()


@pytest.mark.parametrize(
    "effect",
    [
        "gyro_g_sensitivity:gxz=3e-4",
        "accel_cross_product:kx_xy=1.5e-3",
        # Eight times a typical one: the first minute's rests drift by 1 °/s.
        "gyro_warm_up:kx=0.014,ky=0.014,kz=0.014,tau=60",
    ],
)
@pytest.mark.long
def test_what_a_diagnosis_found_corrects_another_recording(effect: str, tmp_path: Path) -> None:
    def recorded(name: str, *options: object, seed: int) -> Recording:
        run(
            *("simulate", "--duration", "120s", "--rate", RATE, "--seed", seed, *options),
            *("-o", tmp_path / name),
        )
        return read_recording(tmp_path / name)

    slug = effect.partition(":")[0]
    recorded("log.arrow", "--effect", effect, seed=11)
    model = tmp_path / "model.json"
    run("diagnose", tmp_path / "log.arrow", "-o", model)
    assert [t.effect for t in load_calibration(model).model.terms] == [slug]
    assert slug in run("show", model).stdout

    other = recorded("other.arrow", "--effect", effect, "--noise", 0, seed=12)
    true = recorded("true.arrow", "--noise", 0, seed=12)
    run("apply", model, tmp_path / "other.arrow", "-o", tmp_path / "fixed.arrow")
    before, after = off(other, true), off(read_recording(tmp_path / "fixed.arrow"), true)
    mine = before > 0
    # A quarter of the noise of one sample (0.02 m/s², 4.4e-4 rad/s at 50 Hz), and so much of the
    # effect as it is not known.
    noise = np.repeat([0.02, 4.4e-4], 3)
    assert (after[mine] < np.hypot(0.1 * before, 0.25 * noise)[mine]).all()

    # And the sensor that was found records what that sensor did.
    again = recorded("again.arrow", "--sensor", model, "--noise", 0, seed=12)
    assert (off(again, other)[mine] < np.hypot(0.1 * before, 0.25 * noise)[mine]).all()
