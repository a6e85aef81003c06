"""The same history on PostgreSQL: a private server in a temporary folder."""

import os
import pwd
import shutil
import subprocess
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from datetime import UTC, datetime
from pathlib import Path

import pytest

from imu_cli.line.errors import HistoryError
from imu_cli.line.store import Base, History, Run, RunResult

NOW = datetime(2026, 1, 2, 3, 4, 5, tzinfo=UTC)
BIN = max(Path("/usr/lib/postgresql").glob("*/bin/initdb"), default=Path("/none")).parent


def as_owner(*command: str) -> list[str]:
    """Run as the server's user: PostgreSQL refuses to run as root."""
    return [*(["runuser", "-u", "postgres", "--"] if os.getuid() == 0 else []), *command]


@pytest.fixture(scope="module")
def url(tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    pytest.importorskip("psycopg", reason="needs psycopg (extra postgres)")
    if not (BIN / "initdb").exists():
        pytest.skip("needs a PostgreSQL server (Debian package postgresql)")
    folder = Path("/tmp") / f"imu-cal-pg-{os.getpid()}"  # a short path: sockets have short names
    folder.mkdir(mode=0o755)
    try:
        if os.getuid() == 0:
            try:
                owner = pwd.getpwnam("postgres")
            except KeyError:
                pytest.skip("needs the user postgres: the server does not run as root")
            os.chown(folder, owner.pw_uid, owner.pw_gid)
        data = str(folder / "data")
        quiet = {"check": True, "capture_output": True, "cwd": folder, "timeout": 120}
        subprocess.run(as_owner(str(BIN / "initdb"), "-D", data, "-A", "trust", "-N"), **quiet)
        options = f"-c listen_addresses= -c unix_socket_directories={folder} -c fsync=off"
        start = [str(BIN / "pg_ctl"), "-D", data, "-w", "-o", options, "-l", f"{folder}/log"]
        subprocess.run(as_owner(*start, "start"), **quiet)
        user = "postgres" if os.getuid() == 0 else pwd.getpwuid(os.getuid()).pw_name
        try:
            yield f"postgresql+psycopg://{user}@/postgres?host={folder}"
        finally:
            stop = [str(BIN / "pg_ctl"), "-D", data, "-m", "immediate", "stop"]
            subprocess.run(as_owner(*stop), **quiet)
    finally:
        shutil.rmtree(folder, ignore_errors=True)


def begin(history: History, serial: str) -> Run:
    return history.begin(
        serial_number=serial,
        station="bench-1",
        fixture="",
        operator="",
        tool_version="0",
        now=NOW,
    )


def test_runs_are_written_and_read_back(url: str) -> None:
    history = History(url)
    history.end(begin(history, "A1"), RunResult("PASS"), now=NOW)
    (run,) = history.runs(serial_number="A1")
    assert (run.outcome, run.started) == ("PASS", NOW)
    history.close()


def test_one_of_two_stations_gets_the_unit(url: str) -> None:
    def start(_: int) -> str:
        history = History(url)
        try:
            return begin(history, "B1").id
        except HistoryError:
            return ""
        finally:
            history.close()

    with ThreadPoolExecutor(4) as pool:
        started = list(pool.map(start, range(4)))
    assert sum(bool(item) for item in started) == 1


def test_stations_that_open_a_new_history_at_once_all_get_it(url: str) -> None:
    first = History(url)
    for _ in range(4):
        Base.metadata.drop_all(first._engine)
        with ThreadPoolExecutor(8) as pool:
            for history in pool.map(lambda _: History(url), range(8)):
                history.close()
    first.close()
