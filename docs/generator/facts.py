"""Problems and metrics as Markdown tables, from the code that gives them."""

from collections.abc import Iterable
from contextlib import closing
from typing import Any

from prometheus_client.metrics import MetricWrapperBase
from prometheus_client.metrics_core import Metric

from beamtouch_daemon.running.metrics import CountCollector
from beamtouch_service.api.app import create_app
from beamtouch_service.events.recorder import Recorder
from beamtouch_service.problems import Kind
from schemas import table


def openapi() -> dict[str, Any]:
    """Return the OpenAPI description of the service."""
    with closing(Recorder()) as recorder:
        return create_app([], recorder=recorder).openapi()


def problems() -> str:
    """Return a table of all problems of the service."""
    rows: list[tuple[str, ...]] = [(f"`{kind.type_uri}`", str(kind.status), kind.title) for kind in Kind]
    return table(("`type`", "`status`", "`title`"), rows)


def metrics() -> str:
    """Return a table of the metrics of the service, and one of those of the daemon."""
    with closing(Recorder()) as recorder:
        counts = create_app([], recorder=recorder).context.counts
        labels = {_name(one): _labels(one) for one in vars(counts).values() if isinstance(one, MetricWrapperBase)}
        served = _metrics(counts.registry.collect(), labels)
    read = _metrics(CountCollector([], dict).collect(), {})
    return f"## Service\n\n{served}\n\n## Daemon\n\n{read}"


def _metrics(families: Iterable[Metric], labels: dict[str, str]) -> str:
    rows: list[tuple[str, ...]] = [
        (
            f"`{one.name}{'_total' if one.type == 'counter' else ''}`",
            one.type,
            labels.get(one.name, _labels(one)),
            one.documentation,
        )
        for one in families
    ]
    return table(("name", "type", "labels", "meaning"), sorted(rows))


def _name(metric: MetricWrapperBase) -> str:
    """Return the name of a metric, as its families have it."""
    (family,) = metric.describe()
    return family.name


def _labels(metric: Metric | MetricWrapperBase) -> str:
    """Return the labels of a metric."""
    # prometheus_client has no other way to ask for the labels of a metric without samples.
    names = getattr(metric, "_labelnames", ())
    return ", ".join(f"`{name}`" for name in names)
