"""``imu-cal info`` and ``convert`` as a person at the bench, or a script, uses them."""

import json
import os
import signal
import subprocess
import sys
from pathlib import Path
from time import sleep

import numpy as np
import pytest
from typer.testing import CliRunner

from calib.recording import Recording
from drivers.formats import read_recording, write_recording
from imu_cli.app import app

FIXTURES = Path(__file__).resolve().parents[2] / "fixtures"
BENCH, BAD = FIXTURES / "bench.csv", FIXTURES / "bad"


def run(*args: object) -> tuple[int, str, str]:
    result = CliRunner().invoke(app, [str(arg) for arg in args], env={"COLUMNS": "80"})
    return result.exit_code, result.stdout, result.stderr


def test_a_good_log_reads_well_in_80_columns() -> None:
    code, out, err = run("info", BENCH, "--strict")
    assert (code, err) == (0, "")
    assert max(map(len, out.splitlines())) <= 80
    for text in ("MPU-6050 SIM-0001, ±4 g, ±500 °/s", "9786", "100 Hz", "20 static poses"):
        assert text in out
    assert "nothing found to be wrong" in out


def test_findings_are_output_and_strict_makes_them_a_failure() -> None:
    for name, kind in [
        ("gyro_in_degrees.csv", "unit"),
        ("accel_in_g.csv", "unit"),
        ("accel_in_mg.csv", "unit"),
        ("killed.arrow", "cut"),
        ("cut_line.csv", "cut"),
    ]:
        code, out, _ = run("info", BAD / name, "--json")
        assert code == 0
        assert [found["kind"] for found in json.loads(out)["findings"]] == [kind], name
        assert run("info", BAD / name, "--strict")[0] == 6
        table = run("info", BAD / name)[1]
        assert kind in table
        assert max(map(len, table.splitlines())) <= 80


@pytest.mark.parametrize("name", ["one_pose.csv", "only_motion.csv"])
def test_a_log_that_cannot_be_calibrated_is_not_faulty(name: str) -> None:
    code, out, _ = run("info", BAD / name, "--json", "--strict")
    assert code == 0
    assert json.loads(out)["findings"] == []
    assert json.loads(out)["remarks"]


@pytest.mark.parametrize("command", ["info", "convert"])
@pytest.mark.parametrize(
    "name", ["empty.csv", "header_only.csv", "letter.csv", "binary.csv", "folder.csv", "none.csv"]
)
def test_what_cannot_be_read_is_refused(tmp_path: Path, command: str, name: str) -> None:
    out = tmp_path / "out.csv"
    extra = [] if command == "info" else ["-o", out]
    code, stdout, err = run(command, BAD / name, *extra)
    assert (code, stdout) == (3, "")
    assert err.startswith("imu-cal: ")
    assert "Traceback" not in err
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("suffix", [".arrow", ".feather", ".parquet", ".csv"])
def test_convert_keeps_every_value(tmp_path: Path, suffix: str) -> None:
    out = tmp_path / f"bench{suffix}"
    code, text, err = run("convert", BENCH, "-o", out)
    assert (code, err) == (0, "")
    assert "9786 samples, 0 lost" in text
    a, b = read_recording(BENCH), read_recording(out)
    for name in ("time", "accel", "gyro", "temperature"):
        np.testing.assert_array_equal(getattr(a, name), getattr(b, name))
    assert (a.device, dict(a.notes)) == (b.device, dict(b.notes))


def test_convert_says_what_it_left_out(tmp_path: Path) -> None:
    out = tmp_path / "out.arrow"
    code, _, err = run("convert", BAD / "nan_row.csv", "-o", out)
    assert code == 3
    assert not out.exists()
    code, text, err = run("convert", BAD / "nan_row.csv", "-o", out, "--drop-invalid", "--json")
    assert code == 0
    assert "1 invalid row" in err
    assert json.loads(text) == {
        "written": str(out),
        "samples": 299,
        "lost": 1,
        "complete": True,
    }
    code, _, err = run("convert", BAD / "cut_line.csv", "-o", out)
    assert code == 0
    assert "cut" in err
    assert not read_recording(out).complete


