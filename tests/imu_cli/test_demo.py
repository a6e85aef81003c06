"""The demo tells a true story: the effect that was concealed is the one that it names."""

import json
import os
import signal
import subprocess
import sys
from contextlib import suppress
from pathlib import Path

import pytest
from typer.testing import CliRunner

from calib.effects.text import parse_term
from drivers.calibration_file import load_calibration
from drivers.formats import read_recording
from imu_cli.app import app
from imu_cli.story import EFFECT


@pytest.mark.skipif(os.name == "nt", reason="needs a pty, which Windows has not")
@pytest.mark.long
def test_the_demo_names_what_was_concealed_and_leaves_its_files(tmp_path: Path) -> None:
    done = CliRunner().invoke(app, ["demo", "--out", str(tmp_path)], catch_exceptions=False)
    assert done.exit_code == 0, done.stdout + done.stderr
    term = parse_term(EFFECT, span=(0.0, 1.0))
    diagnosis = json.loads((tmp_path / "demo.diagnosis.json").read_text(encoding="utf-8"))
    assert [item["effect"] for item in diagnosis["findings"]] == [term.effect]
    calibration = load_calibration(tmp_path / "demo.cal.json")
    values, sigmas = calibration.values, calibration.sigmas
    for name, value in term.parameters.items():
        full = f"{term.effect}.{name}"
        assert abs(values[full] - value) < 4 * sigmas[full]
    assert read_recording(tmp_path / "demo.arrow").complete
    assert "right within its standard errors" in done.stdout
    assert (tmp_path / "demo.html").stat().st_size > 100_000


@pytest.mark.skipif(os.name == "nt", reason="needs a pty, which Windows has not")
def test_a_demo_that_is_ended_ends_its_emulator(tmp_path: Path) -> None:
    with subprocess.Popen(
        [sys.executable, "-u", "-m", "imu_cli", "demo", "--out", str(tmp_path)],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    ) as demo:
        try:
            assert demo.stdout is not None
            while "It is on a pty" not in demo.stdout.readline():
                assert demo.poll() is None
            demo.terminate()
            demo.communicate(timeout=10)  # both have standard error, so it waits for both
            assert demo.returncode == 130
        finally:
            with suppress(ProcessLookupError):
                os.killpg(demo.pid, signal.SIGKILL)
