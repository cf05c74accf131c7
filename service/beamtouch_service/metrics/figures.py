"""Figures that are read when Prometheus asks: the state of the record, of the parts that run, and of each surface."""

from collections.abc import Iterable, Iterator, Mapping
from time import time

from prometheus_client import CollectorRegistry
from prometheus_client.core import CounterMetricFamily, GaugeMetricFamily
from prometheus_client.metrics_core import Metric
from prometheus_client.registry import Collector

from beamtouch_common.units import MM
from beamtouch_common.zones import ZoneState
from beamtouch_models.runtime import State
from beamtouch_service.record import Recorder
from beamtouch_service.samples import Quality
from beamtouch_service.surfaces.surface import Surface
from beamtouch_service.surfaces.view import View

Views = list[tuple[Surface, View]]
"""Surfaces, each with its view at one moment."""


def clock_ahead_s(surface: Surface, now_s: float) -> float | None:
    """Return how far the clock of the sender is ahead of that of this machine at `now_s` [s]; None if it is not known.

    `now_s` is the time by the clock that ages are counted with.
    """
    view = surface.view(now_s)
    newest = view.newest
    if newest is None or not view.is_current:
        return None
    return newest.sample.acquired_unix_us / 1e6 - (time() - (now_s - newest.acquired_s))


class Figures(Collector):
    """The figures of a service at one time: its counts, and the state of its record, its parts and its surfaces.

    Counters of our own would be a second copy of what each surface counts for its summary.
    """

    def __init__(self, counts: CollectorRegistry) -> None:
        self._counts = counts
        self._families: dict[str, Metric] = {}

    def read_service(self, recorder: Recorder, reasons: Mapping[str, str], failures: Mapping[str, int]) -> None:
        """Read the state of the record; `reasons` say what is missing, `failures` how often each part failed."""
        self._add(_of_record(recorder))
        self._add(_of_parts(reasons, failures))

    def read_surfaces(self, surfaces: Iterable[Surface], now_s: float) -> Iterator[None]:
        """Read the state of one surface after another as of `now_s` [s], in the thread of the event loop."""
        self._add(_of_surfaces([], now_s))
        for surface in surfaces:
            self._add(_of_surfaces([(surface, surface.view(now_s))], now_s))
            yield

    def _add(self, families: Iterable[Metric]) -> None:
        for family in families:
            if family.name in self._families:
                self._families[family.name].samples += family.samples
            else:
                self._families[family.name] = family

    def collect(self) -> Iterator[Metric]:
        """Return all figures, in any thread."""
        yield from self._counts.collect()
        yield from self._families.values()


def _of_surfaces(views: Views, now_s: float) -> Iterator[Metric]:
    yield from _of_samples(views, now_s)
    yield from _of_candidates(views)
    yield from _of_states(views)
    yield from _of_zones(views)
    yield from _of_channels(views)
    yield from _of_health(views)


def _of_parts(reasons: Mapping[str, str], failures: Mapping[str, int]) -> Iterator[Metric]:
    words = "1 while an address, a broker or the record is missing, or a part of the service fails."
    missing = GaugeMetricFamily("beamtouch_missing", words, labels=["section"])
    for section, reason in reasons.items():
        missing.add_metric([section], bool(reason))
    yield missing
    words = "Times that a part of the service failed; it goes on."
    failed = CounterMetricFamily("beamtouch_part_failures", words, labels=["part"])
    for part, count in failures.items():
        failed.add_metric([part], count)
    yield failed


def _of_record(recorder: Recorder) -> Iterator[Metric]:
    words = "Times that the record of events went away."
    yield CounterMetricFamily("beamtouch_record_outages", words, value=recorder.outages)
    words = "Times that another service had recorded a surface meanwhile."
    yield CounterMetricFamily("beamtouch_record_races", words, value=recorder.races)
    words = "Events that were deleted, as they were older than keep_days or the record was larger than max_mb."
    deleted = CounterMetricFamily("beamtouch_record_events_deleted", words, labels=["reason"])
    deleted.add_metric(["age"], recorder.retention.old)
    deleted.add_metric(["size"], recorder.retention.oversize)
    yield deleted
    words = "Samples that are in memory and not durable in the record yet."
    waiting = GaugeMetricFamily("beamtouch_record_samples_waiting", words, labels=["surface"])
    words = "Samples that the record lacks, as their sender no longer had them."
    lost = CounterMetricFamily("beamtouch_record_samples_lost", words, labels=["surface"])
    for family, counts in ((waiting, recorder.waiting), (lost, recorder.lost)):
        for name, count in counts.items():
            family.add_metric([name], count)
        yield family


