"""A real PgBouncer in front of a PostgreSQL, on a free port of loopback, configured as it is installed."""

import os
import pwd
import shutil
import subprocess
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import psycopg

from service.postgres import PASSWORD, Postgres
from support.network.free_ports import free_port
from support.running.debian_parts import give_up, require
from support.running.waiting import wait_until

INSTALLED = Path("/etc/pgbouncer/pgbouncer.ini")


@contextmanager
def pooled(postgres: Postgres, pool_mode: str) -> Iterator[int]:
    """Give the port of a PgBouncer that pools sessions or transactions; nothing else differs from the installed one."""
    program = require("pgbouncer", "pgbouncer")
    if not INSTALLED.is_file():
        give_up(f"{INSTALLED} is missing: apt-get install pgbouncer")
    folder, port = Path(tempfile.mkdtemp(prefix="beamtouch-pgbouncer-")), free_port()
    try:
        (folder / "users").write_text(f'"beamtouch" "{PASSWORD}"\n')
        shutil.copy(INSTALLED, folder / "installed.ini")
        settings = {
            "listen_addr": "127.0.0.1",
            "listen_port": port,
            "auth_file": folder / "users",
            "logfile": folder / "log",
            "pidfile": folder / "pid",
            "unix_socket_dir": "",
            "pool_mode": pool_mode,
        }
        lines = [f"%include {folder / 'installed.ini'}", "[databases]", f"* = host=127.0.0.1 port={postgres.port}"]
        lines += ["[pgbouncer]", *(f"{name} = {value}" for name, value in settings.items())]
        (folder / "pgbouncer.ini").write_text("\n".join(lines) + "\n")
        user: list[str] = []
        if os.geteuid() == 0:
            user = ["setpriv", "--reuid=postgres", "--regid=postgres", "--clear-groups"]
            account = pwd.getpwnam("postgres")
            for path in (folder, *folder.iterdir()):
                os.chown(path, account.pw_uid, account.pw_gid)
        process = subprocess.Popen(
            [*user, program, folder / "pgbouncer.ini"], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, cwd="/"
        )
        try:
            wait_until(lambda: _answers(port))
            yield port
        finally:
            process.terminate()
            process.wait(60)
    finally:
        shutil.rmtree(folder)


def _answers(port: int) -> bool:
    url = f"postgresql://beamtouch:{PASSWORD}@127.0.0.1:{port}/postgres"
    try:
        psycopg.connect(url, connect_timeout=2).close()
    except psycopg.OperationalError:
        return False
    return True
