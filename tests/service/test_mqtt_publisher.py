"""The connections of a service to its broker, one after the other: what is logged of them, and the pauses between."""

import asyncio
import logging
from collections.abc import Iterator
from contextlib import suppress
from typing import Any

import pytest

from beamtouch_common.waits import Backoff
from beamtouch_service.outputs.mqtt import publisher
from beamtouch_service.outputs.mqtt.failures import BrokerError, RefusedError
from beamtouch_service.outputs.mqtt.publisher import Publisher
from beamtouch_service.outputs.mqtt.section import MqttSection
from service.bench import Bench
from service.scripted_broker import Clock, Scripted

BROKER = "MQTT broker hall.example:1884"
LOST, REFUSED = BrokerError("no route"), RefusedError("it refuses the password")


class EndError(Exception):
    """The plan is at its end."""


class Plan:
    """A service that makes these connections, its pauses between them, and what the others are told after each."""

    def __init__(self, bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
        self.clock = Clock()
        self.pauses_s: list[float] = []
        self.states: list[tuple[float | None, str]] = []
        self._context = bench.app.context
        plan = self

        class Noted(Backoff):
            def next(self) -> float:
                plan.pauses_s.append(super().next())
                plan.states.append(plan.state())
                return 0.0

        monkeypatch.setattr(publisher, "Backoff", Noted)
        monkeypatch.setattr(publisher, "monotonic", self.clock)

    def state(self) -> tuple[float | None, str]:
        value = self._context.counts.registry.get_sample_value("beamtouch_mqtt_connected")
        return value, self._context.missing.get("mqtt", "not said")

    def run(self, *connections: Scripted, discovery: bool = False) -> None:
        planned: Iterator[Any] = iter(connections)

        def connect() -> Any:  # noqa: ANN401  # stands for a Connection
            try:
                one = next(planned)
            except StopIteration:
                raise EndError from None
            one.clock = self.clock
            return one

        async def run() -> None:
            section = MqttSection(host="hall.example", port=1884, prefix="hall", home_assistant_discovery=discovery)
            with suppress(EndError):
                await Publisher(section, self._context, connect).run()

        asyncio.run(run())
        assert all(one.is_closed for one in connections)


@pytest.fixture
def plan(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> Plan:
    return Plan(bench, monkeypatch)


def test_pauses_double_up_to_8_seconds_and_begin_anew_after_a_connection_of_more_than_10(plan: Plan) -> None:
    at_once = [Scripted(failure=LOST) for _ in range(6)]
    plan.run(*at_once, Scripted(open_s=10.0), Scripted(open_s=10.25), Scripted(failure=LOST))
    assert plan.pauses_s == [0.5, 1.0, 2.0, 4.0, 8.0, 8.0, 8.0, 0.5, 1.0]


@pytest.mark.promise(
    "docs/how-to/mqtt.md",
    (
        "The log has a line when an outage begins and one when it ends, and one for each new reason of a broker that "
        "refuses."
    ),
)
def test_the_log_has_the_begin_of_an_outage_each_other_refusal_and_its_end(
    plan: Plan, caplog: pytest.LogCaptureFixture
) -> None:
    caplog.set_level(logging.INFO)
    plan.run(
        Scripted(open_s=7.0, loss=LOST),
        Scripted(opening_s=2.0, failure=BrokerError("no answer")),
        Scripted(opening_s=1.5, failure=REFUSED),
        Scripted(opening_s=0.5, failure=REFUSED),
        Scripted(opening_s=8.5, open_s=1.0, loss=BrokerError("it left")),
    )
    assert caplog.messages == [
        f"{BROKER}: connected; topics hall/...",
        f"{BROKER}: no route; the service goes on and tries again",
        f"{BROKER}: it refuses the password; the service goes on and tries again",
        f"{BROKER}: connected again after 12.5 s",
        f"{BROKER}: it left; the service goes on and tries again",
    ]
    reasons = ("no route", "no answer", "it refuses the password", "it refuses the password", "it left")
    assert plan.states == [(0.0, f"broker hall.example:1884: {reason}") for reason in reasons]


def test_an_outage_that_is_like_the_last_one_fills_no_log(plan: Plan, caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level(logging.INFO)
    plan.run(
        Scripted(opening_s=3.0, failure=LOST),
        Scripted(opening_s=4.25, loss=LOST),
        Scripted(failure=LOST),
        Scripted(loss=LOST),
        Scripted(loss=BrokerError("it left")),
    )
    assert caplog.messages == [
        f"{BROKER}: no route; the service goes on and tries again",
        f"{BROKER}: connected again after 4.2 s",
        f"{BROKER}: it left; the service goes on and tries again",
    ]


def test_the_service_says_that_it_is_there_before_it_asks_what_there_was(plan: Plan) -> None:
    connection = Scripted(open_s=1.0)
    seen = []

    async def watch() -> None:
        seen.append(plan.state())
        raise LOST

    connection.watch = watch  # type: ignore[method-assign]
    plan.run(connection)
    assert connection.said[:5] == [
        "keep hall/status online text/plain",
        "subscribe hall/status",
        "subscribe hall/+/status",
        "subscribe homeassistant/device/hall/+/config",
        "confirm",
    ]
    assert seen == [(1.0, "")]


@pytest.mark.parametrize("discovery", [True, False])
def test_home_assistant_is_told_of_surfaces_only_where_that_is_asked_for(plan: Plan, discovery: bool) -> None:
    connection = Scripted(open_s=1.0)
    plan.run(connection, discovery=discovery)
    described = [line for line in connection.said if line.startswith("keep homeassistant/device/hall/press-7/config ")]
    assert len(described) == discovery
