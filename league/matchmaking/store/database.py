"""One database, SQLite or PostgreSQL: connections, transactions, and its errors in one sentence.

SQLite has one writer at a time. Each write is one BEGIN IMMEDIATE transaction, written through to
the disk before it returns (WAL, synchronous=FULL). A process that finds the file locked tries
again every few milliseconds, which is fairer than SQLite's own waiting (up to 100 ms between
tries, measured 1.5 s at the median with 16 writers). In a large league one process should write,
and its workers get heats from it and hand results to it.
"""

import os
import random
import re
import sqlite3
import threading
import time
from collections.abc import Callable, Generator
from contextlib import AbstractContextManager, contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import sqlalchemy as sa
from sqlalchemy import event, exc
from sqlalchemy.engine import URL, make_url

from league.errors import DatabaseError, StoreError, brief

if TYPE_CHECKING:
    from _typeshed import DataclassInstance

_Data = TypeVar("_Data", bound="DataclassInstance")
PATIENCE_S = 60.0  # how long a write waits for other writers of a SQLite file [s]
MOST_ASKED = 5000  # values that one statement asks for at most; SQLite allows 32,766 parameters
ALONE = 0x1EA60E  # PostgreSQL's advisory lock for transactions that must run one at a time


def address(url: str) -> URL:
    """Return a league's URL, checked; a bare path is taken for a SQLite file."""
    text = url if "://" in url else f"sqlite:///{url}"
    try:
        parsed = make_url(text)
    except (exc.ArgumentError, ValueError) as refusal:
        raise StoreError(
            f"{brief(url)} is no address of a league: give sqlite:///league.db or postgresql://..."
        ) from refusal
    if parsed.get_backend_name() == "postgresql":
        return parsed.set(drivername="postgresql+psycopg")
    if parsed.get_backend_name() != "sqlite":
        raise StoreError(
            f"a league in {parsed.get_backend_name()} was asked for: "
            "give sqlite:///league.db or postgresql://..."
        )
    if "?" in text:  # what follows would be parameters, and the file another one
        raise StoreError(f"{brief(url)} has a question mark in it: give a file without one")
    if not parsed.database or parsed.database == ":memory:":
        raise StoreError(f"{brief(url)} names no file: give sqlite:///league.db")
    return parsed.set(drivername="sqlite")


