"""Zones: the answers from consecutive samples as pure functions, and what refuses, counts and records them."""

import json
from pathlib import Path
from typing import Any, Literal

import pytest

from beamtouch_common.zones import BEGIN, Span, Zone, ZoneState
from beamtouch_models.metadata import POSITION_OUTPUTS
from beamtouch_service import cli
from beamtouch_service.events.recorder import Recorder
from beamtouch_service.host import models
from beamtouch_service.host.models import ModelKeeper
from beamtouch_service.sections import EventsSection, SurfaceSection
from beamtouch_service.surfaces.surface import Surface
from beamtouch_service.zones.follow import Seen, ZoneFollower, ZoneReport
from service.conftest import Bench, BuildModel, Row, batch_of, parsed, surface_of

GATE = Zone(from_mm=120, to_mm=200)
SLOW = Zone(from_mm=120, to_mm=200, dwell_ms=20)
PRESSED = Zone(from_mm=120, to_mm=200, least_force_n=5, largest_force_n=15)
LENGTH_MM, HOLD_US, STEP_US = 400.0, 100_000, 5000

I, O, U = ZoneState.INSIDE, ZoneState.OUTSIDE, ZoneState.UNSURE  # noqa: E741  # as short as the rows need
What = float | Literal["clear"] | None
ODD: Row = [0.5, 0.25, 0.75]
Step = tuple[What, int, int]


def at(middle: float, half: float = 1.0) -> Span:
    return Span(middle, middle - half, middle + half)


@pytest.mark.parametrize(
    ("zone", "position", "force", "lies"),
    [
        (GATE, at(150), None, I),
        (GATE, at(121.69), None, I),
        (GATE, at(121.67), None, U),
        (GATE, at(118.33), None, U),
        (GATE, at(118.31), None, O),
        (GATE, at(198.3), None, I),
        (GATE, at(202), None, O),
        (GATE, at(160, 50), None, U),
        # Each side has a width of its own.
        (GATE, Span(123, 122, 180), None, U),
        (GATE, Span(123, 122, 160), None, I),
        # A contact is not beyond the ends of the beam.
        (Zone(from_mm=0, to_mm=120), Span(1, -3, 4), None, I),
        (Zone(from_mm=300, to_mm=400), at(399.5, 2), None, I),
        # A force out of bounds is enough for `outside`; a force that is not known, for `unsure`.
        (PRESSED, at(150), at(10), I),
        (PRESSED, at(150), at(6), U),
        (PRESSED, at(150), at(3), O),
        (PRESSED, at(150), at(17), O),
        (PRESSED, at(100), at(10), O),
        (PRESSED, at(150), None, U),
        (Zone(from_mm=120, to_mm=200, largest_force_n=5), at(150), Span(1, -1, 2), I),
    ],
)
def test_an_interval_lies_to_a_zone(zone: Zone, position: Span, force: Span | None, lies: ZoneState) -> None:
    assert zone.lies(position, force, LENGTH_MM, BEGIN) is lies


def steps(*whats: What) -> list[Step]:
    return [(what, STEP_US, 1) for what in whats]


STORIES: dict[str, tuple[Zone, list[Step], list[ZoneState | None], int]] = {
    "an answer is harder to begin than to keep": (
        GATE,
        steps(121.7, 121.4, 121.2, 121.4, 121.7, 118.6, 118.3, 118.6, 118.8, 118.6),
        [I, I, U, U, I, U, O, O, U, U],
        1,
    ),
    "an entry follows on outside, not on unsure": (GATE, steps(150, 120, 150, 100, 150), [I, U, I, O, I], 2),
    "a lift ends the stay": (GATE, steps(150, "clear", 150), [I, O, I], 2),
    "a touch beside the edge of a clear beam is not sure to be outside": (GATE, steps("clear", 118.6), [O, U], 0),
    "without a contact to judge there is no answer": (GATE, steps(150, None, 150), [I, None, I], 2),
    "inside comes after the dwell": (SLOW, steps(*[150] * 6), [U, U, U, U, I, I], 1),
    "what interrupts the contact begins the dwell anew": (
        SLOW,
        steps(150, 150, 150, 150, 121, *[150] * 5),
        [U, U, U, U, U, U, U, U, U, I],
        1,
    ),
    "where samples are missing, the dwell begins anew": (
        SLOW,
        [*steps(*[150] * 4), (150, 90_000, 18), *steps(*[150] * 4)],
        [*[U] * 8, I],
        1,
    ),
    "where a sample is missing, an answer begins anew, but a contact does not enter again": (
        GATE,
        [*steps(121.7, 121.4), (121.4, 2 * STEP_US, 2), *steps(121.7), (150, 2 * STEP_US, 2)],
        [I, I, U, I, I],
        1,
    ),
    "samples at rest count in full": (SLOW, [*steps(150), (150, 90_000, 1)], [U, I], 1),
    "after a pause longer than a contact is held nothing is known": (
        SLOW,
        [*steps(*[150] * 5), (150, 100_001, 1), *steps(*[150] * 4)],
        [U, U, U, U, I, U, U, U, U, I],
        2,
    ),
    "a clock that is set back takes no time away": (
        SLOW,
        [*steps(150, 150, 150), (150, -1, 1), *steps(150, 150), (150, -90_000, 1)],
        [U, U, U, U, U, I, I],
        1,
    ),
}


