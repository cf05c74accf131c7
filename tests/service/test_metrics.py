"""What `GET /metrics` says, written by hand for a few moments in the life of a surface."""

import re
from collections import Counter
from typing import Unpack

import pytest

from beamtouch_common.zones import Zone
from beamtouch_service.api.change_log import ChangeLog
from beamtouch_service.metrics.counts import Counts
from beamtouch_service.metrics.figures import clock_ahead_s
from beamtouch_service.sections import SurfaceSection
from beamtouch_service.surfaces.channels import ChannelHealth, SurfaceHealth
from beamtouch_service.surfaces.surface import Surface
from beamtouch_service.surfaces.unexplained import Overdue
from service.bench import START_US, BatchOptions, Bench, Row, batch_of, parsed, surface_of, surface_with
from service.event_story import HARDER, ODD, RESTING, TOUCHING
from support.surfaces.small_model import model_of

LEFT = Zone(from_mm=0, to_mm=160)
SECTION = SurfaceSection(degraded_after_s=0.009, unexplained_after_s=0.01, zones={"left": LEFT})


def figures(bench: Bench, *names: str) -> dict[str, float]:
    """Return the figures with these names, each under its name and the values of its labels but for the surface."""
    found = re.findall(r"^beamtouch_(\w+?)(?:\{(.*)\})? (\S+)$", bench.metrics(), re.MULTILINE)
    return {
        " ".join([name, *_labels(labels)]): round(float(value), 6) for name, labels, value in found if name in names
    }


def _labels(text: str) -> list[str]:
    return [value for label, value in re.findall(r'(\w+)="(.*?)"', text) if label != "surface"]


def table(text: str) -> dict[str, float]:
    """Return figures that are written as in `state contact 1, state clear 0`."""
    return {name: float(value) for name, _, value in (" ".join(one.split()).rpartition(" ") for one in text.split(","))}


STATES = ("state", "problem", "note", "unexplained", "unexplained_stretches_total", "unexplained_seconds_total")
SAMPLES = (
    *("samples_accepted_total", "samples_repeated_total", "samples_missing", "sender_changes_total"),
    *("sample_age_seconds", "sender_clock_ahead_seconds", "model_refused"),
)
CHANNELS = ("channel_quality", "channel_out")
COUNTS = ("contacts_total", "refusals_total", "batch_seconds_count", "sample_arrival_age_seconds_count")
RECORD = (
    *("record_outages_total", "record_races_total", "record_events_deleted_total", "record_samples_waiting"),
    *("record_samples_lost_total", "missing", "part_failures_total"),
)


@pytest.fixture
def bench() -> Bench:
    return Bench(surface_of(section=SECTION))


def test_before_the_first_sample_counts_are_zero_and_what_is_not_known_is_left_out(bench: Bench) -> None:
    assert figures(bench, *STATES) == table(
        """state contact 0, state clear 0, state unexplained 0, problem no-samples 1,
        unexplained 0, unexplained_stretches_total 0, unexplained_seconds_total 0"""
    )
    assert figures(bench, *SAMPLES) == table(
        "samples_accepted_total 0, samples_repeated_total 0, samples_missing 0, sender_changes_total 0, model_refused 0"
    )
    assert figures(bench, *RECORD) == table(
        """record_outages_total 0, record_races_total 0, missing events 0,
        record_events_deleted_total age 0, record_events_deleted_total size 0"""
    )
    assert figures(bench, *COUNTS) == table(
        """contacts_total contact 0, contacts_total clear 0, contacts_total unexplained 0,
        refusals_total unauthorized 0, refusals_total forbidden 0, refusals_total other-name 0,
        batch_seconds_count 0, sample_arrival_age_seconds_count 0"""
    )
    assert figures(bench, "model", "zone_entries_total") == table(
        f"model {model_of().identity} 1, zone_entries_total left 0"
    )
    assert figures(bench, *CHANNELS, "zone") == {}


