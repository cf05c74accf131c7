"""The Modbus TCP server as a process: a client of others, and what clients may do to it and to each other."""

import math
import re
import select
import signal
import socket
import struct
import subprocess
import threading
import time
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack, suppress

import pytest

from service.bench import Row, batch_of
from service.contact_registers import FIGURES, USED, decoded, expected
from service.event_story import ODD, RESTING, TOUCHING
from support.programs.processes import resident_mb
from support.running.debian_parts import require
from support.running.waiting import wait_until

from .conftest import StartService
from .modbus_service import ModbusService, answered, ask, frame, request, start_modbus

IDLE_S, PERIOD_S = 5.0, 0.1
"""Of a connection without a request, and of a controller, which a starved machine may hold up for some seconds."""
MAX_GROWTH_MB, MAX_SENT_BYTES = 30.0, 100_000_000
STALE = 18
NOT_MODBUS = [b"GET /contact HTTP/1.1\r\nHost: x\r\n\r\n", b"\x16\x03\x01" * 9]
# Other protocols than 0, and lengths that no frame has.
HEADS = ("0001 0006", "8000 0006", "0000 0000", "0000 0001", "0000 00ff")
NOT_MODBUS += [bytes.fromhex(f"0001 {head}") for head in HEADS]
ROWS: list[tuple[Row, list[str]]] = [
    (RESTING, ["good"] * 3),
    (TOUCHING, ["good"] * 3),
    ([2.4, 0.1, 0.05], ["good"] * 3),  # overload
    ([0.5, None, 0.125], ["good", "missing", "good"]),
    (ODD, ["good"] * 3),
]


@pytest.fixture
def server(start_press: StartService) -> ModbusService:
    """A server for four clients; press-7 has a contact."""
    service = start_modbus(start_press, "max_clients = 4")
    assert service.http.post(batch_of()).status_code == 200
    return service


def polled(port: int, *options: str) -> list[str]:
    """Return the values that mbpoll prints, a client on libmodbus."""
    command = [require("mbpoll", "mbpoll"), "-m", "tcp", "-p", str(port), "-0", "-1", "-o", "10", *options, "127.0.0.1"]
    done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=60)
    assert done.returncode == 0, done.stdout + done.stderr
    return re.findall(r"^\[\d+\]:\s+(\S+)", done.stdout, re.MULTILINE)


@pytest.mark.promise(
    "docs/reference/registers.md",
    "Each answer is computed when it is read, as `GET /contact` is.",
    "Word order does not apply to these four registers.",
)
@pytest.mark.parametrize(("word_order", "floats"), [("big", ["-B"]), ("little", [])])
def test_a_client_of_others_reads_the_contacts_and_that_they_are_stale(
    start_press: StartService, word_order: str, floats: list[str]
) -> None:
    server = start_modbus(start_press, f'word_order = "{word_order}"')

    def block() -> list[int]:
        return [int(word) for word in polled(server.port, "-t", "3", "-r", "0", "-c", str(USED))]

    def figures() -> list[float]:
        return [float(one) for one in polled(server.port, "-t", "3:float", *floats, "-r", "8", "-c", str(len(FIGURES)))]

    for number, (row, quality) in enumerate(ROWS):
        sequence = 2**32 + 4 * number
        assert server.http.post(batch_of(*[row] * 4, sequence=sequence, quality=quality)).status_code == 200
        contact = server.http.get("/surfaces/press-7/contact").json()
        # Of the number, the low half.
        said = expected(contact | {"sequence": contact["sequence"] % 2**32})
        assert decoded(block(), ["s1", "s2", "s3"], word_order) == said
        figures_said = [contact[name] if contact[name] is not None else math.nan for name in FIGURES]
        assert figures() == pytest.approx(figures_said, rel=1e-5, nan_ok=True)
    server.http.post(batch_of(TOUCHING, sequence=2**33, age_ms=59_900.0))
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


def asked(address: int, count: int) -> bytes:
    return struct.pack(">BHH", 4, address, count)


