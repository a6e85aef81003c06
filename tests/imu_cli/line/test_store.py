"""The history: whole or aborted, never half; two stations do not clash."""

import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from datetime import UTC, datetime, timedelta
from pathlib import Path

import pytest

from imu_cli.line.errors import HistoryError
from imu_cli.line.store import History, ParameterRow, Run, RunResult

NOW = datetime(2026, 1, 2, 3, 4, 5, tzinfo=UTC)


def begin(history: History, serial: str, station: str = "bench-1", now: datetime = NOW) -> Run:
    return history.begin(
        serial_number=serial,
        station=station,
        fixture="cube",
        operator="op",
        tool_version="0",
        now=now,
    )


@pytest.fixture
def url(tmp_path: Path) -> str:
    return f"sqlite:///{tmp_path / 'history.db'}"


def test_a_run_is_read_back_as_written(url: str) -> None:
    history = History(url)
    run = begin(history, "A1")
    parameter = ParameterRow(name="accel.bias.x", value=0.1, standard_error=0.01, unit="m/s²")
    history.end(run, RunResult("PASS", parameters=[parameter]), now=NOW + timedelta(seconds=9))
    (read,) = history.runs(serial_number="A1")
    assert (read.outcome, read.attempt, read.parameters[0].value) == ("PASS", 1, 0.1)
    history.close()


def test_attempts_count_up_per_unit(url: str) -> None:
    history = History(url)
    for _ in range(2):
        history.end(begin(history, "A1"), RunResult("FAIL"), now=NOW)
    history.end(begin(history, "B1"), RunResult("PASS"), now=NOW)
    assert [(r.serial_number, r.attempt) for r in history.runs()].count(("A1", 2)) == 1
    history.close()


def test_a_unit_is_run_by_one_station_at_a_time(url: str) -> None:
    history = History(url)
    begin(history, "A1")
    with pytest.raises(HistoryError, match="being run now at station bench-1"):
        begin(history, "A1", "bench-2")
    begin(history, "A2", "bench-2")
    history.close()


def test_a_killed_run_is_marked_aborted(url: str) -> None:
    code = (
        "import os, signal, sys; from datetime import datetime, UTC\n"
        "from imu_cli.line.store import History\n"
        "h = History(sys.argv[1])\n"
        "h.begin(serial_number='A1', station='bench-1', fixture='', operator='',"
        " tool_version='0', now=datetime.now(UTC))\n"
        "os.kill(os.getpid(), signal.SIGKILL)\n"
    )
    killed = subprocess.run([sys.executable, "-c", code, url], check=False)
    assert killed.returncode == -9
    history = History(url)
    run = begin(history, "A1")
    assert [r.outcome for r in history.runs(serial_number="A1")].count("ABORTED") == 1
    assert run.attempt == 2
    history.close()


def test_stations_write_side_by_side(url: str) -> None:
    History(url).close()

    def station(name: int) -> None:
        history = History(url)
        for unit in range(5):
            run = begin(history, f"{name}-{unit}", f"bench-{name}")
            history.end(run, RunResult("PASS"), now=NOW)
        history.close()

    with ThreadPoolExecutor(4) as pool:
        list(pool.map(station, range(4)))
    history = History(url)
    assert [r.outcome for r in history.runs()] == ["PASS"] * 20
    history.close()


@pytest.mark.parametrize("bad", ["nonsense", "sqlite:////no/such/folder/history.db"])
def test_a_database_that_cannot_be_opened_is_said(bad: str) -> None:
    with pytest.raises(HistoryError, match=r"database|cannot be opened"):
        History(bad)
