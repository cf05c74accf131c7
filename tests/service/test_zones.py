"""Zones in the answers of a service: what is in no zone, counts, events, and what is refused."""

from pathlib import Path
from typing import Any

import pytest

from beamtouch_common.zones import Zone
from beamtouch_models.runtime.metadata import POSITION_OUTPUTS
from beamtouch_service import cli
from beamtouch_service.sections import EventsSection, SurfaceSection
from service.bench import Bench, BuildModel, Row, batch_of, surface_of
from service.event_story import ODD

ZONES = SurfaceSection(zones={"gate": Zone(from_mm=120, to_mm=200), "slow": Zone(from_mm=120, to_mm=200, dwell_ms=20)})
STEP_US = 5000


def row(position_mm: float, force_n: float = 10.0) -> Row:
    """Deflections of a contact under the small model."""
    second = (position_mm - 100) / 100
    return [force_n / 10 - second, second, 0.0]


def zoned(events: EventsSection | None = None) -> Bench:
    return Bench(surface_of(section=ZONES), events=events)


def zones_of(bench: Bench) -> dict[str, str | None]:
    found: dict[str, str | None] = bench.contact()["zones"]
    return found


@pytest.mark.promise(
    "docs/how-to/zones.md",
    (
        "there is no contact to judge: the state or the sample is unexplained, a clear beam is `unsteady`, or a note "
        "is `overload`, `unchecked` or `senders`"
    ),
)
def test_a_contact_that_is_doubted_is_in_no_zone() -> None:
    bench = zoned()
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


@pytest.mark.promise(
    "docs/how-to/zones.md",
    "With a problem (503) there is no contact, and so no answer.",
    "After a pause longer than `stale_ms`",
)
def test_a_stale_contact_is_in_no_zone_and_counts_anew_when_samples_return() -> None:
    bench = zoned()
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
        self.bench, self.sequence, self.clock_us = zoned(), 0, 0

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


@pytest.mark.promise(
    "docs/how-to/zones.md",
    "The dwell is counted by the ages of the samples, so setting the clock of the sender changes no answer.",
)
def test_a_clock_that_is_set_makes_no_contact_older_and_lets_none_enter_twice() -> None:
    touch = Touch()
    touch.goes_on()
    for _ in range(3):
        assert touch.goes_on(clock_us=450_000) == {"gate": "inside", "slow": "unsure"}
    assert touch.goes_on() == {"gate": "inside", "slow": "inside"}
    for clock_us in (-1, -1000, -3_600_000_000, 3_600_000_000):
        assert touch.goes_on(clock_us=clock_us) == {"gate": "inside", "slow": "inside"}
    assert touch.entries == ["1.0", "1.0"]


@pytest.mark.promise(
    "docs/how-to/zones.md",
    "its answer and its dwell begin anew, but no second entry is counted.",
    "with another sender",
)
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


@pytest.mark.promise("docs/how-to/zones.md", "or a note is `overload`, `unchecked` or `senders`")
def test_while_two_daemons_send_a_contact_is_in_no_zone() -> None:
    bench, answers = zoned(), []
    for number in range(1, 11):
        bench.now_s += STEP_US / 1e6
        for boot_id in ("daemon-one", "daemon-two"):
            bench.send(row(150), sequence=number, boot_id=boot_id)
        answers.append((bench.contact()["notes"], zones_of(bench)["gate"]))
    assert answers[0] == ([], "inside")
    assert answers[-1] == (["senders"], None)


@pytest.mark.promise(
    "docs/reference/events.md",
    "Zone that the contact was inside -> for how long [ms]. Left out if it was inside none.",
)
@pytest.mark.parametrize("shared", [False, True])
def test_events_say_which_zones_and_for_how_long(tmp_path: Path, *, shared: bool) -> None:
    """Also if another service takes over in the middle of the dwell."""
    rest: Row = [0.0, 0.0, 0.0]
    rows = [rest, *[row(150)] * 7, *[row(250)] * 3, rest]
    events = EventsSection(file=tmp_path / "events.db")
    bench = zoned(events)
    bench.post(batch_of(*rows[:4]) | {"oldest": 1})
    assert [one["zones"] for one in bench.get("/events").json()["events"]] == [{"gate": 10.0}]
    if shared:
        bench.stop()
        bench = zoned(events)
    rest_of_it = batch_of(*rows[4:], sequence=5) | {"oldest": 1}
    for sample in rest_of_it["samples"]:
        sample["acquired_unix_us"] += 4 * STEP_US
    bench.post(rest_of_it)
    (event,) = bench.get("/events").json()["events"]
    assert (event["end"], event["zones"]) == ("lift", {"gate": 30.0, "slow": 30.0})
    assert '"{""gate"": 30.0, ""slow"": 30.0}"' in bench.get("/events?format=csv").text


def test_the_beam_is_drawn_with_its_zones() -> None:
    zones = zoned().get("/surfaces/press-7/beam").json()["zones"]
    assert (zones["gate"]["from_mm"], zones["slow"]["dwell_ms"]) == (120.0, 20.0)


def test_the_register_map_says_where_each_zone_is(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "service.toml"
    zones = "zones.gate = { from_mm = 0, to_mm = 9 }\nzones.end = { from_mm = 9, to_mm = 20 }\n"
    path.write_text(f"[surfaces.press-6]\n[surfaces.press-7]\n{zones}")
    assert cli.main(["registers", "--config", str(path)]) == 0
    printed = capsys.readouterr().out
    assert "| `press-7` | 2    | `end`  | bits 2 and 3 of address 102 are both set | address 104 |" in printed


@pytest.mark.promise(
    "docs/how-to/zones.md",
    "A zone beyond the end of the beam, or a bound of the force for a model that states none, is refused at the start.",
)
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
