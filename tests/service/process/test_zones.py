"""Zones at every door of a real service: contact, stream, registers, MQTT, OPC UA, events and the page say the same."""

import asyncio
import json
from typing import Any

import httpx2
import pytest

from service.bench import Row, batch_of
from service.event_story import RESTING
from service.process.beam_page import StartBench
from service.process.modbus_service import ADDRESS, ModbusService
from service.process.mqtt_line import CONTACT, Line, wait_connected, wait_for
from service.process.opcua_client import connected, read
from support.network.free_ports import free_port
from support.network.plain_http import TIMEOUT_S
from support.pages.browser import OpenPage

ZONES = """
[surfaces.press-7.zones.gate]
from_mm = 120
to_mm = 200
least_force_n = 5

[surfaces.press-7.zones.end]
from_mm = 200
to_mm = 400
"""
CODES = {"outside": 1, "unsure": 2, "inside": 3}
"""The two bits of a zone in its register."""
SIZES = {"desk": (1280, 900), "phone": (390, 844)}


def row(position_mm: float, force_n: float = 10.0) -> Row:
    second = (position_mm - 100) / 100
    return [force_n / 10 - second, second, 0.0]


def batch(*rows: Row, sequence: int) -> dict[str, Any]:
    """Samples 5 ms apart, from one batch to the next as well."""
    found = batch_of(*rows, sequence=sequence) | {"oldest": 1}
    for sample in found["samples"]:
        sample["acquired_unix_us"] += 5000 * (sequence - 1)
    return found


ANSWERS: list[tuple[Row, str, str, int]] = [
    (RESTING, "outside", "outside", 0),
    (row(150), "inside", "outside", 1),
    (row(150, 5), "unsure", "outside", 1),
    (row(155), "inside", "outside", 1),
    (row(150, 3), "outside", "outside", 1),
    (row(199.5), "unsure", "unsure", 1),
    (row(160), "inside", "outside", 2),
    (row(199.2, 3), "outside", "unsure", 2),
]
"""Deflections, the answers for `gate` and `end`, and entries into `gate`."""


async def over_opcua(url: str) -> dict[str, object]:
    """Return the number of the newest sample, and the answers for it."""
    async with connected(url) as client:
        found = await read(client)
    return {name: found[name].Value.Value for name in ("sequence", "zones/gate", "zones/end")}


@pytest.mark.promise(
    "docs/how-to/zones.md",
    "register `zones`, two bits a zone, both set while it is `inside`, and a counter of entries for each",
)
@pytest.mark.promise(
    "docs/reference/registers.md",
    "A zone is `inside` if both of its bits are set; neither bit alone says so.",
)
def test_every_door_says_the_same_of_the_same_sample(line: Line) -> None:
    subscriber = line.broker.subscribe("-t", CONTACT)
    opcua = free_port()
    service = line.start(sections=f"{ZONES}[modbus_server]\nport = 0\n[opcua]\nport = {opcua}\n")
    assert service.process.stderr is not None
    port = next(int(found[1]) for text in service.process.stderr if (found := ADDRESS.search(text)))
    registers = ModbusService(service, port).registers
    wait_connected(service)
    service.post(batch(RESTING, sequence=1))
    for number, (deflection, gate, end, entries) in enumerate(ANSWERS):
        sequence = 2 + 8 * number
        service.post(batch(*[deflection] * 8, sequence=sequence))
        expected = {"gate": gate, "end": end}
        assert service.get("/contact").json()["zones"] == expected

        def told(last: int = sequence + 7, expected: dict[str, str] = expected) -> bool:
            same = [one for one in subscriber.of(CONTACT) if one.get("sequence") == last]
            assert all(one["zones"] == expected for one in same)
            return bool(same)

        wait_for(told)
        assert registers(42, 7) == [CODES[gate] | CODES[end] << 2, entries, 0, 0, 0, 0, 0]
        read_there = asyncio.run(over_opcua(f"opc.tcp://127.0.0.1:{opcua}/"))
        assert read_there == {"sequence": sequence + 7, "zones/gate": gate, "zones/end": end}
    with httpx2.stream("GET", f"{service.url}/stream", trust_env=False, timeout=TIMEOUT_S) as answer:
        data = next(text for text in answer.iter_lines() if text.startswith("data: "))
    assert json.loads(data.removeprefix("data: "))["contact"]["zones"] == expected
    text = service.get("/metrics").text
    assert 'beamtouch_zone_entries_total{surface="press-7",zone="gate"} 2.0' in text


@pytest.mark.parametrize("size", SIZES)
def test_zones_are_drawn_on_the_beam_and_listed(start_bench: StartBench, open_page: OpenPage, size: str) -> None:
    zones = ZONES + "[surfaces.press-7.zones.start]\nfrom_mm = 0\nto_mm = 120\n"
    bench = start_bench(sections=zones)
    bench.load((160, 12))
    seen = open_page(bench.service.url, size=SIZES[size])
    seen.wait_for_text("zones", "gate, 120 … 200 mm: inside")
    seen.wait_for_text("zones", "end, 200 … 400 mm: outside")
    seen.wait_for_text("events", "still, 0.2 in gate")
    script = """all => Object.fromEntries(all.map(one => [one.dataset.zone,
      [one.getAttribute('class'), Number(one.getAttribute('x')), Number(one.getAttribute('width'))]]))"""
    drawn = seen.page.eval_on_selector_all("#beam rect.zone", script)
    assert {name: kind for name, (kind, _, _) in drawn.items()} == {
        "gate": "zone inside",
        "end": "zone outside",
        "start": "zone outside",
    }
    px_per_mm = drawn["end"][2] / 200
    assert drawn["gate"][1:] == pytest.approx([drawn["start"][1] + 120 * px_per_mm, 80 * px_per_mm])
    assert seen.overflow() <= 0
    assert seen.unreadable() == []
    seen.picture(f"zones-{size}")
    # An answer that is gone is shown for no zone.
    bench.send([None] * len(bench.model.channels))
    seen.wait_for_text("zones", "gate, 120 … 200 mm: —")
    assert seen.page.query_selector("#beam rect.zone.inside") is None
