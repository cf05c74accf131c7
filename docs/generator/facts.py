"""Problems and metrics as Markdown tables, from the code that gives them."""

import logging
from collections.abc import Iterable
from contextlib import closing, suppress
from functools import cache
from typing import Any

from prometheus_client.metrics import MetricWrapperBase
from prometheus_client.metrics_core import CounterMetricFamily, GaugeMetricFamily, Metric

from beamtouch_common.outline import PLATE_AXES
from beamtouch_common.parts import Parts
from beamtouch_common.zones import Zone
from beamtouch_daemon.running.metrics import CountCollector
from beamtouch_service.api.app import create_app
from beamtouch_service.metrics.figures import Figures
from beamtouch_service.outputs.opcua.values import variable_of, variables_of
from beamtouch_service.problems import Kind
from beamtouch_service.record import Recorder
from beamtouch_service.sections import SurfaceSection
from beamtouch_service.surfaces.fields import fields_of
from beamtouch_service.surfaces.surface import Surface
from schemas import table

_MOST_LABELS = 4
"""No metric has more."""


@cache
def openapi() -> dict[str, Any]:
    """Return the OpenAPI description of the service."""
    recorder = Recorder()
    with closing(recorder.transactions):
        return create_app([], recorder=recorder).openapi()


def problems() -> str:
    """Return a table of all problems of the service."""
    rows: list[tuple[str, ...]] = [(f"`{kind.type_uri}`", str(kind.status), kind.title) for kind in Kind]
    return table(("`type`", "`status`", "`title`"), rows)


def opcua_variables() -> str:
    """Return a table of the variables of a surface over OPC UA, and one of those that only a plate has."""
    on_beam = variables_of(Surface("NAME", section=SurfaceSection(zones={"ZONE": Zone(from_mm=0, to_mm=1)})))
    fields = [field for field in fields_of(PLATE_AXES) if field.is_variable and field.name not in on_beam]
    on_plate = {field.name: variable_of(field) for field in fields}
    beam, plate = (
        table(
            ("variable", "type", "value"),
            [(f"`{name}`", variable.kind.name, variable.meaning) for name, variable in variables.items()],
        )
        for variables in (on_beam, on_plate)
    )
    return f"{beam}\n\nA plate has these in place of `position`:\n\n{plate}"


def metrics() -> str:
    """Return a table of the metrics of the service, and one of those of the daemon."""
    recorder = Recorder()
    with closing(recorder.transactions):
        context = create_app([], recorder=recorder).context
        for metric in vars(context.counts).values():
            if isinstance(metric, MetricWrapperBase):
                _begin_series(metric)
        context.parts.failures[""] = 1
        figures = Figures(context.counts.registry)
        figures.read_service(recorder, {}, context.parts.failures)
        list(figures.read_surfaces([], 0.0))
        served = _metrics(figures.collect())
    read = _metrics(CountCollector([], dict, _failing_parts()).collect())
    return f"## Service\n\n{served}\n\n## Daemon\n\n{read}"


def _failing_parts() -> Parts:
    """Return parts with one, so that the labels of their metrics show."""
    parts = Parts(logging.getLogger(__name__))
    parts.failures[""] = 1
    return parts


def _begin_series(metric: MetricWrapperBase) -> None:
    """Begin a series of a metric, which shows its labels. How many it takes shows by trying."""
    for count in range(1, _MOST_LABELS + 1):
        with suppress(ValueError):
            metric.labels(*[""] * count)


def _metrics(families: Iterable[Metric]) -> str:
    rows: list[tuple[str, ...]] = [
        (f"`{one.name}{'_total' if one.type == 'counter' else ''}`", one.type, _labels(one), one.documentation)
        for one in families
    ]
    return table(("name", "type", "labels", "meaning"), sorted(rows))


def _labels(family: Metric) -> str:
    """Return the labels of a metric, as its first sample has them."""
    if isinstance(family, CounterMetricFamily | GaugeMetricFamily) and not family.samples:
        family.add_metric([""] * _MOST_LABELS, 0)
    return ", ".join(f"`{name}`" for name in family.samples[0].labels if name != "le")
