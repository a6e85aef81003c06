"""``imu-cal simulate``: files, twins, effects and wrong arguments."""

import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner, Result

from calib.calibration import Calibration, Event, Gravity, Noise, Provenance, Quantity
from calib.effects.base import Term
from calib.effects.text import parse_term
from calib.mismatch.reference.twinned import twin_sensor
from calib.model import SensorModel, Triad
from calib.simulate import Sampling, simulate
from calib.simulation.kinematics import Motion
from calib.simulation.library import MOTIONS, make_motion
from calib.simulation.noise import CONSUMER
from drivers.calibration_file import describe_input, load_calibration, save_calibration
from drivers.formats import open_writer, read_recording
from imu_cli.app import app
from imu_cli.options import parse_duration


def run(*arguments: object) -> Result:
    return CliRunner().invoke(app, ["simulate", *(str(a) for a in arguments)])


@pytest.fixture
def sensor(tmp_path: Path) -> Path:
    model = SensorModel(
        Triad(np.array([0.3, -0.2, 0.1]), np.array([0.02, -0.01, 0.03])),
        Triad(np.array([0.02, -0.01, 0.03]), np.array([0.01, -0.02, 0.03])),
        (Term("gyro_g_sensitivity", {"gxx": 2e-4}),),
    )
    noise = Noise(100.0, np.full(3, 4e-3), np.full(3, 1e-4))
    path = tmp_path / "sensor.cal.json"
    empty = np.zeros((0, 0))
    save_calibration(Calibration(model, (), empty, (), Gravity(9.81), noise=noise), path)
    return path


@pytest.mark.parametrize("motion", MOTIONS)
def test_every_motion(motion: str, tmp_path: Path) -> None:
    path = tmp_path / "sim.arrow"
    result = run("--motion", motion, "--duration", "2min", "--rate", 50, "-o", path)
    assert result.exit_code == 0, result.stderr
    recording = read_recording(path)
    assert recording.duration == pytest.approx(120.0, abs=0.1)
    assert recording.interval == pytest.approx(0.02)
    assert recording.complete


def test_help_names_every_motion() -> None:
    text = " ".join(run("--help").stdout.split())
    assert all(name in text for name in MOTIONS)


def test_the_same_seed_is_the_same_recording(tmp_path: Path) -> None:
    first, second, other = (tmp_path / f"{k}.arrow" for k in range(3))
    for path, seed in ((first, 1), (second, 1), (other, 2)):
        assert run("--duration", "30s", "--seed", seed, "-o", path).exit_code == 0
    assert first.read_bytes() == second.read_bytes()
    assert first.read_bytes() != other.read_bytes()


def test_sensor_effects_and_truth(sensor: Path, tmp_path: Path) -> None:
    path, truth = tmp_path / "sim.csv", tmp_path / "truth.csv"
    result = run(
        *("--sensor", sensor, "--effect", "accel_bias_step:bx=0.5,moment=20", "--noise", 0),
        *("--duration", "40s", "-o", path, "--truth", truth, "--json"),
    )
    assert result.exit_code == 0, result.stderr
    document = json.loads(result.stdout)
    assert document["format"] == "imu-cal/simulation"
    assert document["sensor"]["accel.bias.x"] == 0.3
    assert [term["effect"] for term in document["terms"]] == [
        "gyro_g_sensitivity",
        "accel_bias_step",
    ]
    assert document["segments"][0]["kind"] == "static"
    assert document["gravity"] == 9.81
    measured, true = read_recording(path), read_recording(truth)
    left = measured.accel[:, 0] - true.accel[:, 0] * 1.02 - 0.3
    np.testing.assert_allclose(left, np.where(measured.time >= 20, 0.5, 0.0), atol=1e-5)


def test_ranges_clip_and_round(tmp_path: Path) -> None:
    path = tmp_path / "sim.arrow"
    result = run(
        *("--gyro-range", 125, "--accel-range", 2, "--bits", 12, "--duration", "30s", "-o", path)
    )
    assert result.exit_code == 0, result.stderr
    found = read_recording(path)
    lsb = np.radians(125) / 2048
    assert found.device.gyro_lsb == pytest.approx(lsb)
    assert found.device.accel_full_scale == pytest.approx(2 * 9.80665)
    np.testing.assert_allclose(found.gyro / lsb, np.round(found.gyro / lsb), atol=1e-6)
    assert found.gyro.max() == pytest.approx(np.radians(125) - lsb)