class Database:
    """Connections to one database; not shared across a fork."""

    def __init__(self, url: str, clock: Callable[[], float] | None = None) -> None:
        """Prepare to connect to an `address`; nothing is opened yet.

        `clock` returns the time [s]; by default it is the database server's, so that machines with
        wrong clocks agree about leases.
        """
        self.url = address(url)
        self.shown = self.url.set(drivername=self.url.get_backend_name()).render_as_string()
        self.is_sqlite = self.url.get_backend_name() == "sqlite"
        self._clock = clock
        self._jitter = random.Random()
        self._pid = os.getpid()
        self._shared = threading.local()
        """Of each thread: the connection of `reading_at_once`, if it goes on."""
        try:
            self._engine = sa.create_engine(self.url, pool_pre_ping=not self.is_sqlite)
        except ModuleNotFoundError as missing:
            raise StoreError(
                f"{missing.name} is not installed, which a league on PostgreSQL needs: "
                'run pip install "racing-league[postgres]"'
            ) from missing
        if self.is_sqlite:
            event.listen(self._engine, "connect", _prepare)
            event.listen(self._engine, "begin", self._begin)

    @property
    def path(self) -> Path | None:
        """The SQLite file."""
        return Path(self.url.database or "") if self.is_sqlite else None

    def reading(self) -> AbstractContextManager[sa.Connection]:
        """Yield a connection that sees one state of the database throughout."""
        shared: sa.Connection | None = getattr(self._shared, "connection", None)
        if shared is not None:
            return self._joined(shared)
        return self._begun(**({} if self.is_sqlite else {"isolation_level": "REPEATABLE READ"}))

    @contextmanager
    def reading_at_once(self) -> Generator[None]:
        """Let all that this thread reads meanwhile see one state of the database."""
        with self.reading() as connection:
            before = getattr(self._shared, "connection", None)
            self._shared.connection = connection
            try:
                yield
            finally:
                self._shared.connection = before

    def writing(self) -> AbstractContextManager[sa.Connection]:
        """Yield a connection; all its changes are on the disk when this ends without an error."""
        return self._begun(writes=True)

    @contextmanager
    def _joined(self, shared: sa.Connection) -> Generator[sa.Connection]:
        with self._translated():
            yield shared

    @contextmanager
    def _begun(self, **options: Any) -> Generator[sa.Connection]:  # noqa: ANN401
        with self._translated(), self._engine.connect() as plain:
            connection = plain.execution_options(**options)
            with connection.begin():
                yield connection

    def use_wal(self) -> None:
        """Make the SQLite file keep a write-ahead log, for good."""
        with self._translated(), self._engine.connect() as connection:
            raw: Any = connection.connection.dbapi_connection
            raw.execute("PRAGMA journal_mode = WAL").fetchall()

    def lock(self, connection: sa.Connection) -> None:
        """Exclude other locked transactions until this one ends; SQLite's always exclude."""
        if not self.is_sqlite:
            connection.execute(sa.select(sa.func.pg_advisory_xact_lock(ALONE)))

    def now(self, connection: sa.Connection) -> float:
        """Return the time [s since 1970]."""
        if self._clock is not None:
            return self._clock()
        if self.is_sqlite:
            return time.time()
        asked: Any = sa.select(sa.extract("epoch", sa.func.clock_timestamp()))
        return float(connection.execute(asked).scalar_one())

    def close(self) -> None:
        """Close all connections; may be called twice."""
        self._engine.dispose(close=os.getpid() == self._pid)

    def _begin(self, connection: sa.Connection) -> None:
        if not connection.get_execution_options().get("writes"):
            connection.exec_driver_sql("BEGIN")
            return
        raw: Any = connection.connection.dbapi_connection
        give_up = time.monotonic() + PATIENCE_S
        raw.execute("PRAGMA busy_timeout = 0")
        try:
            while True:
                try:
                    raw.execute("BEGIN IMMEDIATE")
                    return
                except sqlite3.OperationalError as refusal:
                    busy = refusal.sqlite_errorcode & 0xFF == sqlite3.SQLITE_BUSY
                    if not busy:
                        raise
                    if time.monotonic() > give_up:
                        raise DatabaseError(
                            f"another program has been writing to {self.shown} for "
                            f"{PATIENCE_S:.0f} s: end it, or try again later"
                        ) from refusal
                time.sleep(self._jitter.uniform(0.0005, 0.004))
        finally:
            raw.execute("PRAGMA busy_timeout = 10000")

    @contextmanager
    def _translated(self) -> Generator[None]:
        if os.getpid() != self._pid:
            raise StoreError(
                f"{self.shown} was opened before this process was forked: "
                "open the league again in each process"
            )
        try:
            yield
        except exc.DBAPIError as refusal:
            raise DatabaseError(f"{self.shown} {_sentence(refusal.orig)}") from refusal
        except sqlite3.Error as refusal:
            raise DatabaseError(f"{self.shown} {_sentence(refusal)}") from refusal
        except exc.TimeoutError as refusal:
            raise DatabaseError(
                f"{self.shown} is in use by too many threads at once: use fewer"
            ) from refusal


def made_of(cls: type[_Data], row: sa.Row[Any], **given: object) -> _Data:
    """Return frozen data with the fields of a row, apart from those that are given."""
    names = [name for name in cls.__dataclass_fields__ if name not in given]
    return cls(**{name: getattr(row, name) for name in names}, **given)


