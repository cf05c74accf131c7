"""A tare after a sensor was replaced says that the model must be calibrated: it is not of the new sensor."""

from pathlib import Path

import onnx
import pytest
from onnx import helper

from beamtouch_models.runtime.departures import Calibration, Departures
from support.network.free_ports import free_port
from support.surfaces import configs
from support.surfaces.small_model import content_of, model_of

from .devices import pymodbus_server
from .process import Outcome, command
from .service import real_service

pytestmark = pytest.mark.anyio

RESTED = [20_000, 20_000, 20_000, 20_000]
UNTIL = "until then, a contact may be unexplained or misplaced"
FIRST, AGAIN = "calibrate the model", "calibrate the model again, as its calibration is of the sensors from before"


def write_calibrated(folder: Path) -> Path:
    """Write a model of four channels that is calibrated."""
    graph = onnx.load_from_string(content_of("bench", channels=4))
    calibration = Calibration(departures=Departures.none(4), fitted=["gain"], loads=10, residual_mm=0.0)
    metadata = model_of("bench", channels=4).metadata.model_copy(update={"calibration": calibration})
    helper.set_model_props(graph, metadata.to_entries())
    path = folder / "bench.onnx"
    path.write_bytes(graph.SerializeToString())
    return path


async def tare(folder: Path, counts: list[int], port: int, change: tuple[str, str] = ("", "")) -> Outcome:
    """Tare a surface of four channels, whose configuration has one change."""
    async with pymodbus_server(counts) as source:
        surface = configs.surface(source=configs.tcp(source), registers=(0, 1, 2, 3)).replace(*change, 1)
        config = configs.write(folder, surface, url=f"http://127.0.0.1:{port}")
        return await command("tare", config, "--accept-change")


def said(outcome: Outcome) -> list[str]:
    """Return what a tare said beside rest gaps, comparison and restart."""
    assert outcome.code == 0, outcome.err
    return outcome.out.splitlines()[2:-1]


@pytest.mark.promise(
    "docs/explanation/readings-to-samples.md",
    "After a tare that was accepted, the channels that have changed by themselves are named: if their sensors are new, "
    "the model must be calibrated.",
)
async def test_a_sensor_that_changed_by_itself_may_be_new_and_then_the_model_must_be_calibrated(tmp_path: Path) -> None:
    port = free_port()
    first = await tare(tmp_path, RESTED, port)
    warm = await tare(tmp_path, [count + 800 for count in RESTED], port)
    replaced = await tare(tmp_path, [20_800, 20_100, 20_800, 20_800], port)
    async with real_service(tmp_path, write_calibrated(tmp_path), port=port):
        again = await tare(tmp_path, [20_800, 20_900, 20_800, 20_800], port)
        same = await tare(tmp_path, [20_800, 20_900, 20_800, 20_800], port)
    assert [said(one) for one in (first, warm, same)] == [[], [], []]
    what = "bench: another rest gap of s2: if a sensor is new or stands elsewhere,"
    assert said(replaced) == [f"{what} {FIRST}; {UNTIL}"]
    assert said(again) == [f"{what} {AGAIN}; {UNTIL}"]


@pytest.mark.promise(
    "docs/explanation/readings-to-samples.md",
    "The same is said of a channel whose characteristic is another one than at the last tare.",
)
async def test_a_sensor_of_another_type_at_the_same_gap_is_told_by_its_characteristic(tmp_path: Path) -> None:
    first = await tare(tmp_path, RESTED, free_port())
    other = "gain_mm_per_count = -0.0002\noffset_mm = 6.5"
    replaced = await tare(tmp_path, RESTED, free_port(), ("gain_mm_per_count = -0.0001\noffset_mm = 4.5", other))
    assert said(first) == []
    assert said(replaced) == [
        f"bench: another characteristic of s1: if a sensor is new or stands elsewhere, {FIRST}; {UNTIL}"
    ]
