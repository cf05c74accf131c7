"""An address to listen on: what is bound there, and what is said while it cannot be."""

import asyncio
import errno
import os
import socket
from collections.abc import Callable
from pathlib import Path

import pytest

from beamtouch_common.errors import InputError
from beamtouch_service import address
from beamtouch_service.address import Address
from beamtouch_service.host.open_files import MAX_REJECTED_AT_ONCE, reject_when_out_of_descriptors
from support.network.free_ports import free_port


def refuse(shown: str) -> None:
    raise InputError(f"{shown} is open")


@pytest.mark.parametrize(
    ("host", "shown", "is_loopback"),
    [
        ("127.0.0.1", "127.0.0.1", True),
        ("127.9.9.9", "127.9.9.9", True),
        ("localhost", "127.0.0.1", True),
        ("::1", "::1", True),
        ("::ffff:127.0.0.1", "::ffff:127.0.0.1", True),
        ("0.0.0.0", "0.0.0.0", False),  # noqa: S104
        ("::", "::", False),
    ],
)
def test_what_only_this_machine_reaches_needs_nothing(host: str, shown: str, is_loopback: bool) -> None:
    def make(require: Callable[[str], None]) -> Address:
        return Address("server", host, 0, require=require)

    one = make(lambda _address: None)
    assert (one.shown, one.is_loopback, one.missing) == (shown, is_loopback, "")
    if is_loopback:
        make(refuse)
    else:
        with pytest.raises(InputError, match=f"^{shown} is open$"):
            make(refuse)


def test_a_connection_is_bounded_in_what_its_client_leaves_unread() -> None:
    async def listen() -> list[int]:
        with await Address("server", "127.0.0.1", 0).listen(lambda _reason: None) as listener:
            kinds = (socket.SO_REUSEADDR, socket.SO_SNDBUF, socket.SO_ACCEPTCONN)
            of_socket = [listener.getsockopt(socket.SOL_SOCKET, kind) for kind in kinds]
            return [*of_socket, listener.getsockopt(socket.IPPROTO_TCP, socket.TCP_USER_TIMEOUT), listener.proto]

    # Linux doubles the size of a buffer, for what it keeps about it.
    assert asyncio.run(listen()) == [1, 2 * 128 * 1024, 1, 10_000, socket.IPPROTO_TCP]


def test_a_port_that_is_taken_is_told_until_it_is_free(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setattr(address, "RETRY_S", 0.0)
    caplog.set_level("INFO", address.__name__)
    port = free_port()
    taken, reasons = socket.create_server(("127.0.0.1", port)), list[str]()
    one = Address("opcua", "127.0.0.1", port, "opcua.port")
    why = (
        f"port {port} on 127.0.0.1: in use; stop the program that listens there, or choose another port with opcua.port"
    )
    assert one.missing == why

    def note(reason: str) -> None:
        reasons.append(reason)
        if len(reasons) == 2:
            taken.close()

    asyncio.run(one.listen(note)).close()
    assert (reasons[:2], reasons[-1], one.missing) == ([why, why], "", "")
    first, *_, last = caplog.messages
    assert first == f"[opcua]: {why}; trying again"
    assert last.startswith("[opcua]: 127.0.0.1 is there")


def test_a_name_that_does_not_resolve_may_be_any_address(monkeypatch: pytest.MonkeyPatch) -> None:
    def resolve(*_asked: object, **_options: object) -> None:
        raise socket.gaierror

    monkeypatch.setattr(socket, "getaddrinfo", resolve)
    # What it would require is asked for the name: it may come to stand for an address that others reach.
    with pytest.raises(InputError, match=r"^hall is open$"):
        Address("server", "hall", 0, require=refuse)
    one = Address("server", "hall", 0)
    assert (one.shown, one.is_loopback) == ("hall", False)
    assert one.missing.startswith("host 'hall' does not resolve; use 127.0.0.1, or an address that `ip address` shows")


def test_a_name_that_comes_to_stand_for_an_address_of_others_is_not_listened_on(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(address, "RETRY_S", 0.0)
    where = ["127.0.0.1"]
    resolve = socket.getaddrinfo
    monkeypatch.setattr(socket, "getaddrinfo", lambda _host, *asked, **named: resolve(where[0], *asked, **named))
    one, reasons = Address("server", "hall", 0, require=refuse), list[str]()
    where[0] = "0.0.0.0"  # noqa: S104

    def note(reason: str) -> None:
        reasons.append(reason)
        where[0] = "127.0.0.1"

    asyncio.run(one.listen(note)).close()
    assert reasons == ["0.0.0.0 is open", ""]


def held() -> int:
    """Return how many descriptors of this process are held in reserve."""
    # The list itself takes a descriptor, which is gone when the list is read.
    links = (Path(os.path.realpath(one)) for one in Path("/proc/self/fd").iterdir())
    return sum(link == Path(os.devnull) for link in links)


def test_connections_that_find_no_descriptor_are_closed_and_counted(caplog: pytest.LogCaptureFixture) -> None:
    assert MAX_REJECTED_AT_ONCE == 1024

    async def reject() -> list[bytes]:
        before = held()
        reject_when_out_of_descriptors()
        assert held() == before + 2
        loop = asyncio.get_running_loop()
        with socket.create_server(("127.0.0.1", 0)) as listener:
            listener.setblocking(False)
            waiting = [socket.create_connection(listener.getsockname()) for _ in range(3)]
            server = await loop.create_server(asyncio.Protocol, sock=listener, start_serving=False)
            for error in (OSError(errno.EMFILE, "full"), OSError(errno.EPERM, "other"), ValueError("other")):
                loop.call_exception_handler({"message": "accept", "exception": error, "socket": server.sockets[0]})
            found = [one.recv(1) for one in waiting]
            assert held() == before + 2, "for the next ones"
            for one in waiting:
                one.close()
            server.close()
        return found

    assert asyncio.run(reject()) == [b""] * 3
    closed, *others = caplog.messages
    assert closed.startswith("3 connections closed since the last such line: this process has no file descriptor left;")
    assert len(others) == 2
