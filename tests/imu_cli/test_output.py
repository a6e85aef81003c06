"""What is printed, whatever the data holds and wherever it goes."""

from pathlib import Path

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
