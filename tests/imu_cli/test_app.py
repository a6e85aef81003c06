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


@pytest.mark.parametrize(
    ("raised", "code"), [("KeyboardInterrupt", 130), ("SystemExit(143)", 143), ("ValueError", 1)]
)
@pytest.mark.parametrize("where", ["exec", "set_name"])
def test_an_interrupt_of_what_is_being_imported_ends_with_its_exit_code(
    where: str, raised: str, code: int, tmp_path: Path
) -> None:
    """Dataclasses run `exec`, which `python -m` ended by; `__set_name__` wraps what is raised."""
    (tmp_path / "interrupted.py").write_text(
        "import imu_cli.app as cli\n"
        "class Named:\n"
        "    def __set_name__(self, owner, name):\n"
        f"        raise {raised}\n"
        "def make():\n"
        f"    if {where!r} == 'exec':\n"
        f"        exec('raise {raised}')\n"
        "    class Made:\n"
        "        made = Named()\n"
        "cli.app = make\n"
        "cli.main()\n"
    )
    command = [sys.executable, "-m", "interrupted"]
    paths = os.pathsep.join([str(tmp_path), *sys.path])
    found = subprocess.run(
        command, env={**os.environ, "PYTHONPATH": paths}, check=False, capture_output=True
    )
    assert found.returncode == code
    assert (b"Traceback" in found.stderr) == (code == 1)
