"""Parts of the service that fail: each is named, begun again, and works once its fault is gone."""

import asyncio
import signal
import socket
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path
from typing import NamedTuple

import pytest

from service.bench import PATIENT, batch_of
from service.event_story import RESTING, TOUCHING
from service.process.broker import Broker, broker_in
from service.process.mqtt_line import metric
from service.process.opcua_client import connected, read
from service.process.opcua_hello import is_open
from support.network.free_ports import free_port
from support.programs.broken import WORDS, broken
from support.running.waiting import wait_until

from .conftest import Service, StartService
from .modbus_service import ask


class Case(NamedTuple):
    """A fault in a part."""

    part: str
    module: str
    owner: str
    function: str
    is_early: bool = False
    """Whether the part calls the function only when it begins."""
    is_more: bool = False
    """Whether it is one more of what fails in the same task as another one."""


PARTS = [
    Case("clock", "beamtouch_service.surfaces.freshness", "StallDetector", "tick"),
    Case("progress", "beamtouch_common.systemd", "ServiceManager", "alive"),
    Case("record", "beamtouch_service.record.recorder", "Recorder", "_begin_upkeep"),
    Case("models", "beamtouch_service.host.models", "", "watch", is_early=True),
    Case("modbus_server", "beamtouch_service.outputs.modbus.server", "asyncio", "start_server", is_early=True),
    Case("mqtt", "beamtouch_service.outputs.mqtt.publisher", "Publisher", "_introduce", is_early=True),
    Case("mqtt", "beamtouch_service.outputs.mqtt.connection", "Connection", "watch", is_early=True),
    Case("mqtt contacts", "beamtouch_service.outputs.mqtt.contacts", "ContactSender", "_send"),
    Case("mqtt statuses", "beamtouch_service.outputs.mqtt.statuses", "", "status_of"),
    Case("mqtt descriptions", "beamtouch_service.outputs.mqtt.descriptions", "DescriptionSender", "run", is_early=True),
    Case("mqtt leftovers", "beamtouch_service.outputs.mqtt.leftovers", "Leftovers", "run", is_early=True),
    Case("mqtt events", "beamtouch_service.outputs.mqtt.events", "EventSender", "_find_due"),
    Case("opcua", "beamtouch_service.outputs.opcua.space", "Space", "build", is_early=True),
    Case("opcua", "beamtouch_service.outputs.opcua.space", "Space", "follow", is_early=True, is_more=True),
    Case("opcua", "beamtouch_service.outputs.opcua.space", "Space", "require_same_axes", is_early=True, is_more=True),
    Case("opcua", "beamtouch_service.outputs.opcua.events", "EventSender", "describe", is_early=True, is_more=True),
    Case("opcua events", "beamtouch_service.outputs.opcua.events", "EventSender", "_send"),
    Case("opcua", "beamtouch_service.outputs.opcua.door", "Sessions", "end_orphans", is_more=True),
]


def missing(service: Service) -> dict[str, str]:
    """Return what readiness says is missing; a part that has recovered is not there."""
    found: dict[str, str] = service.get("/health/ready").json().get("missing", {})
    return found


def failures(service: Service, part: str) -> float:
    name = f'beamtouch_part_failures_total{{part="{part}"}} '
    return float(next(line.removeprefix(name) for line in service.get("/metrics").text.splitlines() if name in line))


def sections_for(part: str, port: int) -> str:
    """Return the section of an output that listens on this port, or finds a broker there."""
    section = part.partition(" ")[0]
    host = 'host = "127.0.0.1"\n' if section == "mqtt" else ""
    return f"[{section}]\n{host}port = {port}\n" if section in {"mqtt", "modbus_server", "opcua"} else ""


def require_works(service: Service, part: str, port: int, broker: Broker) -> None:
    """Require that clients of an output get what it has."""
    match part.partition(" ")[0]:
        case "modbus_server":
            with closing(socket.create_connection(("127.0.0.1", port), timeout=60)) as connection:
                assert ask(connection)
        case "mqtt":
            contacts = broker.subscribe("-t", "beamtouch/press-7/contact")
            wait_until(lambda: bool(contacts.messages))
        case "opcua":

            async def position() -> float:
                async with connected(f"opc.tcp://127.0.0.1:{port}/") as client:
                    return float((await read(client))["position_mm"].Value.Value)

            assert asyncio.run(position()) == service.get("/contact").json()["position_mm"]
        case _:
            pass


@pytest.fixture
def broker(tmp_path: Path) -> Iterator[Broker]:
    with broker_in(tmp_path) as broker:
        yield broker


@pytest.mark.parametrize(
    "case",
    [
        pytest.param(case, marks=[pytest.mark.soak] if case.is_more else [], id=f"{case.part}: {case.function}")
        for case in PARTS
    ],
)
def test_a_part_that_fails_is_named_and_works_again_once_its_fault_is_gone(
    start_press: StartService, tmp_path: Path, broker: Broker, case: Case
) -> None:
    fault, part = tmp_path / "fault", case.part
    port = broker.port if part.startswith("mqtt") else free_port()
    code = broken(case.module, case.owner, case.function, fault)
    if case.is_early:
        fault.touch()
    service = start_press(code=f"{PATIENT}\n{code}", sections=sections_for(part, port))
    if not case.is_early:
        wait_until(lambda: not part.startswith("opcua") or is_open(f"opc.tcp://127.0.0.1:{port}/"))
        wait_until(lambda: not part.startswith("mqtt") or metric(service, "connected") == 1)
        fault.touch()
    assert service.post(batch_of(RESTING, TOUCHING, TOUCHING, RESTING)).status_code == 200
    # It begins again and again, and is not missing until it fails once more: a busy machine may ask just then.
    wait_until(lambda: missing(service).get(part) == WORDS)
    wait_until(lambda: f'beamtouch_missing{{section="{part}"}} 1.0' in service.get("/metrics").text)
    wait_until(lambda: failures(service, part) > 1)
    # The others go on, with a sample that is fresh even if all of this took long.
    assert service.post(batch_of(RESTING, sequence=5)).status_code == 200
    assert service.get("/surfaces/press-7/contact").json()["state"] == "clear"
    fault.unlink()
    wait_until(lambda: part not in missing(service))
    assert f'beamtouch_missing{{section="{part}"}} 0.0' in service.get("/metrics").text
    assert service.post(batch_of(TOUCHING, sequence=6)).status_code == 200
    require_works(service, part, port, broker)
    assert service.get("/health/ready").status_code == 200
    ended, errors = service.stop(signal.SIGTERM)
    assert ended == 0
    # With its traceback, and no more than once a minute.
    assert errors.count(f"{part}: unexpected error; restarting in 0.1 s\n") == 1
    assert f"{part}: runs again" in errors
