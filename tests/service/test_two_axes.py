"""A surface of two axes, at every door: a figure of place is named after its axis."""

import csv
import io
import json
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from beamtouch_common.zones import Zone
from beamtouch_models.errors import ModelFileError
from beamtouch_models.runtime import InfluenceCurve, Metadata, State
from beamtouch_service.api.stream import state_of
from beamtouch_service.commissioning.report import PlaceResult
from beamtouch_service.commissioning.verdict import advise_places, is_right, judge_place
from beamtouch_service.host.models import ModelKeeper
from beamtouch_service.outputs.modbus.blocks import Blocks
from beamtouch_service.outputs.modbus.registers import REGISTERS
from beamtouch_service.outputs.mqtt.discovery import description
from beamtouch_service.outputs.mqtt.messages import Topics
from beamtouch_service.outputs.opcua.values import values
from beamtouch_service.sections import EventsSection, SurfaceSection
from beamtouch_service.surfaces.surface import Surface
from service.bench import START_US, Bench, Row, parsed, surface_of, surface_with
from service.contact_registers import number
from support.surfaces.small_model import PLATE_OUTPUTS, model_of

NOW_S = 1000.0
RESTING: Row = [0.0] * 4
TOUCHING: Row = [0.5, 0.25, 0.125, 0.0]
HARDER: Row = [0.5, 0.75, 0.5, 0.0]
PLACE = {"x_mm": 150.0, "x_low_mm": 149.0, "x_high_mm": 151.0, "y_mm": 75.0, "y_low_mm": 74.0, "y_high_mm": 76.0}
NAMES = list(PLACE)
SENSORS = [("s1", 100, 50), ("s2", 200, 150), ("s3", 300, 250), ("s4", 400, 50)]
OF_EVENT = {
    *("mean_x_mm", "mean_x_low_mm", "mean_x_high_mm", "min_x_mm", "max_x_mm", "peak_x_mm"),
    *("mean_y_mm", "mean_y_low_mm", "mean_y_high_mm", "min_y_mm", "max_y_mm", "peak_y_mm"),
}


def plate(section: SurfaceSection | None = None, name: str = "press-7") -> Surface:
    return surface_of(name, section, outputs=PLATE_OUTPUTS, channels=4)


def places_of(members: dict[str, Any]) -> dict[str, Any]:
    """Return the members of an answer that are about a place."""
    return {name: value for name, value in members.items() if name.endswith("_mm")}


@pytest.mark.promise(
    "docs/reference/contact.md",
    (
        "On a surface whose model has the axes `x` and `y`, a contact has `x_mm`, `x_low_mm`, `x_high_mm`, `y_mm`, "
        "`y_low_mm` and `y_high_mm` instead, and events likewise."
    ),
)
def test_contact_stream_and_problem() -> None:
    bench = Bench(plate())
    bench.send(RESTING)
    assert places_of(bench.contact()) == dict.fromkeys(NAMES)
    bench.send(TOUCHING, sequence=2)
    contact = bench.contact()
    assert (places_of(contact), contact["force_n"], contact["state"]) == (PLACE, 8.75, "contact")
    assert contact["place_correlation"] == 0.4375
    assert list(contact)[1:9] == ["state", *NAMES, "place_correlation"]
    (surface,) = bench.app.context.registry
    state = state_of(surface.view(bench.now_s))
    assert (places_of(state["contact"]), state["length_mm"], state["width_mm"]) == (PLACE, 400, 300)
    assert [(one["name"], one["x_mm"], one["y_mm"]) for one in state["channels"]] == SENSORS
    described = bench.get("/surfaces/press-7/model").json()
    assert list(zip(described["channels"], described["positions_mm"], described["across_mm"], strict=True)) == SENSORS
    bench.send([0.5, 1.75, 1.75, 0.0], sequence=3)
    assert bench.problem() == "unusable-estimate"
    assert "x_mm is 625, off a plate of 400 by 300 mm" in bench.get("/contact").json()["detail"]


@pytest.mark.promise(
    "docs/reference/registers.md",
    "registers 8 to 13 hold the place along the first axis and 50 to 55 that along the second.",
)
def test_registers_variables_and_sensors_of_home_assistant() -> None:
    surface = plate()
    surface.receive(parsed(TOUCHING), NOW_S)
    words = Blocks([surface], "big").read(0, 60, NOW_S)
    assert [number(words[at : at + 2], ">f") for at in (8, 10, 12, 50, 52, 54)] == list(PLACE.values())
    assert [number(words[at : at + 2], ">f") for at in (14, 16, 18)] == [8.75, 7.75, 9.75]
    read = values(surface, NOW_S, datetime.now(UTC))
    assert {name: one.Value.Value for name, one in read.items() if one.Value and name in PLACE} == PLACE
    assert "position_mm" not in read
    components = json.loads(description(Topics("beamtouch"), surface))["components"]
    assert [components[axis]["value_template"] for axis in ("x", "y")] == [
        "{{ value_json.x_mm | default(none) }}",
        "{{ value_json.y_mm | default(none) }}",
    ]
    assert "position" not in components