def test_a_contact_is_counted_with_the_age_of_its_sample_and_its_zone(bench: Bench) -> None:
    bench.send(RESTING, TOUCHING, TOUCHING)
    bench.send(TOUCHING, TOUCHING, sequence=3)
    bench.contact()
    bench.now_s += 0.25
    assert figures(bench, *STATES) == table(
        """state contact 1, state clear 0, state unexplained 0,
        unexplained 0, unexplained_stretches_total 0, unexplained_seconds_total 0"""
    )
    # The second batch says that its samples were taken 10 ms and 5 ms after what this machine has for now.
    assert figures(bench, *SAMPLES) == table(
        """samples_accepted_total 4, samples_repeated_total 1, samples_missing 0, sender_changes_total 0,
        sample_age_seconds 0.25, sender_clock_ahead_seconds 0.255, model_refused 0"""
    )
    assert figures(bench, "zone", "zone_entries_total", "contacts_total", "record_samples_waiting") == table(
        """zone inside left 1, zone outside left 0, zone unsure left 0, zone_entries_total left 1,
        contacts_total contact 1, contacts_total clear 0, contacts_total unexplained 0, record_samples_waiting 4"""
    )


WORDS = ("good", "out-of-range", "saturated", "stuck", "missing")


def test_a_channel_that_is_out_and_gaps_are_shown_while_samples_are_fresh(bench: Bench) -> None:
    bench.send(TOUCHING)
    bench.now_s += 0.05
    bench.send(*[TOUCHING] * 3, sequence=5, quality=["good", "good", "stuck"])
    qualities = {"s1": "good", "s2": "good", "s3": "stuck"}
    assert figures(bench, "channel_quality") == {
        f"channel_quality {name} {word}": found == word for name, found in qualities.items() for word in WORDS
    }
    assert figures(bench, "channel_out", "note", "samples_missing", "record_samples_lost_total") == table(
        """channel_out s1 0, channel_out s2 0, channel_out s3 1, note degraded 1, note unchecked 1,
        samples_missing 3, record_samples_lost_total 3"""
    )
    assert figures(bench, "zone") == {}  # what is not checked is in none
    bench.now_s += 0.6
    assert figures(bench, *CHANNELS, "note", "sender_clock_ahead_seconds") == {}
    assert figures(bench, "problem", "sample_age_seconds") == table("problem stale 1, sample_age_seconds 0.6")


def test_a_stretch_is_timed_and_overdue_while_samples_are_fresh(bench: Bench) -> None:
    bench.send(RESTING, *[ODD] * 4)  # the state follows from the third one
    bench.now_s += 0.1
    assert figures(bench, *STATES) == table(
        """state contact 0, state clear 0, state unexplained 1,
        unexplained 0, unexplained_stretches_total 1, unexplained_seconds_total 0.005"""
    )
    bench.send(ODD, ODD, sequence=6)
    names = ("unexplained", "unexplained_seconds_total", "problem")
    assert figures(bench, *names) == table("unexplained 1, unexplained_seconds_total 0.105")
    bench.now_s += 0.6
    assert figures(bench, *names) == table("unexplained 0, unexplained_seconds_total 0.105, problem stale 1")


def test_the_health_of_a_channel_has_both_bounds(bench: Bench) -> None:
    bench.send(TOUCHING)
    (surface,) = bench.app.context.registry
    gain = {"gain_percent": 2.5, "gain_low_percent": 2.0, "gain_high_percent": 3.0}
    zero = {"zero_mm": 0.25, "zero_low_mm": 0.125, "zero_high_mm": 0.5}
    each: dict[str, dict[str, object]] = {
        "s1": {**zero, "changed": True},
        "s2": {**dict.fromkeys(zero), "changed": False},
    }
    about: dict[str, object] = {"since": "2026-11-20T23:40:46.123Z", "contacts": 9, "changes": []}
    healths = {name: ChannelHealth.model_validate({**about, **gain, **members}) for name, members in each.items()}
    surface.health = SurfaceHealth(model_of().identity, healths)
    assert figures(bench, "gain_change_percent", "zero_change_mm", "channel_changed") == table(
        """gain_change_percent estimate s1 2.5, gain_change_percent low s1 2, gain_change_percent high s1 3,
        gain_change_percent estimate s2 2.5, gain_change_percent low s2 2, gain_change_percent high s2 3,
        zero_change_mm estimate s1 0.25, zero_change_mm low s1 0.125, zero_change_mm high s1 0.5,
        channel_changed s1 1, channel_changed s2 0"""
    )