def follower_of(zone: Zone, former: ZoneFollower | None = None) -> ZoneFollower:
    """Return the follower of a zone, which goes on from the memory of a former one."""
    memory = json.loads(json.dumps(former.memory)) if former else None
    return ZoneFollower({"gate": zone}, LENGTH_MM, HOLD_US, memory)


def reports_of(zone: Zone, story: list[Step], *, restarts: bool = False) -> list[ZoneReport]:
    """Return what each sample shows, to a service that is started anew after each of them if it `restarts`."""
    follower, at_us, found = follower_of(zone), 1_000_000, []
    for what, passed_us, more in story:
        at_us += passed_us
        if more > 1:
            follower.miss()
        position = at(what) if isinstance(what, float | int) else None
        found.append(follower.step(Seen(at_us, what == "clear", position)))
        follower = follower_of(zone, follower) if restarts else follower
    return found


@pytest.mark.parametrize("name", STORIES)
def test_answers_of_consecutive_samples(name: str) -> None:
    zone, story, expected, entries = STORIES[name]
    reports = reports_of(zone, story)
    assert [report.answers["gate"] for report in reports] == expected
    assert sum(len(report.entered) for report in reports) == entries


@pytest.mark.parametrize("name", STORIES)
def test_every_report_is_the_same_through_any_restart(name: str) -> None:
    zone, story, _, _ = STORIES[name]
    assert reports_of(zone, story, restarts=True) == reports_of(zone, story)


def test_the_dwell_is_part_of_the_time_inside() -> None:
    each = [report.stays_us.get("gate") for report in reports_of(SLOW, steps(*[150] * 6, 100))]
    assert each == [None, None, None, None, 20_000, 5000, None]


def test_a_zone_that_is_defined_anew_begins_anew() -> None:
    follower = follower_of(SLOW)
    for at_us in range(0, 25_000, STEP_US):
        report = follower.step(Seen(at_us, position=at(150)))
    assert report.answers == {"gate": I}
    seen = Seen(25_000, position=at(150))
    assert follower_of(SLOW.model_copy(update={"from_mm": 110.0}), follower).step(seen).answers == {"gate": U}
    assert follower_of(SLOW, follower).step(seen).answers == {"gate": I}


def row(position_mm: float, force_n: float = 10.0) -> Row:
    """Deflections of a contact under the small model."""
    second = (position_mm - 100) / 100
    return [force_n / 10 - second, second, 0.0]


def zoned() -> Surface:
    return surface_of(section=SurfaceSection(zones={"gate": GATE, "slow": SLOW}))


def zones_of(bench: Bench) -> dict[str, str | None]:
    found: dict[str, str | None] = bench.contact()["zones"]
    return found


def test_a_contact_that_is_doubted_is_in_no_zone() -> None:
    bench = Bench(zoned())
    missing = {"quality": ["good", "missing", "good"]}
    rows: list[tuple[Row, int, dict[str, Any], str | None]] = [
        (row(150), 4, {}, "inside"),
        (row(150, 60), 4, {}, None),  # overload
        ([0.5, None, 0.0], 4, missing, None),  # unchecked
        ([0.0, 0.0, 0.0], 4, {}, "outside"),
        (row(150), 1, {}, "inside"),
        (ODD, 1, {}, None),  # still a contact, which does not explain the sample
        (ODD, 2, {}, None),  # unexplained
    ]
    sequence = 1
    for deflection, count, quality, answer in rows:
        bench.post(batch_of(*[deflection] * count, sequence=sequence, **quality))
        sequence += count
        assert zones_of(bench)["gate"] == answer, deflection
    assert bench.get("/metrics").text.count('beamtouch_zone_entries_total{surface="press-7",zone="gate"} 2.0') == 1


