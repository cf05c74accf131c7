"""The health of sensors, from the contacts on record: changes with their day, kept over restarts, and at every door."""

from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from beamtouch_models import runtime
from beamtouch_models.runtime import BestSample, Health
from beamtouch_service.record.events.best import Best
from beamtouch_service.record.events.health import HealthHistory, StoredHealth
from service.record_days import Days
from service.record_file import execute
from service.touches import TouchedLine
from support.surfaces.deflections import deflections_of
from support.surfaces.small_model import model_of

BASELINE, CHANGED = 100, 14
BEGIN = datetime(2026, 2, 1, 12, tzinfo=UTC)
DAY = datetime(2026, 3, 3, 12, tzinfo=UTC)


@pytest.fixture
def line(bench_model: Path, tmp_path: Path) -> TouchedLine:
    return TouchedLine(bench_model, tmp_path / "events.db")


def health(line: TouchedLine) -> dict[str, Any]:
    health: dict[str, Any] = line.summary["health"]
    return health


@pytest.mark.promise(
    "docs/reference/sensor-health.md",
    (
        "`changed` is true if the change is certain. Then `since` is about the time of the change, and `contacts` "
        "counts the contacts after it."
    ),
)
@pytest.mark.promise("docs/reference/http.md", "a sensor is out or has changed for certain")
def test_a_gain_that_falls_is_named_with_its_day_at_every_door_and_survives_a_kill(line: TouchedLine) -> None:
    assert health(line) == {}
    line.touch(BASELINE, BEGIN, 3600)
    for one in health(line).values():
        assert (one["changed"], one["contacts"]) == (False, BASELINE)
        assert one["gain_low_percent"] < 0 < one["gain_high_percent"]
        assert one["zero_low_mm"] < 0 < one["zero_high_mm"]
        assert one["since"].startswith("2026-02-01T12:")
    assert line.bench.get("/health/ready?health=true").status_code == 200

    line.touches.gain[1] = 0.95
    line.touch(CHANGED, DAY)
    found = health(line)
    assert {name: one["changes"] for name, one in found.items()} == {"s1": [], "s2": ["gain"], "s3": [], "s4": []}
    assert found["s2"]["gain_low_percent"] < -5 < found["s2"]["gain_high_percent"] < -3
    assert found["s2"]["since"].startswith("2026-03-03")
    low = 'beamtouch_gain_change_percent{bound="low",channel="s2",surface="press-7"}'
    assert 'beamtouch_channel_changed{channel="s2",surface="press-7"} 1.0' in line.bench.metrics()
    assert 'beamtouch_channel_changed{channel="s1",surface="press-7"} 0.0' in line.bench.metrics()
    assert f"{low} {found['s2']['gain_low_percent']}" in line.bench.metrics()
    # A problem only for those who ask.
    assert line.bench.get("/health/ready").status_code == 200
    problem = line.bench.get("/health/ready?health=true").json()["surfaces"]["press-7"]
    assert problem["type"].endswith(":changed-channels")
    assert problem["changed_channels"] == ["s2"]

    line.start()
    # Contacts are read again in other groups, so that they may weigh a little more or less.
    assert {name: one["changes"] for name, one in health(line).items()} == {
        "s1": [],
        "s2": ["gain"],
        "s3": [],
        "s4": [],
    }
    assert health(line)["s2"]["since"] == found["s2"]["since"]


