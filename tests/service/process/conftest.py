"""Real service processes on free ports of loopback."""

import json
import socket
import subprocess
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import httpx2
import pytest

from beamtouch_models import runtime
from service.bench import PATIENT, BuildModel
from service.process.beam_page import Bench
from service.process.broker import broker_in
from service.process.mqtt_line import Line
from support.network.plain_http import NO_TLS, TIMEOUT_S
from support.programs.forked import Forked

COMMAND = "beamtouch_service.cli"
CLI = ("-m", COMMAND)
Process = subprocess.Popen[str] | Forked


class Service:
    """A service process on a free port."""

    def __init__(self, process: Process, first_line: str, token: str) -> None:
        self.process = process
        self.first_line = first_line
        self.token = token
        self.url = first_line.removeprefix("listening on ").strip()
        self.port = int(self.url.rpartition(":")[2])

    def connect(self) -> socket.socket:
        """Return a connection, for requests that are no HTTP or that wait in the middle."""
        return socket.create_connection(("127.0.0.1", self.port), timeout=TIMEOUT_S)

    def get(self, path: str, token: str | None = None) -> httpx2.Response:
        headers = {"Authorization": f"Bearer {token}"} if token else {}
        return httpx2.get(self.url + path, headers=headers, trust_env=False, verify=NO_TLS, timeout=TIMEOUT_S)

    def post(self, body: dict[str, Any] | bytes | Iterator[bytes], surface: str = "press-7") -> httpx2.Response:
        content = json.dumps(body).encode() if isinstance(body, dict) else body
        headers = {"Authorization": f"Bearer {self.token}"}
        url = f"{self.url}/surfaces/{surface}/samples"
        return httpx2.post(url, content=content, headers=headers, trust_env=False, verify=NO_TLS, timeout=TIMEOUT_S)

    def stop(self, signal_number: int) -> tuple[int, str]:
        """Send a signal; return exit code and standard error."""
        self.process.send_signal(signal_number)
        _, errors = self.process.communicate(timeout=60)
        return self.process.wait(), errors


Command = Callable[..., Process]
StartService = Callable[..., Service]


@pytest.fixture
def command(tmp_path: Path) -> Iterator[Command]:
    """A function that forks `beamtouch-service` in the folder of the test, with Python `code` run before it."""
    started: list[Forked] = []

    def start(*arguments: str | Path, code: str = PATIENT) -> Forked:
        started.append(Forked(COMMAND, [str(one) for one in arguments], tmp_path, code))
        return started[-1]

    yield start
    for process in started:
        if process.poll() is None:
            process.kill()
        process.communicate()


def service_of(process: Process, token: str) -> Service:
    """Wait until a process listens."""
    assert process.stdout is not None
    line = process.stdout.readline()
    assert line.startswith("listening on http"), process.communicate()[1]
    return Service(process, line, token)


@pytest.fixture
def start_service(command: Command, token_file: Path) -> StartService:
    def start(*arguments: str | Path, **how: Any) -> Service:  # noqa: ANN401  # as `command`
        process = command("run", "--port", "0", *arguments, **how)
        return service_of(process, token_file.read_text().strip())

    return start


@pytest.fixture
def start_press(
    start_service: StartService, build_model: BuildModel, token_file: Path, read_token_file: Path, tmp_path: Path
) -> StartService:
    """A function that starts a service of press-7, whose samples stay fresh for a minute; `read` is its read token.

    `server` are further lines of its section, and `sections` are further sections of the configuration.
    """

    def start(
        *options: str | Path,
        model: Path | None = None,
        read: str | None = None,
        stale_ms: float = 60_000,
        server: str = "",
        sections: str = "",
        **how: Any,  # noqa: ANN401  # as `command`
    ) -> Service:
        if read is not None:
            read_token_file.write_text(read)
            options += ("--read-token-file", read_token_file)
        surface = f"[surfaces.press-7]\nmodel = '{model or build_model()}'\nstale_ms = {stale_ms}\n"
        text = f"[server]\nwrite_token_file = '{token_file}'\n{server}\n{surface}{sections}\n"
        (tmp_path / "service.toml").write_text(text)
        return start_service("--config", "service.toml", *options, **how)

    return start


@pytest.fixture
def fresh(start_press: StartService) -> Service:
    """A service of the surface press-7 whose samples stay fresh for a minute."""
    return start_press()


@pytest.fixture
def start_bench(start_press: StartService, bench_model: Path) -> Callable[..., Bench]:
    """A function that starts a service of press-7 with the bench model; its samples stay fresh for a minute."""

    def start(*options: str | Path, model: Path = bench_model, sections: str = "") -> Bench:
        return Bench(start_press(*options, model=model, sections=sections), runtime.load(model))

    return start


@pytest.fixture
def line(start_service: StartService, build_model: BuildModel, token_file: Path, tmp_path: Path) -> Iterator[Line]:
    """A broker, and services that send to it."""
    with broker_in(tmp_path) as broker:
        yield Line(broker, tmp_path, start_service, build_model(), token_file)
