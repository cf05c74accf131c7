"""What a surface says when something is wrong for too long: unexplained, a channel out, a wrong wiring; and metrics."""

import json
from collections.abc import Iterator
from datetime import UTC, datetime, timedelta
from pathlib import Path

import pytest
from prometheus_client.parser import text_string_to_metric_families

from beamtouch_models import runtime
from beamtouch_service.sections import SurfaceSection
from service.bench import Bench, Row, batch_of, surface_of, surface_with
from service.event_story import Story
from service.touches import Change, TouchedLine

WEDGED: Row = [0.5, 0.25, 0.75, 0.125]
"""Without s3, a contact."""


def metrics(bench: Bench) -> dict[str, float]:
    """Values by name and further labels, the surface first."""
    response = bench.get("/metrics")
    assert response.headers["content-type"].startswith("text/plain; version=")
    return {
        ".".join([sample.name, *(sample.labels[name] for name in sorted(sample.labels, key=_surface_first))]): (
            sample.value
        )
        for family in text_string_to_metric_families(response.text)
        for sample in family.samples
    }


def _surface_first(label: str) -> tuple[bool, str]:
    return label != "surface", label


@pytest.fixture
def soon() -> Bench:
    return Bench(surface_of(section=SurfaceSection(unexplained_after_s=0.5, degraded_after_s=2.0), channels=4))


def deliver(story: Story, first: int, last: int) -> None:
    """Send samples as the time passes that they took."""
    story.bench.now_s += (last - first) * 0.005
    story.deliver(first, last)


@pytest.mark.promise(
    "docs/reference/service-configuration.md",
    "A state `unexplained` that lasts longer raises a metric and writes a line to the log.",
)
@pytest.mark.promise("docs/reference/metrics.md", "they ignore what lasts less than `unexplained_after_s`")
def test_a_stretch_that_lasts_raises_a_metric_and_writes_one_line(
    soon: Bench, caplog: pytest.LogCaptureFixture
) -> None:
    caplog.set_level("WARNING", "beamtouch_service")
    resting: Row = [0.0] * 4
    story = Story(soon, [resting, *[WEDGED] * 300, *[resting] * 4, *[WEDGED] * 200])
    deliver(story, 0, 90)
    found = metrics(soon)
    assert found["beamtouch_unexplained.press-7"] == 0
    assert found["beamtouch_unexplained_stretches_total.press-7"] == 1
    assert found["beamtouch_unexplained_seconds_total.press-7"] == pytest.approx(0.43)
    assert caplog.messages == []
    for first in range(90, 300, 30):
        deliver(story, first, first + 30)
    found = metrics(soon)
    assert found["beamtouch_unexplained.press-7"] == found["beamtouch_state.press-7.unexplained"] == 1
    assert found["beamtouch_note.press-7.check-s3"] == 1
    assert caplog.messages == [
        "surface press-7: since 2026-11-20T23:40:46.138Z neither rest nor a single contact explains the samples "
        "(over 0.5 s); check sensor s3: without it, everything is explained"
    ]
    deliver(story, 300, 305)
    assert metrics(soon)["beamtouch_unexplained.press-7"] == 0
    deliver(story, 305, 505)
    assert len(caplog.messages) == 2
    found = metrics(soon)
    assert found["beamtouch_unexplained_stretches_total.press-7"] == 2
    assert found["beamtouch_unexplained_seconds_total.press-7"] == pytest.approx(1.49 + 0.985, abs=0.02)
    # The samples stop: nothing is known of the surface, nor of the time until they come again.
    soon.now_s += 3600.0
    found = metrics(soon)
    assert found["beamtouch_unexplained.press-7"] == found["beamtouch_state.press-7.unexplained"] == 0
    Story(soon, [*story.rows, WEDGED]).deliver(505, 506)
    assert metrics(soon)["beamtouch_unexplained_seconds_total.press-7"] < 4


@pytest.mark.promise(
    "docs/reference/contact.md",
    "`check-NAME`, only with `unexplained`: channel NAME contradicts the others.",
    "The named channel goes on taking part: nothing is left out by itself.",
)
def test_contact_and_summary_carry_the_state_and_its_suspect(soon: Bench) -> None:
    soon.send(*[WEDGED] * 60)
    contact, summary = soon.contact(), soon.get("/surfaces/press-7").json()
    assert (contact["state"], contact["notes"], contact["position_mm"], contact["force_n"]) == (
        *("unexplained", ["check-s3"], None, None),
    )
    assert (summary["state"], summary["notes"], summary["misfit"]) == ("unexplained", ["check-s3"], contact["misfit"])
    assert (contact["quality"], contact["degraded_channels"]) == ("good", [])
    assert summary["misfit"] > summary["misfit_limit"]
    # A channel that drops out is not named any more.
    soon.send(*[[0.5, 0.25, 0.75, None]] * 3, sequence=61, quality=["good", "good", "good", "missing"])
    assert soon.contact()["notes"] == []
    soon.now_s += 10
    assert soon.get("/surfaces/press-7").json()["state"] is None