def test_twin_of_a_recording(sensor: Path, tmp_path: Path) -> None:
    log, twin = tmp_path / "log.arrow", tmp_path / "twin.arrow"
    assert run("--sensor", sensor, "--duration", "60s", "-o", log).exit_code == 0
    result = run("--like", log, "--calibration", sensor, "-o", twin, "--noise", 0)
    assert result.exit_code == 0, result.stderr
    recorded, found = read_recording(log), read_recording(twin)
    np.testing.assert_array_equal(found.time, recorded.time)
    assert np.std(found.gyro - recorded.gyro) < 2e-3
    assert np.std(found.accel - recorded.accel) < 0.06


def test_the_truth_of_a_twin_is_neither_clipped_nor_rounded(sensor: Path, tmp_path: Path) -> None:
    log, twin, truth = (tmp_path / f"{name}.arrow" for name in ("log", "twin", "truth"))
    coarse = ("--accel-range", 2, "--gyro-range", 125, "--bits", 8)
    assert run("--sensor", sensor, "--duration", "60s", *coarse, "-o", log).exit_code == 0
    given = ("--like", log, "--calibration", sensor, "-o", twin, "--truth", truth)
    result = run(*given)
    assert result.exit_code == 0, result.stderr
    seen, true = read_recording(twin), read_recording(truth)
    assert len(np.unique(seen.gyro)) <= 256
    assert len(np.unique(true.gyro[:, 0])) > 1000
    assert true.device.gyro_full_scale is None
    np.testing.assert_array_equal(true.time, seen.time)


def test_a_garbled_sample_is_no_motion_of_the_twin(sensor: Path, tmp_path: Path) -> None:
    log, garbled = tmp_path / "log.csv", tmp_path / "garbled.csv"
    assert run("--sensor", sensor, "--duration", "40s", "-o", log).exit_code == 0
    lines = log.read_text().splitlines()
    head = next(k for k, line in enumerate(lines) if line.startswith("time"))
    column = lines[head].split(",").index("gyro_y")
    for row in (900, 1800, 2500):
        values = lines[head + row].split(",")
        values[column] = str(float(values[column]) + 4.0)
        lines[head + row] = ",".join(values)
    garbled.write_text("\n".join(lines) + "\n")
    twins = []
    for name in (log, garbled):
        twin = tmp_path / f"twin-{name.stem}.arrow"
        given = ("--like", name, "--calibration", sensor, "--noise", 0)
        assert run(*given, "-o", twin).exit_code == 0
        twins.append(read_recording(twin))
    assert len(twins[0]) == len(twins[1])
    assert np.abs(twins[0].gyro - twins[1].gyro).max() < 0.1
    assert np.abs(twins[0].accel - twins[1].accel).max() < 0.5


def test_a_twin_says_which_sensor_it_is_of_in_any_format(sensor: Path, tmp_path: Path) -> None:
    log = tmp_path / "log.arrow"
    assert run("--sensor", sensor, "--duration", "40s", "-o", log).exit_code == 0
    for name in ("twin.arrow", "twin.csv", "twin.parquet"):
        twin = tmp_path / name
        term = "gyro_g_sensitivity:gxy=0.001"
        given = ("--like", log, "--calibration", sensor, "--effect", term)
        assert run(*given, "-o", twin).exit_code == 0
        model = twin_sensor(read_recording(log), read_recording(twin))
        assert model.terms[-1].parameters == {"gxy": 0.001}
        known = load_calibration(sensor).model
        assert model.accel.parameters("accel") == known.accel.parameters("accel")
    assert twin_sensor(read_recording(log), read_recording(log)) is None


