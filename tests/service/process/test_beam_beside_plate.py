"""A beam and a plate on one service: each output names the places of each after its own axes."""

import asyncio
import csv
import io
import socket
from pathlib import Path
from typing import Any

from asyncua import Client, ua

from beamtouch_common.outline import names_of
from service.bench import Row
from service.contact_registers import number
from service.event_story import RESTING, TOUCHING
from service.process.conftest import Service, StartService
from service.process.modbus_service import ask
from service.process.mqtt_line import EVENT, Line, now_batch, wait_for
from service.process.opcua_client import Changes, connected
from support.network.free_ports import free_port
from support.pages.browser import OpenPage
from support.surfaces.small_model import PLATE_OUTPUTS, write_model

FLAT: Row = [0.0] * 4
PRESSED: Row = [0.5, 0.25, 0.125, 0.0]
"""Of the plate, at x = 150 and y = 75 mm."""
BEAM_NAMES, PLATE_NAMES = names_of("position", "mm"), [*names_of("x", "mm"), *names_of("y", "mm")]
SECTIONS = """
[surfaces.press-7.zones.left]
from_mm = 100
to_mm = 200
[surfaces.press-8]
model = "{plate}"
stale_ms = 60_000
zones.near = {{ x_mm = [140, 160], y_mm = [60, 90] }}
"""
OUTPUTS = """
[modbus_server]
port = {modbus}
[opcua]
port = {opcua}
"""


def sections(folder: Path) -> str:
    return SECTIONS.format(plate=write_model(folder, "top", outputs=PLATE_OUTPUTS, channels=4))


def touch_both(service: Service, sequence: int, *, lifts: bool) -> None:
    last = 1 if lifts else 0
    for surface, rest, touch in (("press-7", RESTING, TOUCHING), ("press-8", FLAT, PRESSED)):
        batch = now_batch(rest, *[touch] * 3, *[rest] * last, sequence=sequence)
        assert service.post(batch, surface).status_code == 200


async def names_in(client: Client, surface: str) -> dict[str, Any]:
    """Return the values of the variables of a surface that are places or zones."""
    index = await client.get_namespace_index("urn:beamtouch")
    nodes = await client.get_node(ua.NodeId(surface, index)).get_variables()
    names = [(await node.read_browse_name()).Name for node in nodes]
    found = dict(zip(names, await client.read_attributes(nodes), strict=True))
    return {name: one.Value.Value for name, one in found.items() if name.endswith("_mm") or name.startswith("zones/")}


def test_each_output_names_the_places_of_each_surface_after_its_axes(line: Line, tmp_path: Path) -> None:
    subscriber = line.broker.subscribe("-t", "#")
    modbus, opcua = free_port(), free_port()
    text = sections(tmp_path) + OUTPUTS.format(modbus=modbus, opcua=opcua)
    service = line.start("home_assistant_discovery = true", sections=text)
    changes = Changes()

    async def listen() -> None:
        async with connected(f"opc.tcp://127.0.0.1:{opcua}/") as client:
            kind = ua.QualifiedName("ContactEventType", await client.get_namespace_index("urn:beamtouch"))
            events = await client.get_node(ua.ObjectIds.BaseEventType).get_child(kind)
            await (await client.create_subscription(50, changes)).subscribe_events(evtypes=events)
            await asyncio.to_thread(touch_both, service, 1, lifts=True)
            await asyncio.to_thread(wait_for, lambda: len(changes.events) == 2)
            await asyncio.to_thread(touch_both, service, 6, lifts=False)
            beam = await names_in(client, "press-7")
            plate = await names_in(client, "press-8")
            assert list(beam) == [*BEAM_NAMES, "zones/left"]
            assert list(plate) == [*PLATE_NAMES, "zones/near"]
            assert (beam["zones/left"], plate["zones/near"]) == ("inside", "inside")

    asyncio.run(listen())
    beam, plate = (service.get(f"/surfaces/{name}/contact").json() for name in ("press-7", "press-8"))
    assert [name for name in beam if name.endswith("_mm")] == [*BEAM_NAMES]
    assert [name for name in plate if name.endswith("_mm")] == PLATE_NAMES
    assert (beam["zones"], plate["zones"]) == ({"left": "inside"}, {"near": "inside"})

    with socket.create_connection(("127.0.0.1", modbus)) as connection:
        words = [ask(connection, 0, 60), ask(connection, 60, 60)]
    shown = [[number(block[at : at + 2], ">f") for at in (8, 10, 12, 50, 52, 54)] for block in words]
    assert shown[0] == [*(beam[name] for name in BEAM_NAMES), None, None, None]
    assert shown[1] == [plate[name] for name in PLATE_NAMES]

    rows = {row["surface"]: row for row in csv.DictReader(io.StringIO(service.get("/events?format=csv").text))}
    told = {event.surface: event for event in changes.events}
    wait_for(lambda: len(subscriber.of(EVENT)) + len(subscriber.of("beamtouch/press-8/event")) == 2)
    sent = {event["surface"]: event for name in rows for event in subscriber.of(f"beamtouch/{name}/event")}
    for name, has, lacks in (
        ("press-7", "mean_position_mm", "mean_y_mm"),
        ("press-8", "mean_y_mm", "mean_position_mm"),
    ):
        assert float(rows[name][has]) == getattr(told[name], has) == sent[name][has]
        assert (rows[name][lacks], getattr(told[name], lacks), lacks in sent[name]) == ("", None, False)

    for name, entities in (("press-7", {"position", "zone_left"}), ("press-8", {"x", "y", "zone_near"})):
        (described,) = subscriber.of(f"homeassistant/device/beamtouch/{name}/config")
        assert described["components"].keys() == entities | {"force", "state", "problem"}


def test_the_page_changes_from_a_beam_to_a_plate_and_back(
    start_press: StartService, open_page: OpenPage, tmp_path: Path
) -> None:
    service = start_press(sections=sections(tmp_path))
    touch_both(service, 1, lifts=False)
    seen = open_page(service.url)
    seen.wait_for_text("position-interval", "95 %")
    seen.page.wait_for_selector("#position-strip polyline", state="attached")
    seen.page.select_option("#chooser", "press-8")
    seen.wait_for_text("zones", "near")
    assert (seen.text("x"), seen.text("y"), seen.page.query_selector("#position")) == ("150.0", "75.0", None)
    seen.page.wait_for_selector("#y-strip polyline", state="attached")
    seen.page.wait_for_selector("#beam rect.plate", state="attached")
    seen.page.select_option("#chooser", "press-7")
    seen.wait_for_text("zones", "left")
    assert float(seen.text("position")) == service.get("/surfaces/press-7/contact").json()["position_mm"]
    assert (seen.page.query_selector("#x"), seen.page.query_selector("#beam rect.plate")) == (None, None)
    assert (seen.complaints, seen.strangers()) == ([], [])
