"""A real nginx on a free port of loopback. What it does at its paths is lines of its configuration."""

import signal
import socket
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from support.network.free_ports import free_port
from support.running.debian_parts import require
from support.running.waiting import wait_until

_CONFIG = """
daemon off;
user root;
worker_processes 1;
pid {folder}/nginx.pid;
error_log {folder}/nginx.log;
events {{}}
http {{
    access_log off;
    {temporary}
    server {{
        listen 127.0.0.1:{port};
{lines}
    }}
}}
"""
_TEMPORARY = ("client_body", "proxy", "fastcgi", "uwsgi", "scgi")


class Nginx:
    """It keeps its port when it starts again."""

    def __init__(self, folder: Path) -> None:
        self._program = require("nginx", "nginx-light")
        self._folder = folder
        self.port = free_port()
        self.url = f"http://127.0.0.1:{self.port}"
        self._process: subprocess.Popen[bytes] | None = None

    def start(self, lines: str) -> None:
        """Start it with these lines in its only server; what it said before is over."""
        self.stop()
        temporary = "\n    ".join(f"{name}_temp_path {self._folder}/{name};" for name in _TEMPORARY)
        text = _CONFIG.format(folder=self._folder, temporary=temporary, port=self.port, lines=lines)
        path = self._folder / "nginx.conf"
        path.write_text(text)
        command = [self._program, "-p", str(self._folder), "-e", str(self._folder / "nginx.log"), "-c", str(path)]
        self._process = subprocess.Popen(command)
        wait_until(self._listens)

    def stop(self) -> None:
        """End it, and all its connections."""
        if self._process is not None:
            self._process.send_signal(signal.SIGTERM)
            self._process.wait(60)
            self._process = None

    def _listens(self) -> bool:
        with suppress(OSError), socket.create_connection(("127.0.0.1", self.port)):
            return True
        return False


@contextmanager
def nginx_in(folder: Path) -> Iterator[Nginx]:
    """Give an nginx that does not run yet; at the end it is ended."""
    folder.mkdir()
    nginx = Nginx(folder)
    try:
        yield nginx
    finally:
        nginx.stop()
