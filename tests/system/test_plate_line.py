"""The whole line of a plate on springs: a Modbus device, the daemon, the service; loads at random places of it."""

import asyncio
import socket
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import httpx2
import numpy as np
import pytest

from beamtouch_models import daemon_config, make_scene, resolve
from beamtouch_models.arrays import Floats
from beamtouch_models.design.physics.plate import influence
from beamtouch_models.design.scene.plate import Plate
from beamtouch_models.runtime import ModelFile, load
from daemon.devices import pymodbus_server
from line import Surface
from service.contact_registers import number
from service.process.modbus_service import ask
from support.network.free_ports import free_port
from support.network.plain_http import NO_TLS, TIMEOUT_S
from support.programs.forked_line import ForkedLine
from support.running.waiting import wait_until

pytestmark = pytest.mark.long

RIM_MM, FORCE_N = 10.0, (2.0, 20.0)
EFFORT = 0.05
PATIENCE_S = 10.0
REFUSED = 0.02
"""Largest share of the contacts that may stay without an answer, or with a doubt, for longer than that."""
PLATE = {"length_x_mm": 400, "length_y_mm": 300, "thickness_mm": 3, "material": "steel"}
FARTHEST = 2.5
"""Half-widths of an interval beyond which a place is wrong in silence: five deviations, one contact in a million."""


class Device:
    """An input module whose registers hold what the sensors under a plate read."""

    def __init__(self, model: ModelFile, plate: Plate) -> None:
        self._metadata, self._plate, self._rng = model.metadata, plate, np.random.default_rng(7)
        self._deflection_mm = np.zeros(len(model.channels))
        self.port = 0

    def put(self, place_mm: Floats | None, force_n: float = 0.0) -> None:
        """Put a load on in place of the last one, or nothing."""
        layout = self._metadata.layout_mm
        shape = np.zeros(len(layout)) if place_mm is None else influence(self._plate, layout, place_mm[None])[0]
        self._deflection_mm = shape * force_n

    def _counts(self) -> list[int]:
        sensor, noise_mm = self._metadata.sensor, self._metadata.noise.reading_mm
        read_mm = self._deflection_mm + self._rng.normal(0, noise_mm, len(self._deflection_mm))
        counts: list[int] = (
            np.rint((sensor.standoff_mm - read_mm - sensor.offset_mm) / sensor.gain_mm_per_count).astype(int).tolist()
        )
        return counts

    @contextmanager
    def serving(self) -> Iterator[None]:
        """Answer on a port of loopback."""
        loop = asyncio.new_event_loop()
        is_ready, end = threading.Event(), asyncio.Event()

        async def answer(_function: int, _start: int, _address: int, _count: int, now: list[int], _set: object) -> None:
            now[: len(self._deflection_mm)] = self._counts()

        async def serve() -> None:
            async with pymodbus_server(self._counts(), answer) as self.port:
                is_ready.set()
                await end.wait()

        thread = threading.Thread(target=lambda: loop.run_until_complete(serve()))
        thread.start()
        try:
            assert is_ready.wait(TIMEOUT_S)
            yield
        finally:
            loop.call_soon_threadsafe(end.set)
            thread.join()
            loop.close()


class PlateLine(ForkedLine):
    """Service and daemon beside a device of the test."""

    device: Device

    def _start_rig(self, surface: Surface) -> dict[str, Any]:
        return {"kind": surface.kind, "host": "127.0.0.1", "port": self.device.port}

    def contact(self) -> dict[str, Any]:
        found: dict[str, Any] = httpx2.get(f"{self.url}/contact", verify=NO_TLS, timeout=TIMEOUT_S).json()
        return found

    def settled(self) -> dict[str, Any]:
        """Return the contact once its load rests, or what there is after some seconds."""
        end_s = time.monotonic() + PATIENCE_S
        while not _is_settled(found := self.contact()) and time.monotonic() < end_s:
            time.sleep(0.02)  # the pace of a client
        return found


@pytest.fixture(scope="module")
def plate_model(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Plate]:
    scene = make_scene(
        plate=PLATE | {"support_stiffness_n_per_mm": 15},
        contact={"force_n": list(FORCE_N), "x_mm": [10, 390], "y_mm": [10, 290]},
        sensors={"noise_mm": 0.002, "rate_hz": 40, "count": 4},
        requirements={"descriptors": ["position", "force"]},
    )
    path = tmp_path_factory.mktemp("plate") / "plate.onnx"
    resolve(scene).place(effort=EFFORT).build("plate", effort=EFFORT).save(path)
    assert scene.plate
    return path, scene.plate


@pytest.mark.parametrize("contacts", [8, pytest.param(300, marks=pytest.mark.soak)])
def test_no_contact_on_a_plate_is_wrong_in_silence(
    plate_model: tuple[Path, Plate], tmp_path: Path, contacts: int
) -> None:
    path, plate = plate_model
    model = load(path)
    (tmp_path / "built.toml").write_text(daemon_config(model.metadata))
    device, modbus, rng = Device(model, plate), free_port(), np.random.default_rng(11)
    half = {"x_mm": [0, 200], "y_mm": [0, 300]}
    sections = {
        "surfaces": {"plate": {"model": str(path), "zones": {"left": half}}},
        "modbus_server": {"port": modbus},
    }
    PlateLine.device = device
    off_mm, held, farthest, refused = [], [], [], []
    with (
        device.serving(),
        PlateLine(tmp_path, path, path, tmp_path / "built.toml", [Surface("plate", "modbus-tcp")], sections) as line,
    ):
        for _ in range(contacts):
            device.put(None)
            wait_until(lambda: line.contact().get("state") == "clear", pause_s=0.02)
            place_mm, force_n = rng.uniform(RIM_MM, np.array(plate.size_mm) - RIM_MM), rng.uniform(*FORCE_N)
            device.put(place_mm, force_n)
            found = line.settled()
            if not _is_settled(found):
                refused.append(found)
                continue
            ends = np.array([[found[f"{axis}{end}_mm"] for end in ("", "_low", "_high")] for axis in ("x", "y")])
            middle, low, high = ends.T
            off_mm.append(float(np.hypot(*(middle - place_mm))))
            held.append((low <= place_mm) & (place_mm <= high))
            farthest.append(float((np.abs(middle - place_mm) / ((high - low) / 2)).max()))
            if found["zones"]["left"] != "unsure":
                assert (found["zones"]["left"] == "inside") == (place_mm[0] <= 200), (found, place_mm)
        device.put(np.array([300.0, 100.0]), 10.0)
        wait_until(lambda: _registers_mm(modbus) == pytest.approx([300.0, 100.0], abs=10.0), pause_s=0.02)
    assert len(refused) <= REFUSED * contacts, refused
    assert max(farthest) < FARTHEST
    assert np.mean(off_mm) < 1.5 * model.metadata.accuracy.error_percent * np.hypot(*plate.size_mm) / 100
    # Of 95 %, what chance leaves below it once in ten thousand times.
    shares = np.mean(held, axis=0)
    assert (shares > 0.95 - 3.7 * np.sqrt(0.95 * 0.05 / contacts)).all(), shares


def _registers_mm(port: int) -> list[float | None]:
    """Return the place in the registers."""
    with socket.create_connection(("127.0.0.1", port)) as connection:
        words = ask(connection, 0, 60)
    return [number(words[at : at + 2], ">f") for at in (8, 50)]


def _is_settled(found: dict[str, Any]) -> bool:
    """Return whether a load rests; a busy machine may not keep the rate of the device."""
    return found.get("state") == "contact" and set(found["notes"]) <= {"rate"}
