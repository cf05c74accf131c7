"""Counts, ages and durations for Prometheus, in the exposition format of its own library."""

from collections.abc import Iterator, Mapping
from itertools import accumulate, product

from fastapi import APIRouter, Response
from prometheus_client import CollectorRegistry, generate_latest
from prometheus_client.core import CounterMetricFamily, GaugeMetricFamily, HistogramMetricFamily
from prometheus_client.exposition import CONTENT_TYPE_LATEST
from prometheus_client.metrics_core import Metric
from prometheus_client.registry import Collector

from beamtouch_service.api import errors as handlers
from beamtouch_service.api import openapi as documentation
from beamtouch_service.api.context import Context, ContextParameter
from beamtouch_service.api.counts import REFUSALS
from beamtouch_service.problems import Kind
from beamtouch_service.surfaces.contact import State
from beamtouch_service.surfaces.inference import Durations
from beamtouch_service.surfaces.surface import Surface

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
        yield from _timings(surfaces)
        contacts = CounterMetricFamily("beamtouch_contacts", "Contacts served.", labels=["surface", "state"])
        for surface, state in product(surfaces, State):
            label = surface.name, state.value
            contacts.add_metric(label, counts.contacts[label])
        yield contacts
        if self._context.recorder is not None:
            words = "Writes to the record of contacts that failed or found no room."
            yield CounterMetricFamily("beamtouch_event_writes_lost", words, value=self._context.recorder.lost)
        yield _by_kind("beamtouch_problems", "Answers that were a problem.", counts.problems)
        words = "Connections closed to make room for others."
        yield CounterMetricFamily("beamtouch_connections_evicted", words, value=counts.evicted)
        words = "Batches that changed nothing; without a surface where there is none of that name."
        rejected = CounterMetricFamily("beamtouch_batches_rejected", words, labels=["surface", "kind"])
        for (name, kind), count in counts.rejected.items():
            rejected.add_metric([name, kind.slug], count)
        yield rejected
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
    yield from (samples, repeated, lost, senders, age, model, refused)


def _timings(surfaces: list[Surface]) -> Iterator[Metric]:
    of_batches, of_ages = "From the head of a batch to its receipt.", "Age of the newest sample at its arrival."
    yield _histogram("inference", "Time per estimate.", {one.name: one.timings.inference_s for one in surfaces})
    yield _histogram("batch", of_batches, {one.name: one.timings.batch_s for one in surfaces})
    yield _histogram("sample_arrival_age", of_ages, {one.name: one.timings.arrival_age_s for one in surfaces})


def _histogram(name: str, words: str, by_surface: Mapping[str, Durations]) -> Metric:
    family = HistogramMetricFamily(f"beamtouch_{name}_seconds", words, labels=["surface"])
    for surface, durations in by_surface.items():
        ends = [*(str(end) for end in durations.buckets_s), "+Inf"]
        cumulative = [(end, float(count)) for end, count in zip(ends, accumulate(durations.counts), strict=True)]
        family.add_metric([surface], cumulative, durations.sum_s)
    return family


@router.get("/metrics", responses={200: {"content": {"text/plain": {}}}, **documentation.problems()})
async def get_metrics(context: ContextParameter) -> Response:
    """Return counts, ages and durations for Prometheus, as text."""
    registry = CollectorRegistry()
    registry.register(ServiceCollector(context))
    return Response(generate_latest(registry), headers=handlers.NO_STORE, media_type=CONTENT_TYPE_LATEST)
