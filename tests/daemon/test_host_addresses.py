"""Names of hosts: who is asked, how often, and what is said of a name that does not resolve."""

import asyncio
from collections.abc import Awaitable, Callable
from socket import AF_INET, SOCK_STREAM, gaierror

import pytest

from beamtouch_daemon.sources.host_address import HostAddress, UnknownHostError

pytestmark = pytest.mark.anyio

Answer = list[tuple[int, int, int, str, tuple[str, int]]]
TWO: Answer = [(AF_INET, SOCK_STREAM, 6, "", (address, 1502)) for address in ("192.0.2.7", "192.0.2.8")]
ADVICE = "is the name right, and is its name server there?"


def ask_with(monkeypatch: pytest.MonkeyPatch, answer: Callable[[], Awaitable[Answer]]) -> list[tuple[str, int, int]]:
    """Let a name server of the test answer; return a list of what it is asked."""
    asked = list[tuple[str, int, int]]()

    async def getaddrinfo(host: str, port: int, **kind: int) -> Answer:
        asked.append((host, port, kind["type"]))
        return await answer()

    monkeypatch.setattr(asyncio.get_running_loop(), "getaddrinfo", getaddrinfo)
    return asked


async def test_a_name_stands_for_its_first_address_and_is_asked_for_each_time(monkeypatch: pytest.MonkeyPatch) -> None:
    async def answer() -> Answer:
        return TWO

    asked, host = ask_with(monkeypatch, answer), HostAddress("plc", 1502)
    assert [await host.resolve(60.0) for _ in range(2)] == ["192.0.2.7"] * 2
    assert asked == [("plc", 1502, SOCK_STREAM)] * 2
    assert [await HostAddress(address, 7).resolve(60.0) for address in ("192.0.2.9", "::1")] == ["192.0.2.9", "::1"]
    assert len(asked) == 2


async def test_a_name_that_nobody_knows_is_said(monkeypatch: pytest.MonkeyPatch) -> None:
    async def answer() -> Answer:
        raise gaierror(-2, "Name or service not known")

    ask_with(monkeypatch, answer)
    with pytest.raises(UnknownHostError) as raised:
        await HostAddress("plc", 1502).resolve(60.0)
    assert str(raised.value) == f"plc does not resolve (Name or service not known); {ADVICE}"


async def test_a_name_server_that_does_not_answer_is_asked_one_question_at_a_time(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    answered = asyncio.Event()

    async def answer() -> Answer:
        await answered.wait()
        return TWO

    asked, host = ask_with(monkeypatch, answer), HostAddress("plc", 1502)
    for _ in range(2):
        with pytest.raises(UnknownHostError) as raised:
            await host.resolve(0.001)
        assert str(raised.value) == f"plc does not resolve (the name server does not answer); {ADVICE}"
    answered.set()
    assert await host.resolve(60.0) == "192.0.2.7"
    assert len(asked) == 1
    await host.resolve(60.0)
    assert len(asked) == 2
