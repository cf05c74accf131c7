"""A surface that stays unexplained: in the summary, the metrics, the stream and the log."""

from __future__ import annotations

import logging
from typing import TYPE_CHECKING

import pytest
from prometheus_client.parser import text_string_to_metric_families

from beamtouch_models import modelfile
from beamtouch_service.api.stream import Pace
from beamtouch_service.sections import SurfaceSection
from beamtouch_service.surfaces.surface import Surface
from service.event_story import ODD, RESTING, TOUCHING, Row, Story

if TYPE_CHECKING:
    from service.conftest import Bench, BuildModel, MakeBatch

WEDGED: Row = [0.5, 0.25, 0.75, 0.125]
"""Without s3, a contact."""


def values(bench: Bench) -> dict[str, float]:
    """Metrics of the only surface: name and further label -> value."""
    families = text_string_to_metric_families(bench.get("/metrics").text)
    return {
        ".".join([sample.name, *(sample.labels[name] for name in sorted(sample.labels) if name != "surface")]): (
            sample.value
        )
        for family in families
        for sample in family.samples
    }


@pytest.fixture
def soon(make_bench: type[Bench], build_model: BuildModel) -> Bench:
    model = modelfile.load(build_model(channels=4))
    return make_bench(Surface("press-7", model, SurfaceSection(unexplained_after_s=0.5)))


def deliver(story: Story, first: int, last: int) -> None:
    """Send samples as the time passes that they took."""
    story.bench.now_s += (last - first) * 0.005
    story.deliver(first, last)


def test_a_wall_clock_that_goes_back_within_a_batch_delays_no_alarm(soon: Bench, make_batch: MakeBatch) -> None:
    turned_back = make_batch(*[[0.0] * 4] * 10)
    for sample in turned_back["samples"][:5]:
        sample["acquired_unix_us"] += 3_600_000_000
    assert soon.post(turned_back).status_code == 200
    for sequence in range(11, 311, 10):
        soon.now_s += 0.05
        assert soon.post(make_batch(*[WEDGED] * 10, sequence=sequence)).status_code == 200
    found = values(soon)
    assert found["beamtouch_unexplained"] == 1
    assert found["beamtouch_unexplained_seconds_total"] == pytest.approx(1.5, abs=0.1)


def test_the_time_that_a_device_was_off_is_not_unexplained(soon: Bench, make_batch: MakeBatch) -> None:
    story = Story(soon, make_batch, [WEDGED] * 40)
    deliver(story, 0, 20)
    soon.now_s += 3600.0
    deliver(story, 20, 21)
    assert values(soon)["beamtouch_unexplained_seconds_total"] < 1.0


def test_a_stretch_that_lasts_raises_a_metric_and_writes_one_line(
    soon: Bench, make_batch: MakeBatch, caplog: pytest.LogCaptureFixture
) -> None:
    resting: Row = [0.0] * 4
    story = Story(soon, make_batch, [resting, *[WEDGED] * 300, *[resting] * 4, *[WEDGED] * 200])
    with caplog.at_level(logging.WARNING, "beamtouch.service"):
        deliver(story, 0, 90)
        found = values(soon)
        assert (found["beamtouch_unexplained"], found["beamtouch_unexplained_stretches_total"]) == (0, 1)
        assert found["beamtouch_unexplained_seconds_total"] == pytest.approx(0.43)
        assert caplog.messages == []

        for first in range(90, 300, 30):
            deliver(story, first, first + 30)
        found = values(soon)
        assert (found["beamtouch_unexplained"], found["beamtouch_unexplained_stretches_total"]) == (1, 1)
        assert (found["beamtouch_state.unexplained"], found["beamtouch_state.clear"]) == (1, 0)
        assert found["beamtouch_note.check-s3"] == 1
        assert caplog.messages == [
            "surface press-7: since 2026-11-20T23:40:46.138Z neither rest nor a single contact explains the samples "
            "(over 0.5 s); check sensor s3: without it, everything is explained"
        ]

        deliver(story, 300, 305)
        assert values(soon)["beamtouch_unexplained"] == 0
        deliver(story, 305, 505)
        assert len(caplog.messages) == 2
    found = values(soon)
    assert found["beamtouch_unexplained_stretches_total"] == 2
    assert found["beamtouch_unexplained_seconds_total"] == pytest.approx(1.49 + 0.985, abs=0.02)
    # The samples stop: nothing is known of the surface.
    soon.now_s += 10
    found = values(soon)
    assert (found["beamtouch_unexplained"], found["beamtouch_state.unexplained"]) == (0, 0)


def test_without_a_suspect_the_line_says_what_to_look_for(
    make_bench: type[Bench], build_model: BuildModel, make_batch: MakeBatch, caplog: pytest.LogCaptureFixture
) -> None:
    bench = make_bench(Surface("press-7", modelfile.load(build_model()), SurfaceSection(unexplained_after_s=0.1)))
    with caplog.at_level(logging.WARNING, "beamtouch.service"):
        # The stretch has ended by the end of the batch.
        Story(bench, make_batch, [RESTING, *[ODD] * 50, *[RESTING] * 5]).deliver(0, 56)
    (line,) = caplog.messages
    assert line.endswith("anything that touches the beam from below, for swapped cables, and for a damaged sensor")


def test_summary_stream_and_counters_carry_the_state(soon: Bench, make_batch: MakeBatch) -> None:
    def summary() -> tuple[str | None, list[str]]:
        found = soon.get("/surfaces/press-7").json()
        assert soon.get("/surfaces").json() == {"surfaces": [found]}
        return found["state"], found["notes"]

    assert summary() == (None, [])
    touching: Row = [*TOUCHING, 0.0]
    story = Story(soon, make_batch, [touching, *[WEDGED] * 60])
    story.deliver(0, 1)
    assert summary() == ("contact", [])
    story.deliver(1, 2)
    assert summary() == ("contact", ["unsteady"])
    story.deliver(2, 61)
    assert summary() == ("unexplained", ["check-s3"])

    event = Pace().next(soon.app.context.registry.named("press-7"), soon.now_s)
    assert event is not None
    assert '"state": "unexplained", "position_mm": null' in event
    assert '"notes": ["check-s3"]' in event
    contact = soon.get("/contact").json()
    assert (contact["state"], contact["position_mm"], contact["force_n"]) == ("unexplained", None, None)
    assert values(soon)["beamtouch_contacts_total.unexplained"] == 1
    soon.now_s += 10
    assert summary() == (None, [])