MOVED: Row = [0.03, 0.031, 0.029, 0.03]
"""All zeros, by about the same."""


@pytest.mark.promise("docs/reference/contact.md", "with `unexplained` farther or faster than the daemon follows")
@pytest.mark.promise("docs/reference/http.md", "the zeros have moved far")
def test_zeros_that_moved_together_are_warmth_at_every_door(
    bench_model: Path, caplog: pytest.LogCaptureFixture
) -> None:
    caplog.set_level("WARNING", "beamtouch_service")
    soon = Bench(surface_with(runtime.load(bench_model), section=SurfaceSection(unexplained_after_s=0.5)))
    story = Story(soon, [*[[0.0] * 4] * 5, *[MOVED] * 300, *[[0.0] * 4] * 5])
    for first in range(0, 300, 30):
        deliver(story, first, first + 30)
    contact = soon.contact()
    assert (contact["state"], contact["notes"]) == ("unexplained", ["zeros"])
    assert soon.get("/health/ready").status_code == 200
    problem = soon.get("/health/ready?health=true").json()["surfaces"]["press-7"]
    assert problem["type"].endswith(":zeros-moved")
    assert "take everything off it, then tare" in problem["detail"]
    assert metrics(soon)["beamtouch_note.press-7.zeros"] == 1
    (line,) = caplog.messages
    assert line.endswith(
        "all zeros have moved together by +30 um, as in warmth: wait until the surface no longer warms or cools, take "
        "everything off it, then tare"
    )
    deliver(story, 300, 310)
    assert soon.contact()["notes"] == []
    assert soon.get("/health/ready?health=true").status_code == 200


def test_the_list_of_alarms_is_what_health_states_with_since_when(
    soon: Bench, caplog: pytest.LogCaptureFixture
) -> None:
    story = Story(soon, [[0.0] * 4, *[WEDGED] * 200])
    deliver(story, 0, 60)
    assert soon.get("/alarms").json() == {"surfaces": {}, "missing": {}}
    for first in range(60, 180, 30):
        deliver(story, first, first + 30)
    stated = soon.get("/health/ready?health=true").json()
    answer = soon.get("/alarms")
    assert answer.status_code == 200
    assert answer.json() == {"surfaces": stated["surfaces"], "missing": stated["missing"]}
    fault = stated["surfaces"]["press-7"]
    assert fault["type"] == "urn:beamtouch:problem:unexplained"
    assert f"since {fault['since']} neither rest" in caplog.text


@pytest.mark.promise(
    "docs/reference/problems.md",
    "`unexplained`: only `/alarms` and `/health/ready?health=true` give these.",
)
@pytest.mark.promise("docs/reference/http.md", "or an unexplained stretch lasts too long.")
def test_a_stretch_that_lasts_needs_a_technician(soon: Bench) -> None:
    story = Story(soon, [[0.0] * 4, *[WEDGED] * 200])
    deliver(story, 0, 60)
    assert soon.get("/health/ready?health=true").status_code == 200
    for first in range(60, 180, 30):
        deliver(story, first, first + 30)
    assert soon.get("/health/ready").status_code == 200
    problem = soon.get("/health/ready?health=true").json()["surfaces"]["press-7"]
    assert (problem["type"].rpartition(":")[2], problem["suspect"]) == ("unexplained", "s3")


@pytest.mark.promise("docs/reference/contact.md", "otherwise nearly as far.")
def test_a_daemon_whose_zeros_are_nearly_as_far_as_it_follows_says_so(soon: Bench) -> None:
    soon.send([0.0] * 4, members={"notes": ["zeros"]})
    assert soon.contact()["notes"] == ["zeros"]
    assert soon.get("/health/ready?health=true").json()["surfaces"]["press-7"]["type"].endswith(":zeros-moved")


GOOD, BAD = ["good"] * 4, ["good", "good", "missing", "good"]
PERIOD_S = 0.1


