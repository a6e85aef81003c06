"""The station's history: every unit, attempt, number, finding and artefact, in one database.

SQLite in WAL mode by default; any URL that SQLAlchemy takes works the same (PostgreSQL).

A run is entered as ``RUNNING`` when it starts and written whole in one transaction when it ends.
What is left ``RUNNING`` by a killed process or a power cut is marked ``ABORTED`` by the next run or
look: on this host when its process is gone, from other hosts when its lease has run out.
"""

from __future__ import annotations

import os
import socket
import uuid
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any, Literal

from sqlalchemy import (
    DateTime,
    Engine,
    ForeignKey,
    Index,
    create_engine,
    event,
    func,
    select,
    text,
    update,
)
from sqlalchemy.exc import ArgumentError, DBAPIError
from sqlalchemy.orm import DeclarativeBase, Mapped, Session, mapped_column, relationship

from imu_cli.line.errors import HistoryError

Outcome = Literal["RUNNING", "PASS", "FAIL", "ERROR", "ABORTED"]
LEASE = timedelta(minutes=30)


class Base(DeclarativeBase):
    """Declarative base of the history's tables."""


class Run(Base):
    """One attempt at one unit."""

    __tablename__ = "runs"
    __table_args__ = (
        # Two stations that start the same unit at the same moment: the second is refused.
        Index(
            "one_run_at_a_time",
            "serial_number",
            unique=True,
            sqlite_where=text("outcome = 'RUNNING'"),
            postgresql_where=text("outcome = 'RUNNING'"),
        ),
    )

    id: Mapped[str] = mapped_column(primary_key=True)
    serial_number: Mapped[str] = mapped_column(index=True)
    attempt: Mapped[int]
    station: Mapped[str] = mapped_column(index=True)
    fixture: Mapped[str]
    operator: Mapped[str]
    tool_version: Mapped[str]
    host: Mapped[str]
    process: Mapped[int]
    process_start: Mapped[str]
    started: Mapped[datetime] = mapped_column(DateTime(timezone=True))
    lease: Mapped[datetime] = mapped_column(DateTime(timezone=True))
    ended: Mapped[datetime | None] = mapped_column(DateTime(timezone=True))
    outcome: Mapped[str] = mapped_column(index=True)
    reason: Mapped[str] = mapped_column(default="")
    parameters: Mapped[list[ParameterRow]] = relationship(cascade="all, delete-orphan")
    checks: Mapped[list[CheckRow]] = relationship(cascade="all, delete-orphan")
    findings: Mapped[list[FindingRow]] = relationship(cascade="all, delete-orphan")
    artefacts: Mapped[list[ArtefactRow]] = relationship(cascade="all, delete-orphan")


class ParameterRow(Base):
    """One number of one run."""

    __tablename__ = "parameters"

    run_id: Mapped[str] = mapped_column(ForeignKey("runs.id"), primary_key=True)
    name: Mapped[str] = mapped_column(primary_key=True)
    value: Mapped[float]
    standard_error: Mapped[float | None]
    unit: Mapped[str]


class CheckRow(Base):
    """One limit held against one run."""

    __tablename__ = "checks"

    run_id: Mapped[str] = mapped_column(ForeignKey("runs.id"), primary_key=True)
    position: Mapped[int] = mapped_column(primary_key=True)
    name: Mapped[str]
    value: Mapped[float | None]
    low: Mapped[float | None]
    high: Mapped[float | None]
    unit: Mapped[str]
    passed: Mapped[bool]
    action: Mapped[str]


class FindingRow(Base):
    """One finding of the diagnosis of one run."""

    __tablename__ = "findings"

    run_id: Mapped[str] = mapped_column(ForeignKey("runs.id"), primary_key=True)
    position: Mapped[int] = mapped_column(primary_key=True)
    effect: Mapped[str]
    p_value: Mapped[float | None]
    action: Mapped[str]


class ArtefactRow(Base):
    """One file that a run made."""

    __tablename__ = "artefacts"

    run_id: Mapped[str] = mapped_column(ForeignKey("runs.id"), primary_key=True)
    name: Mapped[str] = mapped_column(primary_key=True)
    path: Mapped[str]
    sha256: Mapped[str]


@dataclass
class RunResult:
    """Everything that ends up in the history when a run ends."""

    outcome: Outcome
    reason: str = ""
    parameters: list[ParameterRow] = field(default_factory=list)
    checks: list[CheckRow] = field(default_factory=list)
    findings: list[FindingRow] = field(default_factory=list)
    artefacts: list[ArtefactRow] = field(default_factory=list)


