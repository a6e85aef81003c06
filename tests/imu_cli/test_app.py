"""The command line as a process."""

import subprocess
import sys

import pytest


@pytest.mark.parametrize("arguments", [["show", "--schema"], ["devices"]])
def test_a_reader_that_goes_away_is_no_bug(arguments: list[str]) -> None:
    command = [sys.executable, "-m", "imu_cli", *arguments]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE) as process:
        assert process.stdout is not None
        assert process.stderr is not None
        process.stdout.close()
        said = process.stderr.read()
    assert (process.returncode, said) == (0, b"")


def test_an_error_that_nobody_reads_keeps_its_exit_code() -> None:
    command = [sys.executable, "-m", "imu_cli", "info", "missing.arrow"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE) as process:
        assert process.stderr is not None
        process.stderr.close()
    assert process.returncode == 3