def test_a_surface_without_a_model_shows_the_channels_of_its_sender() -> None:
    surface = surface_with(None)
    bench = Bench(surface)
    surface.model_error = "damaged"
    bench.send([0.5], channels=["any"], quality=["saturated"])
    assert figures(bench, "channel_quality") == {f"channel_quality any {word}": word == "saturated" for word in WORDS}
    names = ("channel_out", "model", "model_refused", "problem")
    assert figures(bench, *names) == table("channel_out any 0, model_refused 1, problem no-model 1")


BOUNDS = {
    "inference": (1e-5, 2e-5, 5e-5, 1e-4, 2e-4, 5e-4, 1e-3, 2e-3, 5e-3, 1e-2),
    "batch": (5e-4, 1e-3, 2e-3, 5e-3, 1e-2, 2e-2, 5e-2, 0.1, 0.2, 0.5, 1.0, 10.0),
    "sample_arrival_age": (1e-3, 2e-3, 5e-3, 1e-2, 2e-2, 5e-2, 0.1, 0.2, 0.5, 1.0, 2.0, 5.0),
}
"""Of the histograms [s]: dashboards and alarms count on them."""


@pytest.mark.parametrize("name", BOUNDS)
def test_a_histogram_has_bounds(bench: Bench, name: str) -> None:
    found = re.findall(rf'^beamtouch_{name}_seconds_bucket{{le="(.*?)",', bench.metrics(), re.MULTILINE)
    assert [float(bound) for bound in found] == [*BOUNDS[name], float("inf")]


def test_the_clock_of_a_sender_is_compared_while_its_sample_is_fresh() -> None:
    """That of this machine stands at `START_US`."""
    surface = surface_of()
    assert clock_ahead_s(surface, 1000.0) is None
    surface.receive(parsed(HARDER, begin_us=START_US + 2_000_000), 1000.0)
    assert clock_ahead_s(surface, 1000.25) == pytest.approx(2.25, abs=1e-6)
    assert clock_ahead_s(surface, 1000.5) is not None
    assert clock_ahead_s(surface, 1000.501) is None


def test_an_output_that_is_begun_again_goes_on_with_its_counts() -> None:
    counts = Counts()
    assert counts.counter("sent", "Sent.") is counts.counter("sent", "Sent.")
    assert counts.gauge("open", "Open.") is counts.gauge("open", "Open.")
    counts.counter("sent", "Sent.").inc()
    assert counts.registry.get_sample_value("beamtouch_sent_total") == 1.0


class Looked:
    """A surface whose changes are logged after each batch, with a clock of its own."""

    def __init__(self, section: SurfaceSection | None = None) -> None:
        self.now_s = 1000.0
        self.change_log, self.surface = ChangeLog(lambda: self.now_s), surface_of(section=section)
        self._numbers = Counter[str]()

    def send(self, *rows: Row, step_s: float = 1.0, **more: Unpack[BatchOptions]) -> None:
        """Send the next samples of a boot, from an address of its own."""
        self.now_s += step_s
        rows, boot_id = rows or (TOUCHING,), more.get("boot_id", "boot-0001")
        more["sequence"] = self._numbers[boot_id] + 1
        self._numbers[boot_id] += len(rows)
        self.surface.receive(parsed(*rows, **more), self.now_s, f"at {boot_id}")
        self.change_log.log_changes(self.surface, self.now_s)