def test_a_stale_contact_is_in_no_zone_and_counts_anew_when_samples_return() -> None:
    bench = Bench(zoned())
    bench.post(batch_of(*[row(150)] * 5))
    assert zones_of(bench) == {"gate": "inside", "slow": "inside"}
    assert 'beamtouch_zone{answer="inside",surface="press-7",zone="gate"} 1.0' in bench.get("/metrics").text
    bench.now_s += 1.0
    assert bench.get("/contact").status_code == 503
    assert 'beamtouch_zone{answer="inside"' not in bench.get("/metrics").text
    later = batch_of(row(150), sequence=6)
    later["samples"][0]["acquired_unix_us"] += 1_000_000
    bench.post(later)
    assert zones_of(bench)["slow"] == "unsure"


class Touch:
    """A contact whose samples come one at a time, 5 ms apart by their ages."""

    def __init__(self) -> None:
        self.bench, self.sequence, self.clock_us = Bench(zoned()), 0, 0

    def goes_on(self, *, clock_us: int = STEP_US) -> dict[str, str | None]:
        """Send the next sample, with the clock of the sender that much later; return the answers."""
        self.sequence, self.clock_us = self.sequence + 1, self.clock_us + clock_us
        self.bench.now_s += STEP_US / 1e6
        batch = batch_of(row(150.0), sequence=self.sequence)
        batch["samples"][0]["acquired_unix_us"] += self.clock_us
        self.bench.send(members=batch)
        return zones_of(self.bench)

    @property
    def entries(self) -> list[str]:
        """The counters of both zones."""
        return [text.split()[-1] for text in self.bench.metrics().splitlines() if text.startswith(ENTRIES)]


ENTRIES = "beamtouch_zone_entries_total{"


def test_a_clock_that_is_set_makes_no_contact_older_and_lets_none_enter_twice() -> None:
    touch = Touch()
    touch.goes_on()
    for _ in range(3):
        assert touch.goes_on(clock_us=450_000) == {"gate": "inside", "slow": "unsure"}
    assert touch.goes_on() == {"gate": "inside", "slow": "inside"}
    for clock_us in (-1, -1000, -3_600_000_000, 3_600_000_000):
        assert touch.goes_on(clock_us=clock_us) == {"gate": "inside", "slow": "inside"}
    assert touch.entries == ["1.0", "1.0"]


def test_with_another_sender_a_contact_enters_anew() -> None:
    touch = Touch()
    for _ in range(5):
        answers = touch.goes_on()
    assert answers == {"gate": "inside", "slow": "inside"}
    touch.sequence += 1  # a sample is missing
    assert touch.goes_on() == {"gate": "inside", "slow": "unsure"}
    assert touch.entries == ["1.0", "1.0"]
    touch.bench.send(row(150), boot_id="boot-0002")
    assert zones_of(touch.bench) == {"gate": "inside", "slow": "unsure"}
    assert touch.entries == ["2.0", "1.0"]


def test_while_two_daemons_send_a_contact_is_in_no_zone() -> None:
    bench, answers = Bench(zoned()), []
    for number in range(1, 11):
        bench.now_s += STEP_US / 1e6
        for boot_id in ("daemon-one", "daemon-two"):
            bench.send(row(150), sequence=number, boot_id=boot_id)
        answers.append((bench.contact()["notes"], zones_of(bench)["gate"]))
    assert answers[0] == ([], "inside")
    assert answers[-1] == (["senders"], None)


