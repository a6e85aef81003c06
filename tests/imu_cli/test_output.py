"""What is printed, whatever the data holds and wherever it goes."""

import json
import os
import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner

from imu_cli.app import app

FIXTURES = Path(__file__).resolve().parents[2] / "fixtures"
BENCH = FIXTURES / "bench.csv"


def run(*args: object) -> tuple[int, str, str]:
    result = CliRunner().invoke(app, [str(arg) for arg in args], env={"COLUMNS": "100"})
    assert result.exception is None or isinstance(result.exception, SystemExit)
    return result.exit_code, result.stdout, result.stderr


def test_brackets_in_data_are_no_markup(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    log, cal, other = "[red]a.csv", "[b]a :smile:.cal.json", "[x]b.cal.json"
    text = BENCH.read_text(encoding="utf-8").replace("MPU-6050", "[/x]MPU[bold]")
    assert "# chip: [/x]MPU[bold]\n" in text
    Path(log).write_text(text, encoding="utf-8")
    code, said, _ = run("calibrate", log, "-o", cal, "--note", "by=[/b]me")
    assert code == 0
    for part in ("[/x]MPU[bold]", log, f"written      {cal}", "by: [/b]me"):
        assert part in said
    for words in (("info", log), ("show", cal), ("verify", cal, log)):
        assert run(*words)[0] == 0
    assert "[/x]MPU[bold]" in run("show", cal)[1]
    assert run("calibrate", BENCH, "-o", other)[0] == 0
    code, _, warned = run("compare", cal, other)
    assert code == 0
    assert "[/x]MPU[bold]" in warned
    assert f"wrote {log}.html" in run("report", log, "-o", f"{log}.html")[2]


@pytest.mark.skipif(sys.platform != "linux", reason="names are bytes on Linux")
def test_names_that_are_no_utf_8(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    log, cal = os.fsdecode(b"na\xefve.csv"), os.fsdecode(b"\xe9.json")
    Path(log).write_bytes(BENCH.read_bytes())
    made = [os.fsdecode(b"\xf1" + suffix) for suffix in (b".arrow", b".feather", b".parquet")]
    commands = [
        ("info", log),
        ("calibrate", log, "-o", cal),
        ("calibrate", log, "--json"),
        ("show", cal),
        ("report", log),
        ("report", cal),
        *(("convert", log, "-o", name) for name in made),
        *(("apply", cal, log, "-o", name) for name in made),
        ("info", "--json", *made[:1]),
    ]
    for words in commands:
        done = process(*words)
        assert (done.returncode, b"Traceback" in done.stderr) == (0, False), (words, done.stderr)


def process(
    *args: object, stdout: Any = subprocess.PIPE, **env: str
) -> subprocess.CompletedProcess[bytes]:
    return subprocess.run(
        [sys.executable, "-m", "imu_cli", *map(str, args)],
        stdout=stdout,
        stderr=subprocess.PIPE,
        env={**os.environ, **env},
        check=False,
    )


@pytest.fixture(scope="module")
def cal(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("output") / "a.cal.json"
    assert run("calibrate", BENCH, "-o", path, "--note", "by=Å")[0] == 0
    return path


def test_letters_that_the_terminal_lacks_are_replaced(cal: Path) -> None:
    done = process("show", cal, PYTHONIOENCODING="ascii")
    assert (done.returncode, done.stderr) == (0, b"")
    assert b"35.630 ? 0.073 mg" in done.stdout
    done = process("show", cal, "--json", PYTHONIOENCODING="ascii")
    assert done.returncode == 0
    assert json.loads(done.stdout) == json.loads(cal.read_text(encoding="utf-8"))


@pytest.mark.skipif(not os.path.exists("/dev/full"), reason="Linux has it")
@pytest.mark.parametrize(
    "words", [("show", "{cal}"), ("info", BENCH, "--json"), ("apply", "{cal}", "-"), ("--help",)]
)
def test_a_full_standard_output_is_said(cal: Path, words: tuple[object, ...]) -> None:
    with open("/dev/full", "wb") as full, BENCH.open("rb") as log:
        done = subprocess.run(
            [sys.executable, "-m", "imu_cli", *(str(word).format(cal=cal) for word in words)],
            stdin=log,
            stdout=full,
            stderr=subprocess.PIPE,
            check=False,
        )
    assert done.returncode == 3
    assert done.stderr == b"imu-cal: standard output cannot be written: No space left on device\n"


@pytest.mark.parametrize("width", [30, 40, 60, 72, 79])
def test_a_narrow_window_cuts_no_number(cal: Path, tmp_path: Path, width: int) -> None:
    def numbers(columns: int, *words: object) -> list[str]:
        done = process(*words, COLUMNS=str(columns), PYTHONIOENCODING="utf-8")
        text = done.stdout.decode("utf-8")
        assert "\u2026" not in text.partition("parameter")[2]
        return re.findall(r"[-+]?\d+\.\d+(?:e[-+]\d+)?", text)

    other = tmp_path / "b.cal.json"
    document = json.loads(cal.read_text(encoding="utf-8"))
    other.write_text(json.dumps(document), encoding="utf-8")
    wide = numbers(100, "show", cal)
    narrow = numbers(width, "show", cal)
    assert set(narrow) <= set(wide)
    assert {"0.34941", "0.012034", "0.000094"} <= set(narrow)
    assert {"-22.470", "1.2034"} <= set(narrow) or width < 79
    assert sorted(numbers(width, "compare", cal, other)) == sorted(
        numbers(100, "compare", cal, other)
    )
