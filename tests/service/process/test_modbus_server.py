"""The Modbus TCP server as a process: a client of others, and what clients may do to it and to each other."""

import math
import re
import select
import signal
import socket
import subprocess
import threading
import time
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack, suppress
from pathlib import Path

import pytest

from contact_registers import FIGURES, USED, decoded, expected
from parts import require
from processes import resident_mb
from service.conftest import batch_of
from service.event_story import RESTING, TOUCHING
from waiting import wait_until

from .conftest import StartService
from .modbus_service import ModbusService, answered, ask, request, start_modbus

IDLE_S, PERIOD_S = 5.0, 0.1
"""Of a connection without a request, and of a controller, which a starved machine may hold up for some seconds."""
MAX_GROWTH_MB, MAX_SENT_BYTES = 30.0, 100_000_000
STALE = 18
NOT_MODBUS = [b"GET /contact HTTP/1.1\r\nHost: x\r\n\r\n", b"\0\1\0\5\0\6" + bytes(6), b"\x16\x03\x01" * 9]

pytestmark = pytest.mark.usefixtures("token_file")


@pytest.fixture
def server(start_service: StartService, tmp_path: Path) -> ModbusService:
    """A server for four clients; press-7 has a contact."""
    service = start_modbus(start_service, tmp_path, "max_clients = 4")
    assert service.http.post(batch_of()).status_code == 200
    return service


def polled(port: int, *options: str) -> list[str]:
    """Return the values that mbpoll prints, a client on libmodbus."""
    command = [require("mbpoll", "mbpoll"), "-m", "tcp", "-p", str(port), "-0", "-1", "-o", "10", *options, "127.0.0.1"]
    done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=60)
    assert done.returncode == 0, done.stdout + done.stderr
    return re.findall(r"^\[\d+\]:\s+(\S+)", done.stdout, re.MULTILINE)


@pytest.mark.parametrize(("word_order", "floats"), [("big", ["-B"]), ("little", [])])
def test_a_client_of_others_reads_the_contacts_and_that_they_are_stale(
    start_service: StartService, tmp_path: Path, word_order: str, floats: list[str]
) -> None:
    server = start_modbus(start_service, tmp_path, f'word_order = "{word_order}"')

    def block() -> list[int]:
        return [int(word) for word in polled(server.port, "-t", "3", "-r", "0", "-c", str(USED))]

    def figures() -> list[float]:
        return [float(one) for one in polled(server.port, "-t", "3:float", *floats, "-r", "8", "-c", str(len(FIGURES)))]

    for sequence, row in enumerate([RESTING, TOUCHING], start=1):
        server.http.post(batch_of(row, sequence=sequence))
        contact = server.http.get("/surfaces/press-7/contact").json()
        assert decoded(block(), ["s1", "s2", "s3"], word_order) == expected(contact)
        said = [contact[name] if contact[name] is not None else math.nan for name in FIGURES]
        assert figures() == pytest.approx(said, rel=1e-5, nan_ok=True)
    server.http.post(batch_of(TOUCHING, sequence=3, age_ms=59_900.0))
    wait_until(lambda: block()[2] == STALE)
    assert all(map(math.isnan, figures()))


def test_requests_that_arrive_together_or_in_pieces_are_all_answered_in_order(server: ModbusService) -> None:
    words = b"".join(request(number % 100, 1, number) for number in range(500))
    with server.connected() as connection:
        sending = threading.Thread(target=connection.sendall, args=(words,))
        sending.start()
        together = [answered(connection) for _ in range(500)]
        sending.join()
        for place in range(60):
            connection.sendall(words[place : place + 1])
        pieces = [answered(connection) for _ in range(5)]

    assert [int.from_bytes(answer[:2]) for answer in together] == list(range(500))
    assert {len(answer) for answer in together} == {11}
    assert [int.from_bytes(answer[:2]) for answer in pieces] == list(range(5))


def test_a_request_that_is_refused_leaves_the_connection_open(server: ModbusService) -> None:
    refused = [request(0, 1, function=function) for function in (1, 3, 5, 6, 15, 16, 23, 43)]
    with server.connected() as connection:
        before = ask(connection, 2, 1)
        for words, exception in [*[(one, 1) for one in refused], (request(100, 1), 2), (request(0, 126), 3)]:
            connection.sendall(words)
            assert answered(connection)[7:] == bytes([words[7] | 0x80, exception])
        assert ask(connection, 2, 1) == before == [2]