def test_events_are_in_the_twin_of_their_own_recording_only(sensor: Path, tmp_path: Path) -> None:
    log, other, twin = (tmp_path / f"{name}.arrow" for name in ("log", "other", "twin"))
    assert run("--sensor", sensor, "--duration", "40s", "-o", log).exit_code == 0
    assert run("--sensor", sensor, "--duration", "40s", "--seed", 1, "-o", other).exit_code == 0
    step = {name: Quantity(value, None, "") for name, value in (("bz", 1.0), ("moment", 2.0))}
    known = replace(
        load_calibration(sensor),
        events=(Event("gyro_bias_step", ("gyro.z",), ((2.0, 40.0),), step),),
        provenance=Provenance((describe_input(log),)),
    )
    path = tmp_path / "known.cal.json"
    save_calibration(known, path)
    for recording, said in ((log, True), (other, False)):
        result = run("--like", recording, "--calibration", path, "-o", twin)
        assert result.exit_code == 0, result.stderr
        assert ("gyro_bias_step (bz = 1, moment = 2)" in result.stdout) is said


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["--motion", "flight"], "no motion"),
        (["--effect", "gyro_warmup"], "did you mean gyro_warm_up"),
        (["--effect", "gyro_warm_up:kq=1"], "no parameter of gyro_warm_up"),
        (["--effect", "gyro_warm_up:kx"], "no value"),
        (["--effect", "gyro_warm_up:kx=much"], "no number"),
        (["--effect", "saturation"], "full_scale"),
        (["--effect", "axis_error"], "accel_axes"),
        (["--effect", "bandwidth:gyro_cutoff=-5"], "above 0 Hz, got -5"),
        (["--effect", "saturation:gyro=1"], "`gyro_full_scale`"),
        (["--effect", "dropped_samples:count=1,moment=1e3"], "0 to 180 s, got 1000"),
        (["--effect", "dropped_samples:count=1e9,moment=10"], "at most 18000, the samples"),
        (["--effect", "dropped_samples:count=-1e9,moment=10"], "at most 18000, the samples"),
        (["--effect", "dropped_samples:count=1.5,moment=10"], "a whole number of samples, got 1.5"),
        (["--effect", "gyro_g_sensitivity:gxz=1,gxz=2"], "`gxz` is given twice"),
        (["--effect", "saturation:level=-1"], "`level` is no parameter of saturation"),
        (["--duration", "long"], "no duration"),
        (["--rate", "0"], "--rate"),
        (["--seed", "-1"], "--seed"),
        (["--rate", "0.01", "--duration", "60s"], "0.6 samples"),
        (["--rate", "8000", "--duration", "24h"], "simulate shorter pieces"),
        (["--gyro-range", "0"], "--gyro-range"),
        (["--bits", "64"], "--bits"),
        (["--noise", "-1"], "--noise"),
        (["--gravity", "1"], "--gravity"),
        (["--lost", "2"], "lost"),
        (["--jitter", "nan"], "`jitter` must be 0 s or more, got nan"),
        (["--jitter", "inf"], "`jitter` must be 0 s or more, got inf"),
        (["--imu", "2"], "--like"),
        (["--profile", "mpu6050"], "--like"),
        (["--like", "log.csv"], "--calibration"),
        (["--calibration", "cal.json"], "--like"),
        (["--like", "log.csv", "--calibration", "cal.json", "--rate", "50"], "--rate"),
        (["--like", "log.csv", "--calibration", "cal.json", "--lost", "0.1"], "--lost"),
        (["--like", "log.csv", "--reference", "ref.csv", "--rate", "50"], "--rate"),
        (["--reference", "ref.csv", "--motion", "bench"], "--motion"),
        (["--reference", "ref.csv", "--calibration", "cal.json"], "--like"),
        (["--fixed-point"], "--reference"),
        (["--bandwidth", "5"], "--reference"),
    ],
)
def test_wrong_arguments(arguments: list[str], said: str, tmp_path: Path) -> None:
    result = run(*arguments, "-o", tmp_path / "sim.arrow")
    assert result.exit_code == 2
    assert said in " ".join(result.stderr.replace("│", " ").split())
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("name", "options", "code"),
    [("sim.xyz", [], 3), ("none/sim.arrow", [], 3), ("sim.arrow", ["--sensor", "none.json"], 10)],
)
def test_files_that_cannot_be(name: str, options: list[str], code: int, tmp_path: Path) -> None:
    result = run(*options, "-o", tmp_path / name)
    assert result.exit_code == code
    assert "Traceback" not in result.stderr
    assert not list(tmp_path.iterdir())


def test_inputs_are_not_overwritten(sensor: Path, tmp_path: Path) -> None:
    log = tmp_path / "log.arrow"
    assert run("--duration", "10s", "-o", log).exit_code == 0
    before = log.read_bytes()
    result = run("--like", log, "--calibration", sensor, "-o", log)
    assert result.exit_code == 2
    assert "itself" in result.stderr
    assert run("-o", tmp_path / "a.csv", "--truth", tmp_path / "a.csv").exit_code == 2
    assert log.read_bytes() == before