class Cable:
    """Sends samples of a beam at rest, whose third channel may be off."""

    def __init__(self, bench: Bench) -> None:
        self.bench, self._sent = bench, 0

    def send(self, *each: tuple[float, list[str]], times: int = 1) -> None:
        """Send samples of this quality for so many seconds, each in turn."""
        for seconds, quality in each * times:
            for _ in range(round(seconds / PERIOD_S)):
                self._sent += 1
                self.bench.now_s += PERIOD_S
                row = [0.0, 0.0, None if quality is BAD else 0.0, 0.0]
                self.bench.send(row, sequence=self._sent, quality=quality)

    @property
    def is_out(self) -> bool:
        """Return whether s3 is out; every door that has no figures of its own must agree."""
        out = self.bench.get("/surfaces/press-7").json()["channels_out"].get("s3")
        healthy = self.bench.get("/health/ready?health=true")
        assert (healthy.status_code == 503) == bool(out)
        if out:
            assert healthy.json()["detail"] == "press-7: Sensors have failed"
            assert f"s3 (missing since {out['since']})" in healthy.json()["surfaces"]["press-7"]["detail"]
        assert self.bench.get("/health/ready").status_code == 200
        assert ("degraded" in self.bench.contact()["notes"]) == bool(out)
        assert metrics(self.bench)["beamtouch_channel_out.press-7.s3"] == bool(out)
        return bool(out)


@pytest.mark.promise(
    "docs/reference/sensor-health.md",
    "So a loose cable counts as out if it is off for more than half of the time",
)
def test_a_loose_cable_is_out_if_it_is_off_for_more_than_half_of_the_time(
    soon: Bench, caplog: pytest.LogCaptureFixture
) -> None:
    caplog.set_level("INFO", "beamtouch_service")
    cable = Cable(soon)
    cable.send((0.4, BAD), (0.6, GOOD), times=10)
    assert not cable.is_out
    cable.send((0.7, BAD), (0.3, GOOD), times=10)
    assert cable.is_out
    cable.send((0.3, BAD), (0.7, GOOD), times=10)
    assert not cable.is_out
    since = "2026-11-20T23:40:46.123Z"
    assert caplog.messages == [
        f"surface press-7: channel s3 has been missing since {since} (over 2 s); "
        "check its cable, its supply and its module",
        f"surface press-7: channel s3 is good again; it had been out since {since}",
    ]


@pytest.mark.promise("docs/reference/metrics.md", "Without fresh samples, there are no metrics of channels.")
def test_a_pause_without_samples_counts_for_nothing(soon: Bench) -> None:
    cable = Cable(soon)
    cable.send((1.0, BAD))
    soon.now_s += 3600
    assert "beamtouch_channel_out{" not in soon.metrics()
    cable.send((0.2, BAD))
    assert not cable.is_out
    cable.send((1.5, BAD))
    assert cable.is_out


class Wired:
    """A surface that is touched now and then, by cables that a test may change."""

    def __init__(self, path: Path) -> None:
        self._line, self._begin = TouchedLine(path), datetime(2026, 11, 23, 12, 0, tzinfo=UTC)

    def touch(self, change: Change, count: int = 12) -> str | None:
        """Touch some times; return the wiring that the service names then."""
        self._line.touch(count, self._begin, 2.0, change)
        self._begin += timedelta(seconds=2.0 * count)
        wiring: str | None = self._line.summary["wiring"]
        return wiring


@pytest.mark.promise(
    "docs/how-to/troubleshooting.md",
    "log, page and `wiring` of `GET /surfaces/NAME` name two cables that are swapped or a sensor that is inverted",
)
@pytest.mark.promise("docs/reference/contact.md", "then name the cables")
@pytest.mark.parametrize(
    ("change", "wiring"),
    [
        (lambda one: one[[1, 0, 2, 3]], "s1 and s2 seem to be swapped"),
        (lambda one: one * [1, 1, -1, 1], "s3 seems to be inverted"),
    ],
)
def test_a_wrong_wiring_is_named_after_some_contacts_and_is_over_once_it_is_right(
    bench_model: Path, change: Change, wiring: str, caplog: pytest.LogCaptureFixture
) -> None:
    caplog.set_level("INFO", "beamtouch_service")
    line = Wired(bench_model)
    assert line.touch(change, count=2) is None
    assert line.touch(change) == wiring
    assert line.touch(lambda one: one) is None
    named, over = (text for text in caplog.messages if "wiring" in text)
    assert named.startswith(f"surface press-7: {wiring}; that explains its last contacts; check the wiring")
    assert over == "surface press-7: the wiring seems to be right again"