def test_another_sender_is_logged_once_a_minute_with_the_changes_since(caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level("INFO", "beamtouch_service")
    looked = Looked()
    looked.change_log.log_changes(looked.surface, 1000.0)
    looked.send(boot_id="boot-0000")
    assert caplog.messages == []
    for number in range(1, 4):
        looked.send(boot_id=f"boot-{number:04}")
    looked.change_log.log_changes(looked.surface, looked.now_s)
    looked.now_s += 60.0
    looked.send(boot_id="boot-last")
    words = "surface press-7: the sender changed to {} (changes since the last line: {})"
    assert caplog.messages == [words.format("boot-0001", 1), words.format("boot-last", 3)]


SINCE = "2026-11-20T23:40:46.123Z"
NO_CLOCK = r"the clock of its daemon"


def said(caplog: pytest.LogCaptureFixture) -> list[str]:
    """Return what was said of the surface, but of its clock."""
    found = [line.removeprefix("surface press-7: ") for line in caplog.messages if NO_CLOCK not in line]
    caplog.clear()
    return found


@pytest.mark.parametrize(
    ("quality", "words"),
    [
        ("missing", "missing since {} (over 0.5 s); check its cable, its supply and its module"),
        ("stuck", "stuck since {} (over 0.5 s); its counts do not change: check its cable and the sensor"),
        (
            "saturated",
            "saturated since {} (over 0.5 s); its counts stand at the end of the ADC: check its wiring, its supply "
            "and its gap",
        ),
        (
            "out-of-range",
            "out of range since {} (over 0.5 s); check whether the sensor has moved, or something lies on the beam",
        ),
    ],
)
def test_a_channel_that_goes_out_and_comes_back_is_logged_once_each(
    caplog: pytest.LogCaptureFixture, quality: str, words: str
) -> None:
    caplog.set_level("INFO", "beamtouch_service")
    looked = Looked(SurfaceSection(degraded_after_s=0.5))
    bad = ["good", "good", quality]
    looked.send(quality=bad)
    assert said(caplog) == []
    for _ in range(3):
        looked.send(quality=bad)
    assert said(caplog) == [f"channel s3 has been {words.format(SINCE)}"]
    for _ in range(2):
        looked.send()
    assert said(caplog) == [f"channel s3 is good again; it had been out since {SINCE}"]


def test_a_stretch_that_lasts_too_long_is_logged_once_with_what_to_look_for(caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level("INFO", "beamtouch_service")
    looked = Looked(SurfaceSection(unexplained_after_s=0.5))
    for _ in range(2):
        looked.send(RESTING, *[ODD] * 3)
        assert said(caplog) == []
        for _ in range(3):
            looked.send(ODD)
        (line,) = said(caplog)
        assert line.startswith("since 2026-11-20T23:40:46.138Z neither rest nor a single contact explains the samples")
        assert "(over 0.5 s); look for a second load, for anything that touches the beam from below" in line
        looked.send(*[RESTING] * 4)
    assert said(caplog) == []


@pytest.mark.parametrize(
    ("suspect", "shift_mm", "wiring", "look"),
    [
        ("s1", None, None, "check sensor s1: without it, everything is explained"),
        ("s1", -0.0123, None, "all zeros have moved together by -12.3 um, as in warmth: wait until the surface no"),
        ("s1", 0.5, "s1 and s2 seem to be swapped", "s1 and s2 seem to be swapped; check the wiring, and the order"),
    ],
)
def test_a_long_stretch_is_logged_with_what_explains_it_best(
    caplog: pytest.LogCaptureFixture,
    monkeypatch: pytest.MonkeyPatch,
    suspect: str | None,
    shift_mm: float | None,
    wiring: str | None,
    look: str,
) -> None:
    looked = Looked(SurfaceSection(unexplained_after_s=0.5))
    monkeypatch.setattr(looked.surface.unexplained, "take_overdue", lambda: Overdue(START_US, suspect, shift_mm))
    monkeypatch.setattr(Surface, "wiring", wiring)
    looked.change_log.log_changes(looked.surface, 1000.0)
    line = f"since {SINCE} neither rest nor a single contact explains the samples (over 0.5 s); {look}"
    assert said(caplog)[0].startswith(line)


def test_without_a_surface_the_families_are_there_and_parts_that_failed_are_counted() -> None:
    bench = Bench()
    bench.app.context.parts.failures["mqtt"] = 2
    assert figures(bench, "part_failures_total") == table("part_failures_total mqtt 2")
    families = re.findall(r"^# TYPE beamtouch_(\w+) ", bench.metrics(), re.MULTILINE)
    assert {"samples_accepted_total", "state", "zone", "channel_out", "gain_change_percent"} <= set(families)
    assert len(families) == len(set(families))


def test_two_daemons_are_logged_once_an_hour_and_when_one_is_left(
    caplog: pytest.LogCaptureFixture,
) -> None:
    caplog.set_level("INFO", "beamtouch_service")
    looked = Looked()

    def quarrel() -> list[str]:
        for boot_id in ("boot-0001", "boot-0002") * 8:
            looked.send(boot_id=boot_id, step_s=0.1)
        return [line for line in said(caplog) if "sender changed" not in line]

    line = "two daemons send its samples, from at boot-0001 and from at boot-0002; stop one of them"
    assert quarrel() == [line]
    assert quarrel() == []
    looked.send(boot_id="boot-0001", step_s=3000.0)
    assert "one daemon sends its samples again" in said(caplog)
    assert quarrel() == []
    looked.now_s += 3600.0 - 3000.0
    assert quarrel() == [line]


@pytest.mark.parametrize(("ahead_s", "words"), [(59.0, None), (61.0, "61 s ahead of"), (-61.0, "61 s behind")])
def test_a_clock_of_a_daemon_that_is_a_minute_off_is_logged_once_an_hour(
    caplog: pytest.LogCaptureFixture, ahead_s: float, words: str | None
) -> None:
    looked = Looked()
    begin_us = START_US + round(ahead_s * 1e6)
    looked.send(begin_us=begin_us)
    looked.send(begin_us=begin_us)
    line = (
        f"surface press-7: the clock of its daemon is {words} that of this machine; events have the time of the daemon"
    )
    assert caplog.messages == ([] if words is None else [line])
    looked.now_s += 3598.0
    looked.send(begin_us=begin_us, step_s=0.9)
    assert len(caplog.messages) == (words is not None)
    looked.send(begin_us=begin_us, step_s=0.2)
    assert len(caplog.messages) == 2 * (words is not None)


def test_samples_of_another_beam_are_logged_once_a_minute_for_each_surface(caplog: pytest.LogCaptureFixture) -> None:
    looked = Looked()
    for name in ("press-7", "press-7", "press-8"):
        looked.change_log.log_other_beam(name, "The reason.")
    looked.now_s += 60.0
    looked.change_log.log_other_beam("press-7", "The reason.")
    words = "surface {}: its samples are refused: The reason."
    assert caplog.messages == [words.format(name) for name in ("press-7", "press-8", "press-7")]


def test_batches_that_changed_nothing_are_counted_by_their_reason(bench: Bench) -> None:
    bench.post(b"{")
    bench.post(batch_of() | {"beam": "beam-2"})
    bench.post(batch_of(), "/surfaces/nobody/samples")
    found = re.findall(r"^beamtouch_batches_rejected_total(.*) 1.0$", bench.metrics(), re.MULTILINE)
    assert found == [
        '{kind="malformed-json",surface="press-7"}',
        '{kind="other-beam",surface="press-7"}',
        '{kind="unknown-surface",surface=""}',
    ]
    assert figures(bench, "problems_total") == {
        f"problems_total {kind}": 1 for kind in ("malformed-json", "other-beam", "unknown-surface")
    }


def test_a_part_that_fails_is_the_reason_for_its_section(bench: Bench) -> None:
    context = bench.app.context
    context.missing["mqtt"] = "no broker"
    context.parts.failing |= {"mqtt": "", "upkeep": "", "modbus": "a bug"}
    assert context.reasons() == {"mqtt": "no broker", "events": "", "upkeep": "", "modbus": "a bug"}
    context.parts.failing["mqtt"] = "another bug"
    assert context.reasons()["mqtt"] == "another bug"
    assert figures(bench, "missing") == table("missing mqtt 1, missing events 0, missing upkeep 0, missing modbus 1")


@pytest.mark.parametrize(
    ("name", "first", "last", "beyond"),
    [("inference", 1e-5, 1e-2, []), ("sample_arrival_age", 1e-3, 5.0, []), ("batch", 5e-4, 1.0, [10.0])],
)
def test_times_are_counted_by_bounds_of_1_2_and_5_in_each_decade(
    bench: Bench, name: str, first: float, last: float, beyond: list[float]
) -> None:
    found = re.findall(rf'^beamtouch_{name}_seconds_bucket{{le="([\d.e-]+)",', bench.metrics(), re.MULTILINE)
    decades = [float(f"{digit}e{power}") for power in range(-5, 1) for digit in (1, 2, 5)]
    assert [float(bound) for bound in found] == [bound for bound in decades if first <= bound <= last] + beyond
