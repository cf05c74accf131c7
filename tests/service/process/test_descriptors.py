"""A real process that has no file descriptor left."""

import resource
import signal
import socket
import time
from contextlib import ExitStack
from pathlib import Path

import httpx2
import pytest

from plain_http import TIMEOUT_S
from service.conftest import batch_of
from service.process.conftest import Service, StartService
from service.process.test_security import told

SPARE = 8
"""Descriptors that are left when the test begins."""
RESUMED_S = 1.5
"""asyncio accepts no connection for a second after one for which there was no descriptor."""
MODBUS = "\n[modbus_server]\nport = 0\n"


def modbus_port(service: Service) -> int:
    """Return the port of the Modbus server, which the operating system has chosen."""
    ports = set()
    for row in Path(f"/proc/{service.process.pid}/net/tcp").read_text().splitlines()[1:]:
        fields = row.split()
        if fields[3] == "0A" and f"socket:[{fields[9]}]" in sockets(service):
            ports.add(int(fields[1].rpartition(":")[2], 16))
    (port,) = ports - {service.port}
    return port


def sockets(service: Service) -> set[str]:
    return {str(one.readlink()) for one in Path(f"/proc/{service.process.pid}/fd").iterdir() if one.is_symlink()}


@pytest.mark.parametrize("door", ["http", "modbus"])
def test_connections_beyond_the_descriptors_are_closed_and_the_others_answered(
    start_press: StartService,
    door: str,  # a case of the test
) -> None:
    service = start_press(sections=MODBUS)
    port = service.port if door == "http" else modbus_port(service)
    with httpx2.Client(trust_env=False, timeout=TIMEOUT_S) as before, ExitStack() as stack:
        assert before.get(f"{service.url}/health/live").status_code == 200
        _, hard = resource.prlimit(service.process.pid, resource.RLIMIT_NOFILE)
        resource.prlimit(service.process.pid, resource.RLIMIT_NOFILE, (len(sockets(service)) + SPARE, hard))

        others = [stack.enter_context(socket.create_connection(("127.0.0.1", port))) for _ in range(SPARE + 20)]
        assert told(others[-1]) == b""
        assert before.get(f"{service.url}/health/live").status_code == 200
        for other in others:
            other.close()
        time.sleep(RESUMED_S)
        assert service.post(batch_of(sequence=1)).status_code == 200

    code, errors = service.stop(signal.SIGTERM)
    assert code == 0
    assert "Traceback" not in errors
    assert errors.count("this process has no file descriptor left") == 1