@pytest.mark.parametrize("shared", [False, True])
def test_events_say_which_zones_and_for_how_long(tmp_path: Path, *, shared: bool) -> None:
    """Also if another service takes over in the middle of the dwell."""
    rest: Row = [0.0, 0.0, 0.0]
    rows = [rest, *[row(150)] * 7, *[row(250)] * 3, rest]

    def served() -> tuple[Bench, Recorder]:
        recorder = Recorder(EventsSection(file=tmp_path / "events.db"))
        return Bench(zoned(), recorder=recorder), recorder

    bench, recorder = served()
    bench.post(batch_of(*rows[:4]) | {"oldest": 1})
    assert [one["zones"] for one in bench.get("/events").json()["events"]] == [{"gate": 10.0}]
    if shared:
        recorder.close()
        bench, recorder = served()
    rest_of_it = batch_of(*rows[4:], sequence=5) | {"oldest": 1}
    for sample in rest_of_it["samples"]:
        sample["acquired_unix_us"] += 4 * STEP_US
    bench.post(rest_of_it)
    (event,) = bench.get("/events").json()["events"]
    assert (event["end"], event["zones"]) == ("lift", {"gate": 30.0, "slow": 30.0})
    assert '"{""gate"": 30.0, ""slow"": 30.0}"' in bench.get("/events?format=csv").text
    recorder.close()


def test_the_beam_is_drawn_with_its_zones() -> None:
    zones = Bench(zoned()).get("/surfaces/press-7/beam").json()["zones"]
    assert (zones["gate"]["from_mm"], zones["slow"]["dwell_ms"]) == (120.0, 20.0)


def test_the_register_map_says_where_each_zone_is(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "service.toml"
    zones = "zones.gate = { from_mm = 0, to_mm = 9 }\nzones.end = { from_mm = 9, to_mm = 20 }\n"
    path.write_text(f"[surfaces.press-6]\n[surfaces.press-7]\n{zones}")
    assert cli.main(["registers", "--config", str(path)]) == 0
    printed = capsys.readouterr().out
    assert "| `press-7` | 2    | `end`  | bits 2 and 3 of address 92 are both set | address 94 |" in printed


@pytest.mark.parametrize(
    ("zone", "reason"),
    [
        ({"from_mm": 300, "to_mm": 500}, "to_mm = 500 is beyond the end of the beam, which is 400 mm long"),
        (
            {"from_mm": 300, "to_mm": 400, "largest_force_n": 5},
            'a bound of the force needs a scene with "force" in its descriptors',
        ),
    ],
)
def test_a_zone_that_the_model_cannot_have_is_refused_in_one_line(
    build_model: BuildModel,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    zone: dict[str, float],
    reason: str,
) -> None:
    path = tmp_path / "service.toml"
    keys = "\n".join(f"zones.gate.{key} = {value}" for key, value in zone.items())
    path.write_text(f"[surfaces.press-7]\nmodel = '{build_model(outputs=POSITION_OUTPUTS)}'\n{keys}\n")
    assert cli.main(["check", "--config", str(path)]) == 2
    assert capsys.readouterr().err == f"beamtouch-service: surfaces.press-7.zones.gate: {reason}\n"


@pytest.mark.anyio
async def test_a_new_model_that_a_zone_is_off_leaves_the_old_one_in_use(build_model: BuildModel) -> None:
    path = build_model()
    surface = Surface("press-7", models.load(path), SurfaceSection(zones={"gate": PRESSED}))
    keeper = ModelKeeper(surface, path, models.stamp_of(path))
    other = build_model(name="other", outputs=POSITION_OUTPUTS)
    other.replace(path)
    for _ in range(2):
        await keeper.poll()
    assert surface.model is not None
    assert surface.model.metadata.name == "press-7"
    assert surface.model_error is not None
    assert f"{path}: gate: a bound of the force needs a scene" in surface.model_error


@pytest.mark.anyio
async def test_a_model_whose_samples_arrive_at_last_is_refused_once_for_a_zone(
    build_model: BuildModel, caplog: pytest.LogCaptureFixture
) -> None:
    path = build_model()
    surface = Surface("press-7", models.load(path), SurfaceSection(zones={"gate": PRESSED}))
    keeper = ModelKeeper(surface, path, models.stamp_of(path))
    surface.receive(parsed(), 10.0)
    build_model(name="five", channels=5, outputs=POSITION_OUTPUTS).replace(path)
    for _ in range(3):
        await keeper.poll()
    assert "it needs s4, s5, but" in str(surface.model_error)
    surface.receive(parsed([0.5] * 5, boot_id="boot-0002"), 10.1)
    for _ in range(3):
        await keeper.poll()
    assert surface.model is not None
    assert surface.model.metadata.name == "press-7"
    assert f"{path}: gate: a bound of the force needs a scene" in str(surface.model_error)
    assert len(caplog.records) == 2
