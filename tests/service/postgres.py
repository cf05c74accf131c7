"""A real PostgreSQL on a free port of loopback, in a folder of its own."""

import os
import pwd
import re
import secrets
import shutil
import signal
import subprocess
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import psycopg

from support.network.free_ports import free_port
from support.running.debian_parts import give_up
from support.running.waiting import wait_until

PASSWORD = "horse-and-battery"  # noqa: S105  # of these tests only


class Postgres:
    """A server that can be stopped, killed, frozen and started again."""

    def __init__(self, programs: Path, folder: Path) -> None:
        self._programs, self._data = programs, folder / "data"
        self._as_user = ["setpriv", "--reuid=postgres", "--regid=postgres", "--clear-groups"] if _is_root() else []
        self._process: subprocess.Popen[bytes] | None = None
        self.port = free_port()
        word = folder / "password"
        word.write_text(PASSWORD)
        options = (
            "-U",
            "beamtouch",
            "-A",
            "scram-sha-256",
            f"--pwfile={word}",
            "--no-sync",
            "--locale=C",
            "-E",
            "UTF8",
        )
        self._run("initdb", "-D", self._data, *options)

    def start(self) -> None:
        """Start the server, and wait until it takes connections."""
        settings = {"listen_addresses": "127.0.0.1", "port": self.port, "unix_socket_directories": "", "fsync": "off"}
        options = [word for name, value in settings.items() for word in ("-c", f"{name}={value}")]
        self._process = subprocess.Popen(
            [*self._as_user, self._programs / "postgres", "-D", self._data, *options],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            cwd="/",
        )
        wait_until(self._answers)

    def stop(self, how: signal.Signals = signal.SIGINT) -> None:
        """Stop the server at once; SIGQUIT leaves what a crash leaves."""
        if self._process is not None:
            self._process.send_signal(how)
            self._process.wait(60)
            self._process = None

    def create(self) -> str:
        """Return the URL of a new database."""
        name = f"d{secrets.token_hex(6)}"
        with psycopg.connect(self.url("postgres"), autocommit=True) as connection:
            connection.execute(f"CREATE DATABASE {name}".encode())
        return self.url(name)

    def url(self, database: str) -> str:
        """Return the URL of a database."""
        return f"postgresql://beamtouch:{PASSWORD}@127.0.0.1:{self.port}/{database}"

    def _answers(self) -> bool:
        try:
            psycopg.connect(self.url("postgres"), connect_timeout=2).close()
        except psycopg.OperationalError:
            return False
        return True

    def _run(self, program: str, *words: str | Path) -> None:
        done = subprocess.run(
            [*self._as_user, self._programs / program, *words], capture_output=True, text=True, cwd="/", check=False
        )
        assert done.returncode == 0, done.stdout + done.stderr


def at_port(url: str, port: int) -> str:
    """Return the URL of the same database at another port."""
    return re.sub(r":\d+/", f":{port}/", url)


def rows(url: str, query: str) -> list[tuple[Any, ...]]:
    """Return what another program reads in a database."""
    with psycopg.connect(url) as connection:
        return connection.execute(query.encode()).fetchall()


@contextmanager
def running() -> Iterator[Postgres]:
    """Give a server that runs, without tables; its folder is removed at the end."""
    programs = sorted(Path("/usr/lib/postgresql").glob("*/bin/initdb"))
    if not programs:
        give_up("PostgreSQL is not installed: apt-get install postgresql")
    folder = Path(tempfile.mkdtemp(prefix="beamtouch-postgres-"))
    try:
        if _is_root():
            user = pwd.getpwnam("postgres")
            os.chown(folder, user.pw_uid, user.pw_gid)
        server = Postgres(programs[-1].parent, folder)
        server.start()
        try:
            yield server
        finally:
            server.stop(signal.SIGQUIT)
    finally:
        shutil.rmtree(folder)


def _is_root() -> bool:
    return os.geteuid() == 0