def chunked(
    connection: sa.Connection,
    query: sa.Select[*tuple[Any, ...]],
    column: sa.ColumnElement[Any],
    values: list[Any],
) -> list[Any]:
    """Return the rows in which a column has one of many values, `MOST_ASKED` at a time."""
    asked = sa.bindparam("asked", expanding=True)
    return asked_for(connection, query.where(column.in_(asked)), values)


def asked_for(connection: sa.Connection, query: sa.Select[Any], values: list[Any]) -> list[Any]:
    """Return the rows of a query, giving its list `asked` up to `MOST_ASKED` values at a time."""
    rows: list[Any] = []
    for start in range(0, len(values), MOST_ASKED):
        rows += connection.execute(query, {"asked": values[start : start + MOST_ASKED]}).all()
    return rows


def _prepare(raw: Any, _record: object) -> None:  # noqa: ANN401
    raw.isolation_level = None  # transactions begin where we say
    for setting in ("busy_timeout = 10000", "synchronous = FULL", "foreign_keys = ON"):
        raw.execute(f"PRAGMA {setting}")


_MEANINGS = {
    "SQLITE_FULL": "cannot grow, the disk is full: free some space; nothing was changed",
    "SQLITE_IOERR": "cannot be written or read ({reason}): check the disk and its free space; "
    "nothing was changed",
    "SQLITE_NOTADB": "is no SQLite database: give a league's file",
    "SQLITE_CORRUPT": "is damaged ({reason}): restore it from a backup",
    "SQLITE_READONLY": "can only be read: make the file and its folder writable",
    "SQLITE_CANTOPEN": "cannot be opened: check that the folder exists and may be entered",
    "SQLITE_BUSY": "is locked by another program: end it, or try again later",
    "SQLITE_PERM": "may not be opened: check the file's permissions",
    "SQLITE_AUTH": "may not be opened: check the file's permissions",
    # PostgreSQL
    "53100": "cannot grow, the server's disk is full: free some space; nothing was changed",
    "3D000": "names a database that does not exist: make it with createdb",
    "28P01": "refused the password: check the user and password in the address",
    "28000": "refused the user: check the user in the address and the server's pg_hba.conf",
    "42501": "refuses this user ({reason}): grant the rights, or use another user",
    "57P01": "is shutting down: try again when the server runs; nothing was changed",
    "57P02": "has crashed: look at the server's log, and try again when it runs",
    "57P03": "is starting or recovering: try again in a moment",
    "25006": "can only be read ({reason}): use the primary server",
    "58030": "cannot be written or read ({reason}): check the server's disk; nothing was changed",
    "53300": "has no free connections: use fewer workers, or raise max_connections",
}
"""What names of SQLite's errors, or their beginnings, and SQLSTATEs mean."""

_REFUSALS = {
    "password authentication failed|no password supplied": "28P01",
    'no pg_hba.conf entry|role ".*" (does not exist|is not permitted to log in)': "28000",
    'database ".*" does not exist': "3D000",
    "permission denied for database": "42501",
    "too many (clients|connections)|connection slots are reserved": "53300",
    "shutting down": "57P01",
    "starting up|in recovery mode": "57P03",
}
"""Messages of refused connections (patterns), which carry no SQLSTATE, with the one they mean."""


def _sentence(refusal: BaseException | None) -> str:
    """Return what happened and how to mend it, to follow the database's address."""
    first = str(refusal).strip().splitlines()
    reason = " ".join((first[0] if first else type(refusal).__name__).split())[:200]
    code = getattr(refusal, "sqlite_errorname", None) or getattr(refusal, "sqlstate", None)
    if code is None and "FATAL:" in reason:
        said = reason.split("FATAL:", 1)[1]
        code = next((state for text, state in _REFUSALS.items() if re.search(text, said)), None)
    if code is None:
        meaning = "cannot be reached ({reason}): check the address and that the server runs"
    else:
        unknown = "refused the request ({reason}): look at the cause above"
        known = (text for start, text in _MEANINGS.items() if code.startswith(start))
        meaning = next(known, unknown)
    return meaning.format(reason=reason)