def test_after_a_change_of_models_the_channels_and_the_size_are_those_of_the_answer() -> None:
    bench = Bench(plate())
    bench.send(TOUCHING)
    bench.adopt(model_of())
    (surface,) = bench.app.context.registry
    state = state_of(surface.view(bench.now_s))
    assert (places_of(state["contact"]), state["width_mm"], state["channels"][0]["y_mm"]) == (PLACE, 300, 50)
    bench.send(TOUCHING, sequence=2)
    state = state_of(surface.view(bench.now_s))
    assert ("x_mm" in state["contact"], state["width_mm"], "y_mm" in state["channels"][0]) == (False, None, False)


@pytest.mark.promise("docs/reference/registers.md", "50 to 55 are NaN on a beam.")
def test_a_beam_has_no_second_place() -> None:
    surface = surface_of()
    surface.receive(parsed(TOUCHING), NOW_S)
    words = Blocks([surface], "big").read(0, 60, NOW_S)
    assert [number(words[at : at + 2], ">f") for at in (50, 52, 54)] == [None] * 3
    taken = {at for one in REGISTERS for at in range(one.offset, one.offset + one.type.count)}
    assert [word for at, word in enumerate(words) if at not in taken and word] == []


@pytest.mark.parametrize("is_lasting", [False, True])
def test_an_event_has_its_places_by_axis_also_after_a_restart(tmp_path: Path, is_lasting: bool) -> None:
    events = EventsSection(file=tmp_path / "events.db") if is_lasting else EventsSection()
    bench = Bench(plate(), events=events)
    bench.send(RESTING, *[TOUCHING] * 3)
    if is_lasting:
        bench.stop()
        bench = Bench(plate(), events=events)
    bench.send(*[TOUCHING] * 3, *[HARDER] * 4, RESTING, sequence=5, begin_us=1_795_218_046_143_456)
    (event,) = bench.get("/events?path=true").json()["events"]
    found = places_of(event)
    assert found.keys() == OF_EVENT
    assert [found[name] for name in ("min_x_mm", "max_x_mm", "peak_x_mm")] == [150.0, 275.0, 275.0]
    assert [found[name] for name in ("min_y_mm", "max_y_mm", "peak_y_mm")] == [75.0, 137.5, 137.5]
    assert found["mean_x_mm"] == pytest.approx(2 * found["mean_y_mm"])
    assert [(stay["x_mm"], stay["y_mm"]) for stay in event["path"]] == [(150.0, 75.0), (275.0, 137.5)]
    assert [places_of(stay).keys() for stay in event["path"]] == [PLACE.keys()] * 2
    (row,) = csv.DictReader(io.StringIO(bench.get("/events?format=csv").text))
    assert {name: float(row[name]) for name in OF_EVENT} == found


RECTANGLES = SurfaceSection(
    zones={
        "near": Zone(x_mm=(140, 160), y_mm=(70, 80)),
        "beside": Zone(x_mm=(140, 160), y_mm=(90, 120)),
        "far": Zone(x_mm=(250, 300), y_mm=(100, 200), dwell_ms=15),
    }
)


@pytest.mark.parametrize("is_lasting", [False, True])
def test_rectangles_at_every_door_also_after_a_restart(tmp_path: Path, is_lasting: bool) -> None:
    events = EventsSection(file=tmp_path / "events.db") if is_lasting else EventsSection()
    bench = Bench(plate(RECTANGLES), events=events)
    bench.send(RESTING, *[TOUCHING] * 3)
    assert bench.contact()["zones"] == {"near": "inside", "beside": "outside", "far": "outside"}
    (surface,) = bench.app.context.registry
    assert Blocks([surface], "big").read(0, 60, bench.now_s)[42] == 0b01_01_11
    read = values(surface, bench.now_s, datetime.now(UTC))
    assert [read[f"zones/{name}"].Value.Value for name in RECTANGLES.zones] == ["inside", "outside", "outside"]
    assert "zone_beside" in json.loads(description(Topics("beamtouch"), surface))["components"]
    assert bench.get("/surfaces/press-7/beam").json()["zones"]["near"]["y_mm"] == [70, 80]
    if is_lasting:
        bench.stop()
        bench = Bench(plate(RECTANGLES), events=events)
    bench.send(TOUCHING, *[HARDER] * 4, RESTING, sequence=5, begin_us=1_795_218_046_143_456)
    (event,) = bench.get("/events").json()["events"]
    assert event["zones"] == {"near": 15.0, "far": 15.0}