def test_what_is_not_modbus_ends_its_connection_after_the_earlier_answers(server: ModbusService) -> None:
    for words in NOT_MODBUS:
        with server.connected() as connection:
            connection.sendall(request(2, 1) + words)
            assert answered(connection)[9:] == b"\x00\x02"
            assert closes(connection)
        assert server.registers(2, 1) == [2]
    code, errors = server.http.stop(signal.SIGTERM)
    assert code == 0
    assert errors.count("not Modbus TCP") == 1
    assert "Traceback" not in errors


def test_a_client_that_ends_its_side_still_gets_its_answers(server: ModbusService) -> None:
    with server.connected() as connection:
        connection.sendall(request(2, 1, 1) + request(2, 1, 2))
        connection.shutdown(socket.SHUT_WR)
        assert [answered(connection)[:2] for _ in range(3)] == [b"\x00\x01", b"\x00\x02", b""]


def test_a_hundred_connections_do_not_disturb_a_controller(start_service: StartService, tmp_path: Path) -> None:
    """Those above the limit are closed; when the others have been silent for too long, there is place again."""
    server = start_modbus(start_service, tmp_path, f"max_clients = 4\nidle_s = {IDLE_S}")
    with ExitStack() as stack:
        controller = stack.enter_context(server.connected())
        crowd = []
        for _ in range(100):
            crowd.append(stack.enter_context(server.connected()))
            # Those that found a place keep it, too.
            for one in (controller, *crowd[:3]):
                assert ask(one, 52, 1) == [16]
        refused = "beamtouch_modbus_connections_refused_total 97.0"
        wait_until(lambda: refused in server.http.get("/metrics").text.splitlines())
        crowd[0].sendall(request(0, 1)[:7])  # half a request is none
        with ThreadPoolExecutor() as pool:
            closed = [pool.submit(closes, one) for one in crowd]
            while not all(one.done() for one in closed):
                assert ask(controller, 52, 1) == [16]
                time.sleep(PERIOD_S)
        assert [one.result() for one in closed] == [True] * 100
        late = stack.enter_context(server.connected())
        assert ask(late, 52, 1) == ask(controller, 52, 1) == [16]
    code, errors = server.http.stop(signal.SIGTERM)
    assert (code, errors.count("too many connections")) == (0, 1)


def test_a_client_that_does_not_read_costs_little_and_is_closed(start_service: StartService, tmp_path: Path) -> None:
    server = start_modbus(start_service, tmp_path, "idle_s = 3.0")
    before_mb = resident_mb(server.http.process.pid)
    with server.connected(timeout_s=1.0, receive_bytes=4096) as connection:
        sent_bytes = flood(connection, request(0, 100) * 1000, MAX_SENT_BYTES)
        assert server.registers(52, 1) == [16]
        assert resident_mb(server.http.process.pid) - before_mb < MAX_GROWTH_MB
        assert sent_bytes < MAX_SENT_BYTES
        assert is_reset(connection)


def closes(connection: socket.socket) -> bool:
    """Say whether the service closes a connection within a minute, without another word."""
    connection.settimeout(60.0)
    try:
        return connection.recv(1) == b""
    except TimeoutError:
        return False
    except ConnectionResetError:
        return True


def flood(connection: socket.socket, words: bytes, max_bytes: int) -> int:
    """Send words again and again until nothing is taken any more; return how many bytes were taken."""
    sent_bytes = 0
    with suppress(OSError):
        while sent_bytes < max_bytes:
            sent_bytes += connection.send(words)
    return sent_bytes


def is_reset(connection: socket.socket) -> bool:
    """Return whether the connection ends within a minute, without reading from it."""
    waiting = select.poll()
    waiting.register(connection, 0)
    return bool(waiting.poll(60_000))


def test_a_stop_ends_all_connections(server: ModbusService) -> None:
    with server.connected() as idle, server.connected() as busy:
        assert ask(busy, 2, 1) == [2]
        assert server.http.stop(signal.SIGTERM)[0] == 0
        assert closes(idle)
        assert closes(busy)


@pytest.mark.usefixtures("read_token_file")
def test_a_server_that_a_read_token_does_not_protect_says_so(start_service: StartService, tmp_path: Path) -> None:
    (tmp_path / "service.toml").write_text('[server]\nread_token_file = "read-token"\n[modbus_server]\nport = 0\n')
    service = start_service("--config", "service.toml")
    assert "no token protects the Modbus TCP server" in service.stop(signal.SIGTERM)[1]
