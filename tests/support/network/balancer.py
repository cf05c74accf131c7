"""A real HAProxy with the configuration of `deploy/`, on free ports of loopback."""

import re
import signal
import subprocess
from collections.abc import Sequence
from pathlib import Path

import httpx2

from support.network.free_ports import free_port
from support.network.plain_http import TIMEOUT_S
from support.running.debian_parts import require
from support.running.waiting import wait_until

CONFIG = Path(__file__).parents[3] / "deploy" / "haproxy.cfg"
_SERVER = re.compile(r"^    server \S+ \S+ check\n", re.MULTILINE)
_RULES = "    # The query form"


class Balancer:
    """HAProxy in front of services on these ports.

    With `check_s`, it waits so long for the answer to a check: after 250 ms, as configured, a service that a starved
    machine holds up counts as dead, and its surfaces move. `lines` come before all rules of the frontend.
    """

    def __init__(self, folder: Path, ports: Sequence[int], check_s: int | None = None, lines: str = "") -> None:
        self._program = require("haproxy", "haproxy")
        self._path = folder / "haproxy.cfg"
        port = free_port()
        self.url = f"http://127.0.0.1:{port}"
        servers = "".join(f"    server s{number} 127.0.0.1:{port} check\n" for number, port in enumerate(ports))
        text = _SERVER.sub("@", CONFIG.read_text().replace("127.0.0.1:8420", f"127.0.0.1:{port}"))
        if check_s is not None:
            text, found = re.subn(r"(?<=timeout check )\S+", f"{check_s}s", text)
            assert found == 1
        assert text.count(_RULES) == 1
        text = text.replace(_RULES, f"{lines}{_RULES}")
        self._path.write_text(re.sub("@+", lambda _: servers, text))
        self._process: subprocess.Popen[bytes] | None = None

    def start(self) -> None:
        """Start it, and wait until a service answers behind it."""
        quiet = subprocess.DEVNULL
        self._process = subprocess.Popen([self._program, "-f", self._path], stdin=quiet, stdout=quiet, stderr=quiet)
        wait_until(lambda: answers(self.url))

    def stop(self) -> None:
        """End it at once."""
        if self._process is not None:
            self._process.send_signal(signal.SIGTERM)
            self._process.wait(60)
            self._process = None


def answers(url: str) -> bool:
    """Return whether a service answers at an address."""
    try:
        return httpx2.get(f"{url}/health/live", trust_env=False, timeout=TIMEOUT_S).is_success
    except httpx2.TransportError:
        return False
