"""Faults of what works on each batch beside the answer: the answer moves, and the fault is named until it is gone."""

import asyncio
import logging
from typing import NoReturn

import pytest

from beamtouch_service.api import stream
from beamtouch_service.api.change_log import ChangeLog
from beamtouch_service.commissioning.run import CommissioningRun
from beamtouch_service.commissioning.runs import CommissioningRuns
from beamtouch_service.metrics.figures import Figures
from beamtouch_service.outputs.modbus.blocks import Blocks
from beamtouch_service.outputs.modbus.section import ModbusServerSection
from beamtouch_service.outputs.modbus.server import _Connections
from beamtouch_service.record import Recorder
from beamtouch_service.surfaces.surface import Surface
from service.bench import TOKEN, Bench, batch_of, surface_of
from service.event_story import RESTING, TOUCHING
from service.process.modbus_service import frame, request

COMMISSIONING = "/surfaces/press-7/commissioning"


def fail(*_arguments: object, **_options: object) -> NoReturn:
    raise ZeroDivisionError("in a test")


def missing(bench: Bench, part: str) -> str | None:
    """Return what readiness says of a part; None if it says nothing."""
    reason: str | None = bench.get("/health/ready").json().get("missing", {}).get(part)
    return reason


@pytest.mark.promise(
    "docs/reference/metrics.md",
    "holds up no other answer when it fails, and counts as missing until it succeeds.",
)
@pytest.mark.parametrize(
    ("part", "owner", "function"),
    [
        ("change log", ChangeLog, "log_changes"),
        ("record samples", Recorder, "take"),
        ("commissioning", CommissioningRuns, "take"),
    ],
)
def test_a_fault_beside_the_answer_holds_up_no_answer_and_is_named_until_it_is_gone(
    bench: Bench,
    monkeypatch: pytest.MonkeyPatch,
    caplog: pytest.LogCaptureFixture,
    part: str,
    owner: type,
    function: str,
) -> None:
    caplog.set_level(logging.INFO, "beamtouch_service")
    with monkeypatch.context() as faulty:
        faulty.setattr(owner, function, fail)
        for sequence in (1, 2, 3):
            assert bench.post(batch_of(TOUCHING, sequence=sequence)).status_code == 200
        assert bench.get("/contact").json()["sequence"] == 3
        assert missing(bench, part) == "unexpected error (ZeroDivisionError('in a test'))"
        assert f'beamtouch_part_failures_total{{part="{part}"}} 3.0' in bench.metrics()
    assert bench.post(batch_of(RESTING, sequence=4)).status_code == 200
    assert missing(bench, part) is None
    lines = [line for line in caplog.messages if line.startswith(part)]
    assert lines == [f"{part} of press-7: unexpected error; all else goes on", f"{part} of press-7: runs again"]


