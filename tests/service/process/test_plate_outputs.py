"""A surface of two axes over real sockets: Modbus, MQTT with its discovery, OPC UA and metrics say the same."""

import asyncio
import csv
import io
import socket

from asyncua import ua

from service.bench import BuildModel, Row
from service.contact_registers import number
from service.process.modbus_service import ask
from service.process.mqtt_line import CONTACT, EVENT, Line, now_batch, wait_for
from service.process.opcua_client import Changes, connected, read
from support.network.free_ports import free_port
from support.surfaces.small_model import PLATE_OUTPUTS

RESTING: Row = [0.0] * 4
TOUCHING: Row = [0.5, 0.25, 0.125, 0.0]
HARDER: Row = [0.5, 0.75, 0.5, 0.0]
PLACE = {"x_mm": 150.0, "x_low_mm": 149.0, "x_high_mm": 151.0, "y_mm": 75.0, "y_low_mm": 74.0, "y_high_mm": 76.0}
NAMES = [*PLACE, "place_correlation"]
SECTIONS = """
[surfaces.press-7.zones.gate]
x_mm = [140, 160]
y_mm = [60, 90]
[modbus_server]
port = {modbus}
[opcua]
port = {opcua}
"""


def test_all_outputs_say_the_same_of_a_contact_and_its_event(line: Line, build_model: BuildModel) -> None:
    build_model(outputs=PLATE_OUTPUTS, channels=4)
    subscriber = line.broker.subscribe("-t", "#")
    modbus, opcua = free_port(), free_port()
    service = line.start("home_assistant_discovery = true", sections=SECTIONS.format(modbus=modbus, opcua=opcua))
    changes = Changes()

    async def listen() -> None:
        async with connected(f"opc.tcp://127.0.0.1:{opcua}/") as client:
            kind = ua.QualifiedName("ContactEventType", await client.get_namespace_index("urn:beamtouch"))
            events = await client.get_node(ua.ObjectIds.BaseEventType).get_child(kind)
            await (await client.create_subscription(50, changes)).subscribe_events(evtypes=events)
            await asyncio.to_thread(service.post, now_batch(RESTING, *[TOUCHING] * 3, sequence=1))
            contact = (await asyncio.to_thread(service.get, "/contact")).json()
            assert {name: contact[name] for name in PLACE} == PLACE
            assert (contact["place_correlation"], contact["zones"]) == (0.4375, {"gate": "inside"})
            found = await read(client)
            assert {name: found[name].Value.Value for name in NAMES} == {name: contact[name] for name in NAMES}
            assert found["x_mm"].Value.VariantType is ua.VariantType.Double
            assert found["zones/gate"].Value.Value == "inside"
            await asyncio.to_thread(service.post, now_batch(*[HARDER] * 3, RESTING, RESTING, sequence=5))
            await asyncio.to_thread(wait_for, lambda: bool(changes.events))

    asyncio.run(listen())
    wait_for(lambda: bool(subscriber.of(EVENT)))
    (event,) = service.get("/events").json()["events"]
    assert subscriber.of(EVENT) == [event]
    names = [f"{figure}_{axis}_mm" for figure in ("mean", "min", "max", "peak") for axis in ("x", "y")]
    assert [event[name] for name in names[2:]] == [150, 75, 275, 137.5, 275, 137.5]
    (told,) = changes.events
    assert [getattr(told, name) for name in names] == [event[name] for name in names]
    (row,) = csv.DictReader(io.StringIO(service.get("/events?format=csv").text))
    assert [float(row[name]) for name in names] == [event[name] for name in names]

    service.post(now_batch(*[TOUCHING] * 3, sequence=10))
    words = _registers(modbus)
    assert [number(words[at : at + 2], ">f") for at in (8, 10, 12, 50, 52, 54)] == list(PLACE.values())
    assert (words[42], words[43]) == (3, 2)
    wait_for(lambda: any(one.get("x_mm") == 150 for one in subscriber.of(CONTACT)))
    (described,) = subscriber.of("homeassistant/device/beamtouch/press-7/config")
    assert {"x", "y", "force", "zone_gate"} <= described["components"].keys()
    assert 'beamtouch_zone{answer="inside",surface="press-7",zone="gate"} 1.0' in service.get("/metrics").text


def _registers(port: int) -> list[int]:
    with socket.create_connection(("127.0.0.1", port)) as connection:
        return ask(connection, 0, 60)