def _of_samples(views: Views, now_s: float) -> Iterator[Metric]:
    samples = CounterMetricFamily("beamtouch_samples_accepted", "New samples.", labels=["surface"])
    repeated = CounterMetricFamily("beamtouch_samples_repeated", "Samples received before.", labels=["surface"])
    # A gauge: a gap that is filled later is no longer missing.
    missing = GaugeMetricFamily("beamtouch_samples_missing", "Gaps in the sequence numbers.", labels=["surface"])
    senders = CounterMetricFamily("beamtouch_sender_changes", "Changes of the sender.", labels=["surface"])
    age = GaugeMetricFamily("beamtouch_sample_age_seconds", "Age of the newest sample.", labels=["surface"])
    words = "How far the clock of the sender is ahead of that of the service."
    ahead = GaugeMetricFamily("beamtouch_sender_clock_ahead_seconds", words, labels=["surface"])
    model = GaugeMetricFamily("beamtouch_model", "1 for the model in use.", labels=["surface", "model"])
    refused = GaugeMetricFamily("beamtouch_model_refused", "1 while the model file is not used.", labels=["surface"])
    for surface, view in views:
        label = [surface.name]
        counts = surface.counts
        samples.add_metric(label, counts.accepted)
        repeated.add_metric(label, counts.repeated)
        missing.add_metric(label, counts.lost)
        senders.add_metric(label, surface.sender_changes)
        if view.age_ms is not None:
            age.add_metric(label, view.age_ms / 1e3)
        if view.model:
            model.add_metric([surface.name, view.model.identity], 1)
        refused.add_metric(label, surface.model_error is not None)
        if (ahead_s := clock_ahead_s(surface, now_s)) is not None:
            ahead.add_metric(label, ahead_s)
    yield from (samples, repeated, missing, senders, age, ahead, model, refused)


def _of_candidates(views: Views) -> Iterator[Metric]:
    words = "1 for the candidate that runs beside the model."
    candidate = GaugeMetricFamily("beamtouch_candidate", words, labels=["surface", "model"])
    words = "1 while the file of a candidate is not compared."
    refused = GaugeMetricFamily("beamtouch_candidate_refused", words, labels=["surface"])
    words = "Samples on which the candidate was compared with the model."
    samples = CounterMetricFamily("beamtouch_candidate_samples", words, labels=["surface"])
    words = "Samples for which the candidate gave another state than the model."
    differing = CounterMetricFamily("beamtouch_candidate_differing", words, labels=["surface"])
    words = "Mean difference of a figure of contacts, whatever its sign, in the unit of its name."
    difference = GaugeMetricFamily("beamtouch_candidate_difference", words, labels=["surface", "figure"])
    for surface, _ in views:
        shadow = surface.shadow
        refused.add_metric([surface.name], bool(surface.candidate_error or (shadow and shadow.error)))
        if shadow:
            candidate.add_metric([surface.name, shadow.model.identity], shadow.error is None)
            samples.add_metric([surface.name], shadow.comparison.samples)
            differing.add_metric([surface.name], shadow.comparison.differing)
            for figure, one in shadow.comparison.differences.items():
                difference.add_metric([surface.name, figure], one.mean_size)
    yield from (candidate, refused, samples, differing, difference)


