"""The whole line of a plate on springs, from the rig on: Modbus in, HTTP, Modbus, MQTT, OPC UA and the page out."""

import asyncio
import socket
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack
from pathlib import Path

import numpy as np
import pytest

from beamtouch_models import daemon_config
from beamtouch_models.runtime import load
from line import Surface
from service.contact_registers import number
from service.process.broker import broker_in
from service.process.modbus_service import ask
from service.process.opcua_client import connected, read
from support.network.free_ports import free_port
from support.network.plain_http import TIMEOUT_S
from support.pages.browser import OpenPage
from support.programs.forked_line import rig
from support.programs.plate_line import DAMPED, LEFT, SIZE_MM, PlateLine, Pressed
from support.running.waiting import wait_until
from support.surfaces.plate_models import PLATE_SCENE

pytestmark = pytest.mark.long

CONTACTS = 6
FARTHEST = 2.5
"""Half-widths of an interval beyond which a place is wrong in silence: five deviations, one contact in a million."""
WINDOWS = {"desk": (1280, 900), "phone": (390, 844)}
TOPIC = "beamtouch/plate/contact"


@pytest.mark.soak
def test_no_contact_on_a_plate_is_wrong_in_silence_and_all_outputs_say_the_same(
    plate_model: Path, tmp_path: Path, open_page: OpenPage
) -> None:
    model, modbus, opcua, pressed = load(plate_model), free_port(), free_port(), Pressed()
    for name, text in (("built.toml", daemon_config(model.metadata)), ("real.toml", DAMPED)):
        (tmp_path / name).write_text(text)
    with ExitStack() as stack:
        broker = stack.enter_context(broker_in(tmp_path))
        subscriber = broker.subscribe("-t", "#")
        sections = {
            "surfaces": {"plate": {"model": str(plate_model), "zones": {"left": LEFT}}},
            "modbus_server": {"port": modbus},
            "mqtt": {"host": "127.0.0.1", "port": broker.port},
            "opcua": {"port": opcua},
        }
        options = ("--modbus-tcp", "127.0.0.1:0", "--by-hand", "--imperfections", tmp_path / "real.toml")
        PlateLine.rig = stack.enter_context(rig(PLATE_SCENE, plate_model, *options))
        files = (PLATE_SCENE, plate_model, tmp_path / "built.toml", [Surface("plate", "modbus-tcp")])
        line = stack.enter_context(PlateLine(tmp_path, *files, sections))
        rng = np.random.default_rng(11)
        for _ in range(CONTACTS):
            line.press(pressed, rng)
        line.rig.put("300 100 10")
        near = pytest.approx([300.0, 100.0], abs=3.0)
        wait_until(lambda: _registers_mm(modbus) == near, pause_s=0.02)
        wait_until(lambda: any([one.get("x_mm"), one.get("y_mm")] == near for one in subscriber.of(TOPIC)))
        with ThreadPoolExecutor(1) as beside_the_browser:
            assert beside_the_browser.submit(asyncio.run, _variables_mm(opcua)).result(TIMEOUT_S) == near
        for name, window in WINDOWS.items():
            seen = open_page(line.url, size=window)
            seen.wait_for_state("contact")
            assert [float(seen.text(figure)) for figure in ("x", "y")] == near
            assert seen.overflow() <= 0
            assert not seen.complaints
            seen.picture(f"plate-line-{name}")
    assert not pressed.refused
    assert not pressed.wrong_zones
    assert max(pressed.farthest) < FARTHEST
    assert np.mean(pressed.off_mm) < 2 * model.metadata.accuracy.error_percent * np.hypot(*SIZE_MM) / 100


def _registers_mm(port: int) -> list[float | None]:
    """Return the place in the registers."""
    with socket.create_connection(("127.0.0.1", port)) as connection:
        words = ask(connection, 0, 60)
    return [number(words[at : at + 2], ">f") for at in (8, 50)]


async def _variables_mm(port: int) -> list[float | None]:
    """Return the place in the variables of OPC UA."""
    async with connected(f"opc.tcp://127.0.0.1:{port}/") as client:
        found = await read(client, "plate")
    return [found[name].Value.Value for name in ("x_mm", "y_mm")]
