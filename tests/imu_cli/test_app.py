"""The command line as a process."""

import os
import subprocess
import sys
from pathlib import Path

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


def test_an_interrupt_of_what_is_being_imported_ends_with_its_exit_code(tmp_path: Path) -> None:
    """Modules that make dataclasses run `exec`; `python -m` ended by the signal then."""
    (tmp_path / "interrupted.py").write_text(
        "import imu_cli.app as cli\ncli.app = lambda: exec('raise KeyboardInterrupt')\ncli.main()\n"
    )
    command = [sys.executable, "-m", "interrupted"]
    paths = os.pathsep.join([str(tmp_path), *sys.path])
    found = subprocess.run(command, env={**os.environ, "PYTHONPATH": paths}, check=False)
    assert found.returncode == 130