REFUSED = [
    *((bytes([function]) + bytes(8), 1) for function in range(256) if function != 4),
    *((asked(address, count), 2) for address, count in ((120, 1), (119, 2), (65_535, 125))),
    *((asked(0, count), 3) for count in (0, 126, 65_535)),
    *((body, 3) for body in (b"\x04", b"\x04\x00\x00\x00", asked(0, 1) + b"\x00")),
]
"""Function and data of requests, each with the exception that the standard wants."""


@pytest.mark.promise(
    "docs/how-to/plc.md",
    "Nobody can write.",
)
@pytest.mark.promise(
    "docs/reference/registers.md",
    (
        "An address behind the last block is answered with exception 2 (illegal data address), a count of 0 or above "
        "125 with 3 (illegal data value), every other function, including all that write, with 1 (illegal function)."
    ),
    "Unit identifier. Any is accepted, and repeated in the answer.",
    "of a block read as 0",
)
def test_a_wrong_request_has_the_exception_of_the_standard_and_leaves_the_connection_open(
    server: ModbusService,
) -> None:
    with server.connected() as connection:
        for place, (body, exception) in enumerate(REFUSED):
            transaction, unit = 1000 + place, place % 256  # any unit is answered, under its own number
            connection.sendall(frame(body, transaction, unit))
            assert answered(connection) == frame(bytes([body[0] | 0x80, exception]), transaction, unit)
        assert ask(connection, 2, 1) == [2]
        whole = ask(connection, 0, 120)
        # A read over the border of two surfaces has each as it is.
        assert ask(connection, 59, 2) == whole[59:61] == [0, ask(connection, 60, 1)[0]]


@pytest.mark.promise(
    "docs/reference/registers.md",
    "the connection is closed after the earlier answers; logged once a minute",
)
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


@pytest.mark.promise(
    "docs/reference/registers.md",
    "the new one is closed at once; counted in `beamtouch_modbus_connections_refused_total`, logged once a minute.",
    "the connection is closed",
)
@pytest.mark.promise(
    "docs/reference/service-configuration.md",
    "A connection without a request for this long is closed.",
)
def test_a_hundred_connections_do_not_disturb_a_controller(start_press: StartService) -> None:
    """Those above the limit are closed; when the others have been silent for too long, there is place again."""
    server = start_modbus(start_press, f"max_clients = 4\nidle_s = {IDLE_S}")
    with ExitStack() as stack:
        controller = stack.enter_context(server.connected())
        crowd = []
        for _ in range(100):
            crowd.append(stack.enter_context(server.connected()))
            # Those that found a place keep it, too.
            for one in (controller, *crowd[:3]):
                assert ask(one, 62, 1) == [16]
        refused = "beamtouch_modbus_connections_refused_total 97.0"
        wait_until(lambda: refused in server.http.get("/metrics").text.splitlines())
        crowd[0].sendall(request(0, 1)[:7])  # half a request is none
        with ThreadPoolExecutor() as pool:
            closed = [pool.submit(closes, one) for one in crowd]
            while not all(one.done() for one in closed):
                assert ask(controller, 62, 1) == [16]
                time.sleep(PERIOD_S)
        assert [one.result() for one in closed] == [True] * 100
        late = stack.enter_context(server.connected())
        assert ask(late, 62, 1) == ask(controller, 62, 1) == [16]
    code, errors = server.http.stop(signal.SIGTERM)
    assert (code, errors.count("too many connections")) == (0, 1)


@pytest.mark.promise(
    "docs/reference/registers.md",
    "the service reads no more of them, and closes the connection after `idle_s`",
)
def test_a_client_that_does_not_read_costs_little_and_is_closed(start_press: StartService) -> None:
    server = start_modbus(start_press, "idle_s = 3.0")
    before_mb = resident_mb(server.http.process.pid)
    with server.connected(timeout_s=1.0, receive_bytes=4096) as connection:
        sent_bytes = flood(connection, request(0, 100) * 1000, MAX_SENT_BYTES)
        assert server.registers(62, 1) == [16]
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