def reference(path: Path, motion: Motion, *, position: bool = True) -> Path:
    time = np.arange(0.0, motion.duration, 0.01)
    turning, way = motion.kinematics(time)
    names, columns = ["time", "qw", "qx", "qy", "qz"], [time[:, None] + 9.0, turning.quat]
    if position:
        assert way is not None
        names, columns = [*names, "x", "y", "z"], [*columns, way.position]
    np.savetxt(path, np.hstack(columns), "%.9f", ",", header=",".join(names), comments="")
    return path


@pytest.fixture
def moved() -> Motion:
    return make_motion("bench", rng=np.random.default_rng(3), duration=60.0, gravity=9.80665)


def test_the_motion_of_a_reference(moved: Motion, sensor: Path, tmp_path: Path) -> None:
    known = reference(tmp_path / "ref.csv", moved)
    path, truth = tmp_path / "sim.arrow", tmp_path / "truth.arrow"
    result = run("--reference", known, "--sensor", sensor, "-o", path, "--truth", truth, "--json")
    assert result.exit_code == 0, result.stderr
    document = json.loads(result.stdout)
    assert document["motion"] == "reference"
    known = {"bandwidth": None, "samples_missing": 0, "seconds_hidden": 0.0, "position": True}
    assert document["reference"] == known
    assert len([s for s in document["segments"] if s["kind"] == "turn"]) == len(moved.turns)
    true = read_recording(truth)
    assert true.duration == pytest.approx(60.0, abs=0.03)
    state = moved.state(true.time)
    inner = slice(100, -100)
    assert np.abs(true.gyro - state.rate)[inner].max() < 0.01
    # The fixture's sensor was calibrated where gravity is 9.81.
    assert (true.accel - state.force * 9.81 / 9.80665)[inner].std() < 0.01
    left = read_recording(path).accel[:, 0] - 1.02 * true.accel[:, 0]
    assert left.mean() == pytest.approx(0.3, abs=2e-3)


def test_a_reference_without_positions_is_said_to_stay(moved: Motion, tmp_path: Path) -> None:
    known = reference(tmp_path / "ref.csv", moved, position=False)
    path = tmp_path / "sim.csv"
    result = run("--reference", known, "--duration", "20s", "--noise", 0, "-o", path)
    assert result.exit_code == 0, result.stderr
    assert "--fixed-point" in result.stderr
    assert "does not move" in result.stdout
    size = np.linalg.norm(read_recording(path).accel, axis=1)
    np.testing.assert_allclose(size, 9.80665, atol=1e-5)
    result = run("--reference", known, "--fixed-point", "--duration", "20s", "-o", path)
    assert result.exit_code == 0, result.stderr
    assert not result.stderr


def test_a_duration_beyond_the_reference_is_said(moved: Motion, tmp_path: Path) -> None:
    known = reference(tmp_path / "ref.csv", moved)
    path = tmp_path / "sim.csv"
    result = run("--reference", known, "--duration", "5min", "--rate", 20, "-o", path)
    assert result.exit_code == 0, result.stderr
    assert "less than --duration 5min: the simulation ends with it" in result.stderr


@pytest.mark.parametrize("name", MOTIONS)
def test_the_summary_says_the_motion_that_was_asked_for(name: str, tmp_path: Path) -> None:
    """A hand-held motion was "bench", and had "1 spins"."""
    result = run("--motion", name, "--duration", "30s", "-o", tmp_path / "sim.arrow")
    assert result.stdout.partition("\n")[0].endswith(f", {name}")
    assert not re.search(r"\b1 (turns|spins|static poses)", result.stdout)


def test_repeated_samples_of_a_twin_are_bounded_by_its_recording(
    sensor: Path, tmp_path: Path
) -> None:
    log = tmp_path / "log.arrow"
    assert run("--duration", "10s", "-o", log).exit_code == 0
    result = run(
        *("--like", log, "--calibration", sensor, "-o", tmp_path / "twin.arrow"),
        *("--effect", "dropped_samples:count=-1e9,moment=5"),
    )
    assert result.exit_code == 2
    assert "at most 1001, the samples" in " ".join(result.stderr.replace("│", " ").split())


