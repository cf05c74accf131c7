"""The status code of each variable over OPC UA: Good is only what can be relied on."""

import asyncio
from collections.abc import Sequence
from typing import Any

import pytest

from service.bench import FIGURES, BuildModel, Row, batch_of
from service.process.opcua_client import connected, read
from support.network.free_ports import free_port

from .conftest import StartService

ALL, WITHOUT_S4 = ["good"] * 4, ["good", "good", "good", "missing"]
REST: Row = [0.0, 0.0, 0.0, 0.0]
TOUCH: Row = [0.2, 0.3, 0.3, 0.1]
ODD: Row = [0.2, 0.3, 0.5, 0.1]
GOOD, DOUBTFUL, NONE = "Good", "UncertainSubNormal", "BadNoData"
STEPS: Sequence[tuple[str, Row, list[str], list[str], tuple[str, str]]] = (
    ("clear", REST, ALL, [], (GOOD, NONE)),
    ("contact", TOUCH, ALL, [], (GOOD, GOOD)),
    ("contact", [0.2, 0.3, 0.3, None], WITHOUT_S4, [], (DOUBTFUL, DOUBTFUL)),
    ("contact", TOUCH, ["good", "good", "good", "stuck"], [], (DOUBTFUL, DOUBTFUL)),
    ("contact", TOUCH, ALL, [], (GOOD, GOOD)),
    ("contact", TOUCH, ALL, ["zeros"], (DOUBTFUL, DOUBTFUL)),
    ("clear", REST, ALL, [], (GOOD, NONE)),
    ("clear", [0.0, 0.0, 0.0, None], WITHOUT_S4, [], (DOUBTFUL, NONE)),
    ("clear", REST, ALL, ["rate"], (DOUBTFUL, NONE)),
    ("unexplained", ODD, ALL, [], (DOUBTFUL, NONE)),
)
"""State, deflections and qualities that settle it, notes of the sender, and the codes of state and of figures."""


@pytest.mark.promise(
    "docs/how-to/opcua.md",
    "A program that takes only `Good` values never takes a doubtful one",
    "the contact has notes or lacks channels, or the state is `unexplained`",
)
def test_only_a_contact_of_all_channels_without_a_note_is_good(
    start_press: StartService, build_model: BuildModel
) -> None:
    port = free_port()
    # Three of its channels can check a contact, so that no note says that one is missing.
    service = start_press(model=build_model(channels=4), sections=f"[opcua]\nport = {port}\n")

    async def compare() -> None:
        sent = 0
        async with connected(f"opc.tcp://127.0.0.1:{port}/") as client:
            for state, row, quality, notes, codes in STEPS:
                batch = batch_of(*[row] * 10, sequence=sent + 1, quality=quality) | {"notes": notes}
                sent += 10
                assert (await asyncio.to_thread(service.post, batch)).status_code == 200
                contact: dict[str, Any] = (await asyncio.to_thread(service.get, "/contact")).json()
                # The quality of a sample says it before the note `degraded` does.
                assert (contact["state"], contact["notes"]) == (state, notes)
                assert contact["quality"] == ("good" if quality == ALL else "degraded")
                found = {name: one.StatusCode.name for name, one in (await read(client)).items()}
                assert found["degraded_channels"] == codes[0], row
                assert {found[name] for name in FIGURES} == {codes[1]}, (state, row, notes)
                others = {code for name, code in found.items() if name not in FIGURES}
                assert others == {codes[0]}, (state, row, notes)

    asyncio.run(compare())