@pytest.mark.parametrize(
    "words",
    [
        ("report", "a.csv", "-o", "a.csv"),
        ("report", "a.csv", "-o", "link.csv"),
        ("diagnose", "a.csv", "-o", "a.csv"),
        ("diagnose", "a.csv", "--report", "a.csv"),
        ("record", "replay://a.csv?speed=0", "-o", "a.csv", "--overwrite"),
        ("record", "replay://a.csv?speed=0", "-o", "b.csv", "--raw", "link.csv", "--overwrite"),
        ("bench", "replay://a.csv?speed=0", "-o", "a.csv", "--overwrite", "--auto"),
        ("diagnose", "b.csv", "--calibration", "a.csv", "-o", "a.csv"),
        ("diagnose", "b.csv", "--calibration", "a.csv", "--report", "link.csv"),
        ("diagnose", "b.csv", "--reference", "a.csv", "-o", "a.csv"),
        ("calibrate", "b.csv", "--housing-faces", "a.csv", "-o", "link.csv"),
        ("calibrate", "b.csv", "--table-rate", "a.csv", "-o", "a.csv"),
        ("simulate", "--sensor", "a.csv", "-o", "a.csv"),
        ("simulate", "--reference", "a.csv", "-o", "b.csv", "--truth", "a.csv"),
    ],
)
def test_no_command_writes_over_its_source(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, words: tuple[str, ...]
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "a.csv").write_bytes((BAD / "one_pose.csv").read_bytes())
    (tmp_path / "link.csv").hardlink_to(tmp_path / "a.csv")
    code, _, err = run(*words)
    assert code == 2
    assert "itself" in err
    assert (tmp_path / "a.csv").read_bytes() == (BAD / "one_pose.csv").read_bytes()


def refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, words: tuple[str, ...]) -> str:
    """Return what is said of a command that is refused, and writes nothing beside `a.csv`."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "a.csv").write_bytes((BAD / "one_pose.csv").read_bytes())
    code, _, err = run(*words)
    assert code == 2
    assert os.listdir(tmp_path) == ["a.csv"]
    return " ".join(err.replace("│", " ").split())


@pytest.mark.parametrize(
    "words",
    [
        ("convert", "a.csv", "-o", "-"),
        ("report", "a.csv", "-o", "-"),
        ("diagnose", "a.csv", "-o", "-"),
        ("diagnose", "a.csv", "--report", "-"),
        ("calibrate", "a.csv", "-o", "-"),
        ("simulate", "-o", "-"),
        ("record", "replay://a.csv?speed=0", "-o", "-"),
    ],
)
def test_standard_output_is_no_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, words: tuple[str, ...]
) -> None:
    """A file of the name `-` was written."""
    assert "- is no file: name one" in refused(tmp_path, monkeypatch, words)


@pytest.mark.parametrize(
    "words",
    [
        ("diagnose", "a.csv", "-o", "z.json", "--report", "z.json"),
        ("simulate", "-o", "z.csv", "--truth", "z.csv"),
        ("record", "replay://a.csv?speed=0", "-o", "z.csv", "--raw", "./z.csv"),
    ],
)
def test_no_command_writes_two_outputs_to_one_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, words: tuple[str, ...]
) -> None:
    """The report was written over the model that was found."""
    assert "two files" in refused(tmp_path, monkeypatch, words)


def test_what_is_written_over_is_called_what_it_is(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A reference was called "the recording itself"."""
    monkeypatch.chdir(tmp_path)
    code, _, err = run("diagnose", "a.csv", "--reference", "ref.csv", "-o", "ref.csv")
    assert code == 2
    assert "is the reference itself" in " ".join(err.replace("│", " ").split())


def test_convert_refuses_to_overwrite_its_input_and_unknown_suffixes(tmp_path: Path) -> None:
    assert run("convert", BENCH, "-o", BENCH)[0] == 2
    code, _, err = run("convert", BENCH, "-o", tmp_path / "x.zip")
    assert code == 3
    assert "'.zip' names no format" in err
    assert run("convert", BENCH, "-o", tmp_path / "no" / "x.csv")[0] == 3


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGHUP])
def test_what_ends_a_conversion_leaves_no_half_of_a_file(tmp_path: Path, number: int) -> None:
    """A `.part` of any size stayed."""
    time = np.arange(300_000) / 100.0
    many = Recording(time, np.ones((len(time), 3)), np.zeros((len(time), 3)), "device")
    log, out = tmp_path / "log.arrow", tmp_path / "log.csv"
    write_recording(many, log)
    with subprocess.Popen(
        [sys.executable, "-m", "imu_cli", "convert", str(log), "-o", str(out)],
        # Whoever runs the tests may ignore it, as nohup does, and so would the command.
        preexec_fn=lambda: signal.signal(number, signal.SIG_DFL),
    ) as made:
        while made.poll() is None and not list(tmp_path.glob("*.part")):
            sleep(0.01)
        made.send_signal(number)
        assert made.wait(60) == 128 + number
    assert list(tmp_path.iterdir()) == [log]