@pytest.mark.promise(
    "docs/reference/sensor-health.md",
    "anew when the model changes or the daemon names another characteristic or tare",
)
@pytest.mark.promise(
    "docs/how-to/spare-part.md",
    "`health` of the sensors begins anew, with the new tare and with the new model",
)
def test_another_characteristic_begins_anew(line: TouchedLine, caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level("INFO", "beamtouch_service.record")
    line.touch(30, BEGIN)
    assert "starts over" not in caplog.text
    line.touches.characteristic = "tared-again"
    line.touch(4, DAY)
    assert [text for text in caplog.messages if "starts over" in text] == [
        "surface press-7: another characteristic or tare; the health of its sensors starts over"
    ]
    assert {(one["contacts"], one["since"][:10]) for one in health(line).values()} == {(4, "2026-03-03")}


def test_figures_are_those_of_the_history_in_percent_and_mm(bench_model: Path) -> None:
    model = runtime.load(bench_model)
    sums, history = Health(model.metadata), HealthHistory("press-7", model, StoredHealth())
    for number, position_mm in enumerate((100.0, 180.0, 260.0), 1):
        (deflection,) = deflections_of(model, np.array([position_mm]), np.array([3.0])).tolist()
        deflection[1] *= 0.95
        deviation, rest = [0.001] * len(deflection), [0.002] * len(deflection)
        history.add([Best(number, True, 16, None, model.channels, deflection, deviation, rest, deviation)])
        sums.add([BestSample(number, deflection, deviation, rest, deviation)])
    for found, change in zip(history.state.channels.values(), sums.channels(), strict=True):
        gain, zero = change.gain, change.zero
        assert zero is not None
        percent = found.gain_percent, found.gain_low_percent, found.gain_high_percent
        assert percent == tuple(round(value * 100, 3) for value in (gain.value, gain.low, gain.high))
        mm = found.zero_mm, found.zero_low_mm, found.zero_high_mm
        assert mm == tuple(round(value, 6) for value in (zero.value, zero.low, zero.high))


def test_of_contacts_that_come_together_those_that_say_nothing_are_passed_over_one_by_one() -> None:
    """A late one of another characteristic, one of other channels, and one without a rest before it."""
    model = model_of()

    def best(at_us: int, characteristic: str, channels: list[str], rest_mm: list[float] | None) -> Best:
        return Best(at_us, True, 16, characteristic, channels, [0.5, 0.25, 0.13], [0.01] * 3, rest_mm, [0.01] * 3)

    at_rest, channels = [0.001, 0.002, 0.0], model.channels
    history = HealthHistory("press-7", model, StoredHealth())
    history.add([best(5000, "new", channels, at_rest)])
    late, others = best(4000, "old", channels, at_rest), best(6000, "new", ["x", "y", "z"], at_rest)
    whole, restless = best(7000, "new", channels, at_rest), best(8000, "new", channels, None)
    history.add([late, others, whole, restless, best(9000, "new", channels, at_rest)])
    assert [one.contacts for one in history.state.channels.values()] == [3, 3, 3]
    assert history.next is not None
    assert (history.next.characteristic, history.next.newest_us, history.next.version) == ("new", 9000, 1)


@pytest.mark.promise("docs/reference/sensor-health.md", "It is kept with the events, without the limit of `keep_days`.")
def test_health_outlives_the_events_that_it_is_made_from(line: TouchedLine) -> None:
    line.touch(12, BEGIN)
    days = Days()
    days.run(line.bench)
    days.run(line.bench, 31)
    assert line.bench.get("/events").json()["events"] == []
    for _ in range(2):
        assert {(one["contacts"], one["since"][:10]) for one in health(line).values()} == {(12, "2026-02-01")}
        line.start()


def test_a_clock_that_was_years_ahead_does_not_stop_the_health_of_what_comes_after_the_next_tare(
    line: TouchedLine,
) -> None:
    now = datetime.now(UTC)
    line.touch(4, now + timedelta(days=3653))
    line.touch(4, now - timedelta(hours=2))
    line.touches.characteristic = "tared-again"
    line.touch(4, now - timedelta(hours=1))
    assert {(one["contacts"], one["since"][:4]) for one in health(line).values()} == {(4, str(now.year))}
    # Late contacts from before it still begin nothing.
    line.touches.characteristic = "before"
    line.touch(4, now - timedelta(hours=3))
    line.touches.characteristic = "tared-again"
    line.touch(4, now - timedelta(minutes=30))
    assert {one["contacts"] for one in health(line).values()} == {8}


@pytest.mark.parametrize(
    ("damage", "place"),
    [
        ("UPDATE health_blocks SET block = substr(block, 2)", "table health_blocks, column block: Extra data"),
        ("UPDATE health_blocks SET block = '5'", "table health_blocks, column block: Input should be a valid list"),
        ("UPDATE health_blocks SET first_us = 'abc'", "table health_blocks, column first_us: Input should be"),
        ("UPDATE health SET newest_us = 'abc'", "table health, column newest_us: Input should be"),
        ("UPDATE health SET version = 'abc'", "table health, column version: Input should be"),
        ("UPDATE health SET version = -1", "table health, column version: Input should be"),
    ],
)
def test_a_damaged_health_begins_anew_and_is_named_once(
    line: TouchedLine, tmp_path: Path, caplog: pytest.LogCaptureFixture, damage: str, place: str
) -> None:
    line.touch(1, BEGIN)
    execute(tmp_path / "events.db", damage)
    line.start()
    assert health(line) == {}
    assert "events" not in line.bench.get("/health/ready").json().get("missing", {})
    line.touch(4, DAY)
    assert {(one["contacts"], one["since"][:10]) for one in health(line).values()} == {(4, "2026-03-03")}
    (said,) = [text for text in caplog.messages if "starts over" in text]
    assert said.startswith("surface press-7: its health starts over: ")
    assert place in said
    line.start()
    assert {one["contacts"] for one in health(line).values()} == {4}
    assert caplog.text.count("starts over") == 1
    assert "the record of events is" not in caplog.text
    assert "Traceback" not in caplog.text