def test_contacts_that_no_wiring_explains_do_not_make_a_wrong_one_right(bench_model: Path) -> None:
    line, swapped = Wired(bench_model), "s1 and s2 seem to be swapped"
    assert line.touch(lambda one: one[[1, 0, 2, 3]]) == swapped
    assert line.touch(lambda one: (one * [1, 0, 1, 1])[[1, 0, 2, 3]], count=3) == swapped


@pytest.mark.promise("docs/how-to/troubleshooting.md", "name two cables that are swapped or a sensor that is inverted")
def test_other_faults_are_not_taken_for_a_wrong_wiring(bench_model: Path) -> None:
    line = Wired(bench_model)
    assert line.touch(lambda one: one * [1, 0, 1, 1]) is None  # one that does not move
    assert line.touch(lambda one: one * [1, 0.6, 1, 1]) is None
    again = line.touch(lambda one: one + one[::-1])  # as heavy a load at the other end
    assert again is None


@pytest.mark.promise(
    "docs/reference/metrics.md",
    '`surface=""` stands for names that do not exist, so clients cannot create labels.',
)
def test_samples_contacts_problems_and_durations_are_counted_for_each_surface() -> None:
    bench = Bench(surface_of(), surface_of("press-8"))
    bench.get("/contact?surface=press-7")
    for sequence in (1, 1, 5):
        bench.send(sequence=sequence)
    for path in ("/contact?surface=press-7", "/surfaces/press-7/contact", "/contact?surface=press-7&x=1"):
        assert bench.get(path).status_code == 200
    bench.send([0.0, 0.0, 0.0], sequence=6)
    bench.get("/surfaces/press-7/contact")
    for body in (b"{", json.dumps(batch_of([1.0], sequence=7)).encode()):
        bench.post(body)
    bench.post(batch_of(sequence=7) | {"beam": "beam-2"})
    bench.post(batch_of(), token="wrong")  # noqa: S106  # it is wrong
    for name in ("made-up", "made-up-too"):
        bench.post(b"{", path=f"/surfaces/{name}/samples")
    bench.now_s += 0.25
    found = metrics(bench)
    expected = {
        "samples_accepted_total.press-7": 3,
        "samples_accepted_total.press-8": 0,
        "samples_repeated_total.press-7": 1,
        "samples_missing.press-7": 3,
        "sample_age_seconds.press-7": 0.25,
        "sender_changes_total.press-7": 0,
        "contacts_total.press-7.contact": 3,
        "contacts_total.press-7.clear": 1,
        "contacts_total.press-8.contact": 0,
        "problems_total.no-samples": 1,
        "batches_rejected_total.press-7.malformed-json": 1,
        "batches_rejected_total.press-7.missing-channels": 1,
        "batches_rejected_total.press-7.other-beam": 1,
        "batches_rejected_total..unknown-surface": 2,
        "refusals_total.unauthorized": 1,
        "batch_seconds_count.press-7": 4,
        "inference_seconds_count.press-7": 3,
        "model_refused.press-7": 0,
    }
    assert {name: found[f"beamtouch_{name}"] for name in expected} == expected
    assert found["beamtouch_inference_seconds_sum.press-7"] > 0
    assert not [name for name in found if "made-up" in name]


def test_how_long_a_batch_takes_and_how_old_its_samples_are_when_it_comes(bench: Bench) -> None:
    def slow_body(takes_s: float, sequence: int, age_ms: float) -> Iterator[bytes]:
        body = json.dumps(batch_of(sequence=sequence, age_ms=age_ms)).encode()
        yield body[:-1]
        bench.now_s += takes_s
        yield body[-1:]

    assert bench.post(slow_body(0.3, 2, 15)).status_code == 200
    assert bench.contact()["age_ms"] == 315  # the time that the body takes makes its samples older
    # What comes late says nothing of how old the present is.
    assert bench.post(slow_body(0.0, 1, 10**9)).status_code == 200
    found = metrics(bench)
    buckets = [found[f"beamtouch_batch_seconds_bucket.press-7.{bound}"] for bound in ("0.0005", "0.2", "0.5", "+Inf")]
    ages = [found[f"beamtouch_sample_arrival_age_seconds_bucket.press-7.{bound}"] for bound in ("0.01", "0.02", "+Inf")]
    assert (buckets, ages) == ([1, 1, 2, 2], [0, 1, 1])
    assert found["beamtouch_batch_seconds_sum.press-7"] == pytest.approx(0.3)
    assert found["beamtouch_sample_arrival_age_seconds_sum.press-7"] == pytest.approx(0.015)