def test_a_part_that_fails_for_one_surface_is_named_while_it_works_for_another(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    caplog.set_level(logging.INFO, "beamtouch_service")
    bench, log_changes = Bench(surface_of(), surface_of("press-8")), ChangeLog.log_changes

    def fail_for_one(log: ChangeLog, surface: Surface, now_s: float) -> None:
        if surface.name == "press-7":
            fail()
        log_changes(log, surface, now_s)

    with monkeypatch.context() as faulty:
        faulty.setattr(ChangeLog, "log_changes", fail_for_one)
        for sequence in range(1, 30):
            for name in ("press-7", "press-8"):
                assert bench.post(batch_of(TOUCHING, sequence=sequence), f"/surfaces/{name}/samples").status_code == 200
            assert missing(bench, "change log") == "unexpected error (ZeroDivisionError('in a test'))"
    bench.post(batch_of(TOUCHING, sequence=30), "/surfaces/press-7/samples")
    assert missing(bench, "change log") is None
    assert [line for line in caplog.messages if line.startswith("change log")] == [
        "change log of press-7: unexpected error; all else goes on",
        "change log of press-7: runs again",
    ]


def test_without_the_record_a_receipt_says_that_nothing_is_durable_and_the_samples_come_again(
    bench: Bench, monkeypatch: pytest.MonkeyPatch
) -> None:
    with monkeypatch.context() as faulty:
        faulty.setattr(Recorder, "take", fail)
        receipt = bench.post(batch_of(TOUCHING, sequence=1)).json()
        assert (receipt["accepted"], receipt["durable"], receipt["expected"]) == (1, None, None)
    assert bench.post(batch_of(TOUCHING, sequence=1)).json()["expected"] == 2


def test_a_commissioning_that_fails_ends_with_the_reason(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    bench.send()
    assert bench.post(b"", COMMISSIONING, TOKEN).json()["run"]
    monkeypatch.setattr(CommissioningRun, "take", fail)
    assert bench.post(batch_of(RESTING, sequence=2)).status_code == 200
    state = bench.get(COMMISSIONING).json()
    assert state["run"] is None
    assert state["ended"].startswith("An unexpected error of the service ended it")
    assert missing(bench, "commissioning") is not None
    assert bench.post(batch_of(RESTING, sequence=3)).status_code == 200
    assert missing(bench, "commissioning") is None


def test_a_listener_that_fails_hinders_neither_the_answer_nor_others(
    bench: Bench, caplog: pytest.LogCaptureFixture
) -> None:
    (surface,) = bench.app.context.registry
    heard = list[str]()
    surface.moves.add(fail)
    surface.moves.add(lambda moved: heard.append(moved.name))
    for sequence in (1, 2):
        assert bench.post(batch_of(TOUCHING, sequence=sequence)).status_code == 200
    assert heard == ["press-7"] * 2
    assert bench.get("/contact").json()["sequence"] == 2
    assert caplog.messages == ["a listener to a surface: unexpected error"]


def test_metrics_that_fail_are_a_problem_and_come_again(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    with monkeypatch.context() as faulty:
        faulty.setattr(Figures, "read_service", fail)
        answer = bench.get("/metrics")
        assert (answer.status_code, answer.json()["type"]) == (500, "urn:beamtouch:problem:internal")
    assert bench.get("/metrics").status_code == 200


def test_a_stream_that_fails_ends_and_the_next_one_has_its_place(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    streams = bench.app.context.streams
    with monkeypatch.context() as faulty:
        faulty.setattr(stream, "state_of", fail)
        assert bench.get("/stream").text == ""
    assert streams.open == 0


@pytest.mark.promise("docs/reference/registers.md", "An error of the service is exception 4 (server device failure)")
@pytest.mark.anyio
async def test_a_modbus_server_that_fails_answers_so_on_the_same_connection_and_is_named(
    bench: Bench, monkeypatch: pytest.MonkeyPatch
) -> None:
    connections = _Connections(ModbusServerSection(), bench.app.context)
    server = await asyncio.start_server(connections.serve, "127.0.0.1", 0)
    async with server:
        reader, writer = await asyncio.open_connection(*server.sockets[0].getsockname()[:2])
        with monkeypatch.context() as faulty:
            faulty.setattr(Blocks, "read", fail)
            writer.write(request(0, 2))
            assert await reader.readexactly(9) == frame(bytes([0x84, 4]), 1)
            assert missing(bench, "modbus_server answers") == "unexpected error (ZeroDivisionError('in a test'))"
        writer.write(request(0, 2, transaction=2))
        assert (await reader.readexactly(9))[7] == 4
        assert missing(bench, "modbus_server answers") is None
        writer.close()


@pytest.mark.anyio
async def test_a_client_that_does_not_speak_modbus_is_named_by_its_address(
    bench: Bench, caplog: pytest.LogCaptureFixture
) -> None:
    connections = _Connections(ModbusServerSection(), bench.app.context)
    server = await asyncio.start_server(connections.serve, "127.0.0.1", 0)
    async with server, asyncio.timeout(60):
        reader, writer = await asyncio.open_connection(*server.sockets[0].getsockname()[:2])
        writer.write(b"GET / HTTP/1.1\r\n\r\n")
        assert await reader.read() == b""
        writer.close()
    (line,) = [record.getMessage() for record in caplog.records if "not Modbus TCP" in record.getMessage()]
    assert line.startswith("Modbus TCP server: closed 1 connections since the last such line: not Modbus TCP (")
    assert line.endswith("), the last from 127.0.0.1")