def test_a_hole_of_a_reference_is_left_out_and_said(moved: Motion, tmp_path: Path) -> None:
    known = reference(tmp_path / "ref.csv", moved)
    lines = known.read_text().splitlines()
    lines[3001:3501] = [line.split(",")[0] + ",,,,,,," for line in lines[3001:3501]]
    known.write_text("\n".join(lines) + "\n")
    path, truth = tmp_path / "sim.arrow", tmp_path / "truth.arrow"
    result = run("--reference", known, "--noise", 0, "-o", path, "--truth", truth)
    assert result.exit_code == 0, result.stderr
    said = " ".join(result.stderr.split())
    assert "a hole in which nobody knows how it moved, 5.17 s in all" in said
    assert "no samples were simulated there" in said
    assert "500 missing samples were left out or bridged" in result.stdout
    for name in (path, truth):
        found = read_recording(name)
        left = found.time[(found.time > 29.95) & (found.time < 35.05)]
        assert not len(left)
        assert found.samples_lost == found.lost.max() == pytest.approx(517, abs=1)
        assert np.linalg.norm(found.accel, axis=1).max() < 20.0


@pytest.mark.long
def test_a_reference_in_the_time_and_frame_of_a_log(
    moved: Motion, sensor: Path, tmp_path: Path
) -> None:
    known = reference(tmp_path / "ref.csv", moved)
    rng = np.random.default_rng(4)
    model = load_calibration(sensor).model
    log = tmp_path / "log.arrow"
    real = simulate(moved, model, CONSUMER, rng=rng, rate=80.0, sampling=Sampling(5.0))
    with open_writer(log, atomic=True) as writer:
        writer.append(real)
    twin = tmp_path / "twin.arrow"
    result = run(
        *("--reference", known, "--like", log, "--calibration", sensor, "-o", twin, "--noise", 0)
    )
    assert result.exit_code == 0, result.stderr
    found = read_recording(twin)
    first = int(np.searchsorted(real.time, found.time[0]))
    same = real.slice(first, first + len(found))
    assert len(found) > 0.98 * len(real)
    np.testing.assert_array_equal(found.time, same.time)
    inner = slice(40, -40)
    for name, level in (("accel", 4e-3), ("gyro", 1e-4)):
        left = (getattr(found, name) - getattr(same, name))[inner]
        assert np.sqrt(np.mean(left**2)) < 1.5 * level * np.sqrt(40)
    # Without a calibration it is the ideal sensor there.
    result = run("--reference", known, "--like", log, "-o", twin, "--noise", 0)
    assert result.exit_code == 0, result.stderr
    ideal = read_recording(twin)
    left = real.accel[np.searchsorted(real.time, ideal.time), 0] - ideal.accel[:, 0]
    assert left.mean() == pytest.approx(0.3, abs=0.1)


def test_an_imu_is_no_motion(sensor: Path, tmp_path: Path) -> None:
    log = tmp_path / "log.csv"
    assert run("--duration", "10s", "-o", log).exit_code == 0
    result = run("--reference", log, "-o", tmp_path / "sim.csv")
    assert result.exit_code == 3
    assert "--like log.csv with --calibration" in " ".join(result.stderr.split())
    assert run("--reference", log, "-o", log).exit_code == 2


def test_moments_lie_within_the_recording_that_is_twinned(sensor: Path, tmp_path: Path) -> None:
    log, twin = tmp_path / "log.arrow", tmp_path / "twin.arrow"
    assert run("--sensor", sensor, "--duration", "40s", "-o", log).exit_code == 0
    result = run(
        *("--like", log, "--calibration", sensor, "-o", twin, "--effect", "gyro_bias_step")
    )
    assert result.exit_code == 0, result.stderr
    assert "moment = 20" in result.stdout
    result = run(
        *("--like", log, "--calibration", sensor, "-o", twin),
        *("--effect", "gyro_bias_step:bx=0.1,moment=60"),
    )
    assert result.exit_code == 2
    assert "got 60" in result.stderr


def test_durations() -> None:
    assert [parse_duration(t) for t in ("90", "90s", "1.5min", "2h")] == [90.0, 90.0, 90.0, 7200.0]
    for text in ("", "s", "-1", "0", "1.2.3", "5 days"):
        with pytest.raises(ValueError, match="no duration"):
            parse_duration(text)


def test_an_effect_may_be_given_in_part() -> None:
    assert parse_term("gyro_bias_step", span=(0, 10)).parameters["moment"] == 5.0
    term = parse_term("gyro_warm_up:tau=50", span=(0, 10))
    assert term.parameters["tau"] == 50.0
    assert term.parameters["kx"] > 0
    assert parse_term("bandwidth:gyro_cutoff=20", span=(0, 10)).parameters == {"gyro_cutoff": 20}