def _of_states(views: Views) -> Iterator[Metric]:
    words = "1 for the state that GET /contact gives; none where it gives a problem."
    states = GaugeMetricFamily("beamtouch_state", words, labels=["surface", "state"])
    words = "1 for the problem that GET /contact gives; none where it gives a state."
    problems = GaugeMetricFamily("beamtouch_problem", words, labels=["surface", "kind"])
    notes = GaugeMetricFamily("beamtouch_note", "1 for each note that GET /contact gives.", labels=["surface", "note"])
    words = "1 while the state has been unexplained for longer than unexplained_after_s."
    overdue = GaugeMetricFamily("beamtouch_unexplained", words, labels=["surface"])
    stretches = CounterMetricFamily("beamtouch_unexplained_stretches", "Unexplained stretches.", labels=["surface"])
    seconds = CounterMetricFamily("beamtouch_unexplained_seconds", "Total unexplained time.", labels=["surface"])
    for surface, view in views:
        label = [surface.name]
        for state in State:
            states.add_metric([surface.name, state.value], view.state is state)
        if view.problem:
            problems.add_metric([surface.name, view.problem.kind.slug], 1)
        for note in view.notes:
            notes.add_metric([surface.name, note], 1)
        # Without fresh samples, nothing is known of a surface.
        overdue.add_metric(label, view.totals.unexplained.is_overdue and view.is_current)
        stretches.add_metric(label, view.totals.unexplained.number)
        seconds.add_metric(label, view.totals.unexplained.total_s)
    yield from (states, problems, notes, overdue, stretches, seconds)


def _of_zones(views: Views) -> Iterator[Metric]:
    words = "1 for what GET /contact says of the zone; none where it says nothing."
    zones = GaugeMetricFamily("beamtouch_zone", words, labels=["surface", "zone", "answer"])
    words = "Times that a contact came to be inside the zone."
    entries = CounterMetricFamily("beamtouch_zone_entries", words, labels=["surface", "zone"])
    for surface, view in views:
        states = view.zones
        for zone, count in view.totals.zone_entries.items():
            entries.add_metric([surface.name, zone], count)
            for state in ZoneState if states.get(zone) else ():
                zones.add_metric([surface.name, zone, state.value], states[zone] is state)
    yield from (zones, entries)


def _of_channels(views: Views) -> Iterator[Metric]:
    words = "1 for the quality of a channel in the newest sample."
    qualities = GaugeMetricFamily("beamtouch_channel_quality", words, labels=["surface", "channel", "quality"])
    words = "1 for a channel that has not been good for longer than degraded_after_s."
    out = GaugeMetricFamily("beamtouch_channel_out", words, labels=["surface", "channel"])
    for surface, view in views:
        # Without fresh samples, nothing is known of a channel; another replica may have them.
        for name, found in view.qualities.items():
            for quality in Quality:
                qualities.add_metric([surface.name, name, quality.value], found is quality)
            out.add_metric([surface.name, name], name in view.totals.channels_out)
    yield from (qualities, out)


def _of_health(views: Views) -> Iterator[Metric]:
    labels = ["surface", "channel"]
    words = "Change of the gain since the baseline, in percent."
    gain = GaugeMetricFamily("beamtouch_gain_change_percent", words, labels=[*labels, "bound"])
    words = "Change of the deflection at rest since the baseline, in mm."
    zero = GaugeMetricFamily("beamtouch_zero_change_mm", words, labels=[*labels, "bound"])
    words = "Change of the deflection at rest since the baseline, of channels that do not show mm."
    other = GaugeMetricFamily("beamtouch_zero_change", words, labels=[*labels, "bound", "unit"])
    changed = GaugeMetricFamily("beamtouch_channel_changed", "1 if a channel has changed for certain.", labels=labels)
    for surface, _ in views:
        for name, one in (surface.channel_health or {}).items():
            label = [surface.name, name]
            changed.add_metric(label, one.changed)
            gains = (one.gain_percent, one.gain_low_percent, one.gain_high_percent)
            zeros = (one.zero_mm, one.zero_low_mm, one.zero_high_mm)
            of_zero = (zero, zeros, []) if one.unit == MM else (other, zeros, [one.unit])
            for family, values, unit in ((gain, gains, []), of_zero):
                for bound, value in zip(("estimate", "low", "high"), values, strict=True):
                    if value is not None:
                        family.add_metric([*label, bound, *unit], value)
    yield from (gain, zero, other, changed)