def test_a_list_of_events_on_beams_and_plates_has_the_columns_of_both() -> None:
    bench = Bench(plate(), surface_of("press-8", channels=4))
    for name in ("press-7", "press-8"):
        bench.send(RESTING, TOUCHING, RESTING, surface=name)
    rows = {row["surface"]: row for row in csv.DictReader(io.StringIO(bench.get("/events?format=csv").text))}
    assert [rows[name]["mean_y_mm"] for name in ("press-7", "press-8")] == ["75.0", ""]
    assert [rows[name]["mean_position_mm"] for name in ("press-7", "press-8")] == ["", "150.0"]


def test_an_unexplained_stretch_on_a_plate_has_empty_places() -> None:
    bench = Bench(plate())
    bench.send(RESTING, *[[0.5, 0.0, 0.5, 0.0]] * 4, RESTING)
    (event,) = bench.get("/events?kind=unexplained").json()["events"]
    assert places_of(event) == dict.fromkeys(OF_EVENT)


@pytest.mark.promise("docs/how-to/zones.md", "On a surface of two sensors, and on a plate of three")
def test_three_sensors_of_a_plate_check_no_contact_and_four_name_no_channel() -> None:
    bench = Bench(surface_of(section=RECTANGLES, outputs=PLATE_OUTPUTS), plate(RECTANGLES, "press-8"))
    bench.send(RESTING[:3], *[TOUCHING[:3]] * 3)
    bench.send(RESTING, *[TOUCHING] * 3, surface="press-8")
    few, enough = (bench.get(f"/surfaces/{name}/contact").json() for name in ("press-7", "press-8"))
    assert (few["notes"], few["zones"]) == (["unchecked"], dict.fromkeys(RECTANGLES.zones))
    assert (enough["notes"], enough["zones"]["near"]) == ([], "inside")
    # Without one of four channels, any contact fits: none of them is named.
    bench.send(*[[0.5, 0.0, 0.5, 0.0]] * 60, RESTING, sequence=5, surface="press-8", begin_us=1_795_218_046_143_456)
    (event,) = bench.get("/events?path=true&kind=contact&surface=press-8").json()["events"]
    assert event["unexplained_ms"] > 0
    for sample in event["capture"]:
        assert [one["misfit_without"] for one in sample["channels"]] == [None] * 4


def test_a_zone_of_a_beam_is_refused_in_one_line(tmp_path: Path) -> None:
    section = SurfaceSection(zones={"gate": Zone(from_mm=120, to_mm=200)})
    keeper = ModelKeeper(plate(section), tmp_path / "plate.onnx", None)
    conflict = keeper.zone_conflict(model_of(outputs=PLATE_OUTPUTS))
    assert conflict == "gate: a zone of a plate of 400 by 300 mm has x_mm and y_mm"


def test_a_model_whose_outputs_lack_an_axis_is_refused() -> None:
    lacking = tuple(name for name in PLATE_OUTPUTS if name != "x_mm")
    with pytest.raises(ModelFileError, match="output x_mm is missing"):
        model_of(outputs=lacking)


@pytest.mark.parametrize(
    ("entry", "changed", "reason"),
    [
        ("ranges", {"position_mm": [1, 399], "force_n": [1, 20]}, "layout and ranges have it on two axes"),
        ("smallest_force", {"position_mm": [9], "across_mm": [1, 2], "force_n": [1]}, "1 positions with 2 across"),
    ],
)
def test_metadata_whose_places_lack_an_axis_are_refused(entry: str, changed: dict[str, Any], reason: str) -> None:
    entries = model_of(outputs=PLATE_OUTPUTS).metadata.to_entries()
    with pytest.raises(ModelFileError, match=reason):
        Metadata.from_entries(entries | {f"beamtouch.{entry}": json.dumps(changed)})


def test_the_influence_of_a_plate_is_a_table_of_both_axes() -> None:
    metadata = model_of(outputs=PLATE_OUTPUTS).metadata
    curve = InfluenceCurve.of(metadata)
    assert [(ticks[0], ticks[-1], len(ticks)) for ticks in curve.ticks] == [(1, 399, 5), (1, 299, 5)]
    found, _ = curve.at(np.array([[1.0, 299.0], [399.0, 1.0]]))
    assert found == pytest.approx(np.array(metadata.influence.mm_per_n)[[4, 20]])