class History:
    """The database of one or more stations."""

    def __init__(self, url: str) -> None:
        self.url = url
        self._engine = _connect(url)

    def close(self) -> None:
        """Let go of the database."""
        self._engine.dispose()

    @contextmanager
    def session(self) -> Iterator[Session]:
        """Give one transaction: committed at the end, rolled back on an error."""
        try:
            with Session(self._engine, expire_on_commit=False) as session, session.begin():
                yield session
        except DBAPIError as error:
            raise HistoryError(f"the history {self.url} refused: {error.orig}") from error

    def begin(
        self,
        *,
        serial_number: str,
        station: str,
        fixture: str,
        operator: str,
        tool_version: str,
        now: datetime,
    ) -> Run:
        """Enter a run as ``RUNNING``; first mark the station's dead ones as ``ABORTED``.

        Raises
        ------
        HistoryError
            If this unit is being run right now, here or at another station.
        """
        self.abort_dead(now=now)
        with self.session() as session:
            mine = select(Run).where(Run.serial_number == serial_number)
            busy = session.scalars(mine.where(Run.outcome == "RUNNING")).first()
            if busy is not None:
                raise HistoryError(
                    f"unit {serial_number} is being run now at station {busy.station} "
                    f"(process {busy.process} on {busy.host}, since {busy.started:%H:%M:%S} UTC)"
                )
            attempts = session.scalar(
                select(func.max(Run.attempt)).where(Run.serial_number == serial_number)
            )
            run = Run(
                id=uuid.uuid4().hex,
                serial_number=serial_number,
                attempt=(attempts or 0) + 1,
                station=station,
                fixture=fixture,
                operator=operator,
                tool_version=tool_version,
                host=socket.gethostname(),
                process=os.getpid(),
                process_start=process_start(os.getpid()),
                started=now,
                lease=now + LEASE,
                outcome="RUNNING",
            )
            session.add(run)
        return run

    def end(self, run: Run, result: RunResult, *, now: datetime) -> None:
        """Write a run's end, whole or not at all."""
        with self.session() as session:
            row = session.get_one(Run, run.id)
            row.outcome, row.reason, row.ended = result.outcome, result.reason, now
            row.parameters = result.parameters
            row.checks = result.checks
            row.findings = result.findings
            row.artefacts = result.artefacts

    def abort_dead(self, *, now: datetime) -> int:
        """Mark runs whose process is gone as ``ABORTED``; return how many."""
        host = socket.gethostname()
        with self.session() as session:
            dead = [
                run.id
                for run in session.scalars(select(Run).where(Run.outcome == "RUNNING"))
                if _is_dead(run, host=host, now=now)
            ]
            if dead:
                session.execute(
                    update(Run)
                    .where(Run.id.in_(dead), Run.outcome == "RUNNING")
                    .values(
                        outcome="ABORTED", ended=now, reason="its process ended before the run did"
                    )
                )
        return len(dead)

    def runs(self, *, serial_number: str | None = None, station: str | None = None) -> list[Run]:
        """Return runs in the order in which they started, with everything that belongs to them."""
        query = select(Run).order_by(Run.started, Run.id)
        if serial_number is not None:
            query = query.where(Run.serial_number == serial_number)
        if station is not None:
            query = query.where(Run.station == station)
        with self.session() as session:
            found = list(session.scalars(query))
            for run in found:  # load before the session ends
                _ = run.parameters, run.checks, run.findings, run.artefacts
            return found


def process_start(process: int) -> str:
    """Return when a process started, by the kernel: a process number alone may be used again."""
    try:
        stat = Path(f"/proc/{process}/stat").read_text(encoding="ascii")
    except OSError:
        return ""
    return stat.rpartition(")")[2].split()[19]


def _is_dead(run: Run, *, host: str, now: datetime) -> bool:
    lease = run.lease if run.lease.tzinfo else run.lease.replace(tzinfo=UTC)
    if run.host != host:
        return now > lease
    if run.process_start:
        return process_start(run.process) != run.process_start
    try:
        os.kill(run.process, 0)
    except ProcessLookupError:
        return True
    except OSError:
        return now > lease
    return False


_CREATION = 0x696D7563  # "imuc": who holds this lock of the database creates the tables


def _connect(url: str) -> Engine:
    try:
        engine = create_engine(url, connect_args=_arguments(url))
    except (ArgumentError, ModuleNotFoundError) as error:
        raise HistoryError(
            f"{url!r} is no database that can be opened here ({error}); "
            "expected something like sqlite:///history.db"
        ) from error
    if engine.dialect.name == "sqlite":
        event.listen(engine, "connect", _use_wal)
        event.listen(engine, "begin", _begin_immediate)
    try:
        with engine.begin() as connection:
            if engine.dialect.name == "postgresql":
                # Two stations that open a new history at once would both create its tables.
                connection.execute(select(func.pg_advisory_xact_lock(_CREATION)))
            Base.metadata.create_all(connection)
    except DBAPIError as error:
        engine.dispose()
        raise HistoryError(f"the history {url} cannot be opened: {error.orig}") from error
    return engine


def _arguments(url: str) -> dict[str, Any]:
    return {"timeout": 30} if url.startswith("sqlite") else {}


def _use_wal(connection: Any, _record: Any) -> None:
    connection.isolation_level = None  # transactions begin where `_begin_immediate` says
    cursor = connection.cursor()
    cursor.execute("PRAGMA journal_mode=WAL")
    cursor.execute("PRAGMA synchronous=FULL")
    cursor.execute("PRAGMA foreign_keys=ON")
    cursor.close()


def _begin_immediate(connection: Any) -> None:
    # Take the write lock at the start: two stations then queue instead of failing half way.
    connection.exec_driver_sql("BEGIN IMMEDIATE")
