"""A real process that has no file descriptor left."""

import resource
import signal
import socket
import time
from contextlib import ExitStack
from pathlib import Path

import httpx2
import pytest

from service.bench import batch_of
from service.process.conftest import Service, StartService
from service.process.connections import read_to_end
from service.process.modbus_service import start_modbus
from support.network.plain_http import TIMEOUT_S

SPARE = 8
"""Descriptors that are left when the test begins."""
RESUMED_S = 1.5
"""asyncio accepts no connection for a second after one for which there was no descriptor."""


def open_files(service: Service) -> list[Path]:
    """Return a path for each descriptor of a service."""
    return list(Path(f"/proc/{service.process.pid}/fd").iterdir())


@pytest.mark.promise("docs/reference/http.md", "new ones are closed at once; logged once a minute")
@pytest.mark.parametrize("door", ["http", "modbus"])
def test_connections_beyond_the_descriptors_are_closed_and_the_others_answered(
    start_press: StartService, door: str
) -> None:
    modbus = start_modbus(start_press, "")
    service = modbus.http
    port = service.port if door == "http" else modbus.port
    with httpx2.Client(trust_env=False, timeout=TIMEOUT_S) as before, ExitStack() as stack:
        assert before.get(f"{service.url}/health/live").status_code == 200
        _, hard = resource.prlimit(service.process.pid, resource.RLIMIT_NOFILE)
        resource.prlimit(service.process.pid, resource.RLIMIT_NOFILE, (len(open_files(service)) + SPARE, hard))

        others = [stack.enter_context(socket.create_connection(("127.0.0.1", port))) for _ in range(SPARE + 20)]
        assert read_to_end(others[-1]) == b""
        assert before.get(f"{service.url}/health/live").status_code == 200
        for other in others:
            other.close()
        time.sleep(RESUMED_S)
        assert service.post(batch_of(sequence=1)).status_code == 200

    code, errors = service.stop(signal.SIGTERM)
    assert code == 0
    assert "Traceback" not in errors
    assert errors.count("this process has no file descriptor left") == 1
