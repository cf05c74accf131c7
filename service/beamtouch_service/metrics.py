"""Counts, ages and durations for Prometheus, in the exposition format of its own library."""

from collections.abc import Iterator, Mapping

from fastapi import APIRouter, Response
from prometheus_client import CollectorRegistry, generate_latest
from prometheus_client.core import CounterMetricFamily, GaugeMetricFamily, HistogramMetricFamily
from prometheus_client.exposition import CONTENT_TYPE_LATEST
from prometheus_client.metrics_core import Metric
from prometheus_client.registry import Collector

from beamtouch_service import documentation, handlers
from beamtouch_service.context import Context, ContextParameter
from beamtouch_service.counts import REFUSALS
from beamtouch_service.inference import BUCKETS_S
from beamtouch_service.problems import Kind
from beamtouch_service.surface import Surface

router = APIRouter(tags=["health"])


class ServiceCollector(Collector):
    """Reads what the service counts when it is asked."""

    def __init__(self, context: Context) -> None:
        self._context = context

    def describe(self) -> list[Metric]:
        """Return nothing: there is no other collector beside this one."""
        return []

    def collect(self) -> Iterator[Metric]:
        """Return all metrics."""
        counts = self._context.counts
        surfaces = list(self._context.registry)
        yield from _of_surfaces(surfaces, self._context.clock())
        contacts = CounterMetricFamily("beamtouch_contacts", "Contacts served.", labels=["state"])
        for state, count in counts.contacts.items():
            contacts.add_metric([state], count)
        yield contacts
        if self._context.recorder is not None:
            words = "Writes to the record of contacts that failed or found no room."
            yield CounterMetricFamily("beamtouch_event_writes_lost", words, value=self._context.recorder.lost)
        yield _by_kind("beamtouch_problems", "Answers that were a problem.", counts.problems)
        yield _by_kind("beamtouch_batches_rejected", "Batches that changed nothing.", counts.rejected)
        # All of them, also those that never happened: an alarm on what does not exist yet never comes.
        refusals = {kind: counts.problems[kind] for kind in Kind if kind in REFUSALS}
        yield _by_kind("beamtouch_refusals", "Requests refused for their token or their number.", refusals)


def _by_kind(name: str, words: str, counts: Mapping[Kind, int]) -> Metric:
    family = CounterMetricFamily(name, words, labels=["kind"])
    for kind, count in counts.items():
        family.add_metric([kind.slug], count)
    return family


def _of_surfaces(surfaces: list[Surface], now_s: float) -> Iterator[Metric]:
    samples = CounterMetricFamily("beamtouch_samples_accepted", "New samples.", labels=["surface"])
    repeated = CounterMetricFamily("beamtouch_samples_repeated", "Samples received before.", labels=["surface"])
    # A gauge: a gap that is filled later is no loss any more.
    lost = GaugeMetricFamily("beamtouch_samples_missing", "Gaps in the sequence numbers.", labels=["surface"])
    senders = CounterMetricFamily("beamtouch_sender_changes", "Samples from another sender.", labels=["surface"])
    age = GaugeMetricFamily("beamtouch_sample_age_seconds", "Age of the newest sample.", labels=["surface"])
    model = GaugeMetricFamily("beamtouch_model", "1 for the model in use.", labels=["surface", "model"])
    refused = GaugeMetricFamily("beamtouch_model_refused", "1 while the model file is not used.", labels=["surface"])
    inference = HistogramMetricFamily("beamtouch_inference_seconds", "Time per estimate.", labels=["surface"])
    for surface in surfaces:
        label, summary = [surface.name], surface.summary(now_s)
        samples.add_metric(label, summary.samples.accepted)
        repeated.add_metric(label, summary.samples.repeated)
        lost.add_metric(label, summary.samples.lost)
        senders.add_metric(label, surface.sender_changes)
        if summary.age_ms is not None:
            age.add_metric(label, summary.age_ms / 1e3)
        if summary.model is not None:
            model.add_metric([surface.name, summary.model], 1)
        refused.add_metric(label, summary.model_error is not None)
        inference.add_metric(label, _cumulative(surface.inference_s.counts), surface.inference_s.sum_s)
    yield from (samples, repeated, lost, senders, age, model, refused, inference)


def _cumulative(counts: list[int]) -> list[tuple[str, float]]:
    ends = [*(str(end) for end in BUCKETS_S), "+Inf"]
    return [(end, float(sum(counts[: index + 1]))) for index, end in enumerate(ends)]


@router.get("/metrics", responses={200: {"content": {"text/plain": {}}}, **documentation.problems()})
async def get_metrics(context: ContextParameter) -> Response:
    """Return counts, ages and durations for Prometheus, as text."""
    registry = CollectorRegistry()
    registry.register(ServiceCollector(context))
    return Response(generate_latest(registry), headers=handlers.NO_STORE, media_type=CONTENT_TYPE_LATEST)
