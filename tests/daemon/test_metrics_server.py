"""The port of the metrics: it is waited for, it answers, and it is given back at the end."""

import asyncio
import logging
import socket
from threading import Thread

import pytest

from beamtouch_common.parts import Parts
from beamtouch_daemon.running import metrics
from beamtouch_daemon.tasks import cancel

from .acquiring import Bench, reading
from .waits import until

pytestmark = pytest.mark.anyio

PARTS = Parts(logging.getLogger(__name__))


async def answer_at(port: int) -> str:
    reader, writer = await asyncio.open_connection("127.0.0.1", port)
    writer.write(b"GET /metrics HTTP/1.0\r\n\r\n")
    text = (await reader.read()).decode()
    writer.close()
    await writer.wait_closed()
    return text


async def test_a_port_that_is_in_use_is_said_and_taken_once_it_is_free(caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level("INFO", "beamtouch_daemon")
    bench = Bench()
    bench.take(reading(50.0), reading(50.1, lost=3))
    with socket.create_server(("127.0.0.1", 0)) as other:
        port = other.getsockname()[1]
        serving = asyncio.ensure_future(metrics.serve(port, [bench.line], lambda: {"bench": bench.logs}, PARTS))
        await until(lambda: f"metrics: port {port} on 127.0.0.1: in use" in caplog.text)
    await until(lambda: "metrics: works again after" in caplog.text)
    text = await answer_at(port)
    assert 'beamtouch_readings_total{surface="bench"} 2.0' in text
    assert 'beamtouch_readings_lost_total{surface="bench"} 3.0' in text
    await cancel([serving])
    assert caplog.text.count("in use") == 1


class Server:
    """A server that notes how it is ended."""

    def __init__(self) -> None:
        self.ended = list[str]()

    def shutdown(self) -> None:
        self.ended.append("shutdown")

    def server_close(self) -> None:
        self.ended.append("closed")


async def test_a_server_whose_thread_has_ended_is_an_error_and_its_port_is_given_back(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    server, asked = Server(), list[object]()

    def start(*arguments: object) -> tuple[Server, Thread]:
        asked.extend(arguments[:2])
        return server, Thread()

    monkeypatch.setattr(metrics, "start_http_server", start)
    with pytest.raises(RuntimeError, match=r"^the thread that answers has ended$"):
        await metrics.serve(9101, [], dict, PARTS)
    await until(lambda: server.ended == ["shutdown", "closed"])
    assert asked == [9101, "127.0.0.1"]