class Plate:
    """A plate of the small model that is pressed above its sensors and at the marks."""

    def __init__(self, order: tuple[int, ...] = (0, 1, 2, 3)) -> None:
        model = model_of(outputs=PLATE_OUTPUTS, channels=4)
        self.bench, self.order, self._sent = Bench(surface_with(model)), list(order), 0
        self._curve = InfluenceCurve.of(model.metadata)

    def send(self, force_n: float, place_mm: dict[str, float] | None = None) -> None:
        """Send a second of samples under a load, or at rest."""
        place = np.array([[*(place_mm or {"x": 1.0, "y": 1.0}).values()]])
        row: Row = (force_n * self._curve.at(place)[0][0])[self.order].tolist()
        begin_us = START_US + 10_000 * self._sent
        self.bench.send(*[row] * 105, sequence=self._sent + 1, begin_us=begin_us, every_us=10_000)
        self._sent += 105

    def commission(self) -> dict[str, Any]:
        """Press as asked; return the result on record."""
        path = "/surfaces/press-7/commissioning"
        self.send(0)
        run = self.bench.post(b"", path).json()["run"]
        assert run["steps"] == 4 + 4
        self.send(0)
        for step in range(run["steps"]):
            now = self.bench.get(path).json()["run"]
            assert (now["step"], now["stage"]) == (step, "press")
            self.send(8, now["at_mm"])
            self.send(0)
        recorded: dict[str, Any] = self.bench.post(b"", f"{path}/confirm?run={run['id']}&by=Ann").json()
        return recorded


@pytest.mark.promise(
    "docs/how-to/commission-on-the-page.md",
    "On a plate, the places have `x` and `y`, and there are four marks, one in each quarter.",
)
def test_a_plate_is_commissioned_by_places_of_two_axes() -> None:
    report = Plate().commission()
    assert [(one["name"], one["finding"]) for one in report["sensors"]] == [(f"s{n}", "right") for n in range(1, 5)]
    assert [one["at_mm"] for one in report["sensors"]][:2] == [{"x": 100, "y": 50}, {"x": 200, "y": 150}]
    assert [one["at_mm"] for one in report["places"]] == [
        {"x": x, "y": y} for x in (100.0, 300.0) for y in (76.0, 224.0)
    ]
    assert all(one["stated_mm"] is None or list(one["stated_mm"]) == ["x", "y"] for one in report["places"])


def test_a_beam_and_a_plate_are_commissioned_side_by_side() -> None:
    bench = Bench(surface_of(), plate(name="press-8"))
    surfaces: dict[str, Row] = {"press-7": RESTING[:3], "press-8": RESTING}
    for first in (1, 106):
        for name, row in surfaces.items():
            begin_us = START_US + 10_000 * first
            bench.send(*[row] * 105, surface=name, sequence=first, begin_us=begin_us, every_us=10_000)
            if first == 1:
                assert bench.post(b"", f"/surfaces/{name}/commissioning").status_code == 200
    runs = {name: bench.get(f"/surfaces/{name}/commissioning").json()["run"] for name in surfaces}
    assert {name: (run["stage"], list(run["at_mm"])) for name, run in runs.items()} == {
        "press-7": ("press", ["position"]),
        "press-8": ("press", ["x", "y"]),
    }


def test_swapped_cables_of_a_plate_are_named() -> None:
    report = Plate((0, 2, 1, 3)).commission()
    assert [one["finding"] for one in report["sensors"]] == ["right", "swapped", "swapped", "right"]
    assert report["verdict"][0] == "The cables of s2 and s3 are swapped. Swap them back."


def test_a_mark_of_a_plate_is_judged_along_each_axis() -> None:
    def place(x_mm: float, y_mm: float) -> PlaceResult:
        spans = {"x": (x_mm, x_mm - 1, x_mm + 1), "y": (y_mm, y_mm - 2, y_mm + 2)}
        return judge_place(PlaceResult(at_mm={"x": 100, "y": 75}, state=State.CONTACT, stated_mm=spans))

    right, beside = place(104, 70), place(100, 95)
    assert (is_right(right), is_right(beside)) == (True, False)
    assert right.says == "x +4.0 mm, within 6.0 mm; y -5.0 mm, within 7.0 mm"
    assert beside.says == "x +0.0 mm, within 6.0 mm; y +20.0 mm, more than 7.0 mm"
    assert advise_places([beside, place(99, 97)], is_wired=True) == [
        "The largest error of a position is 22.0 mm.",
        "All figures of y are about 21 mm too large: the marks may count from another point.",
    ]
    assert advise_places([beside, place(130, 97)], is_wired=True)[1].startswith("This is more than aim explains.")
