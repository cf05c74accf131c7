"""The service with an MQTT broker that is killed, frozen and started again during 200 contacts, and what MQTT costs.

A subscriber keeps all that arrives: no event may be missing. A relay notes when each contact leaves the service: none
may be older than its limit.
"""

import json
import shutil
import signal
import sys
import tempfile
from contextlib import closing
from pathlib import Path
from statistics import median
from time import monotonic

sys.path.insert(0, str(Path(__file__).parent.parent))

from mqtt_press import STALE_S, press
from mqtt_relay import Relay

from processes import processor_s
from service.process.broker import Broker, Message, broker_in
from waiting import wait_until

CONTACTS = 200
FROZEN_S = (2.0, 8.0)
"""Shorter and longer than the service waits for an answer of the broker."""
TURNS, TURN_S = 3, 6.0
RATES_HZ = (None, 20, 50)
"""Without MQTT, and the limits of its rate."""
EVENT, CONTACT = "beamtouch/press-7/event", "beamtouch/press-7/contact"


def run() -> list[dict[str, object]]:
    """Return the rows of the table."""
    if shutil.which("mosquitto") is None or shutil.which("mosquitto_sub") is None:
        return [{"name": "mosquitto or mosquitto-clients is not installed", "value": 0, "unit": ""}]
    return [*outages(), *costs()]


def outages() -> list[dict[str, object]]:
    """Kill, freeze and restart the broker during the contacts."""
    with (
        tempfile.TemporaryDirectory() as name,
        broker_in(Path(name)) as broker,
        closing(Relay(broker.port)) as relay,
        press(name, relay.port) as line,
    ):
        subscriber = broker.subscribe("-t", "beamtouch/#")
        wait_until(lambda: line.metric("connected") == 1)
        troubles = {25: "kill", 70: FROZEN_S[0], 100: FROZEN_S[1], 165: "restart"}
        thaw_s = float("inf")
        for index in range(CONTACTS):
            trouble = troubles.get(index)
            if isinstance(trouble, float):
                broker.signal(signal.SIGSTOP)
                thaw_s = monotonic() + trouble
            elif trouble:
                stop(broker, signal.SIGKILL if trouble == "kill" else signal.SIGTERM)
            elif index - 10 in troubles and isinstance(troubles[index - 10], str):
                broker.start()
            line.contact()
            if monotonic() >= thaw_s:
                broker.signal(signal.SIGCONT)
                thaw_s = float("inf")
        wait_until(lambda: line.metric("connected") == 1 and line.metric("events_pending") == 0)
        recorded = {one["id"] for one in json.loads(line.get("/events?limit=1000"))["events"]}
        wait_until(lambda: recorded <= ids(subscriber.messages))
        contacts = [one for one in subscriber.messages if one.topic == CONTACT and '"state"' in one.text]
        received = [one for one in subscriber.messages if one.topic == EVENT]
        left = [line.since_receipt_ms(*one) for one in relay.left]
        arrived = [line.since_receipt_ms(one.content["sequence"], one.at_s) for one in contacts]
        return [
            {"name": "events recorded", "value": len(recorded), "unit": "", "goal": str(CONTACTS)},
            {"name": "events missing", "value": len(recorded - ids(received)), "unit": "", "goal": "0"},
            {"name": "events that arrived twice or more", "value": len(received) - len(ids(received)), "unit": ""},
            {"name": "contacts that arrived", "value": len(contacts), "unit": ""},
            {
                "name": "oldest contact as it said",
                "value": max(one.content["age_ms"] for one in contacts),
                "unit": "ms",
                "goal": f"at most {STALE_S * 1e3:g}",
            },
            {
                "name": "longest time from the receipt of a sample until its contact left",
                "value": max(left),
                "unit": "ms",
                "goal": f"at most {STALE_S * 1e3:g}",
                "median": median(left),
            },
            {
                "name": "contacts that arrived after their limit",
                "value": sum(one > STALE_S * 1e3 for one in arrived),
                "unit": "",
                "goal": "at most 1 for each time that the broker freezes",
                "longest, ms": max(arrived),
                "median, ms": median(arrived),
            },
            {"name": "contacts dropped as too old", "value": line.metric("contacts_dropped_total"), "unit": ""},
        ]


def stop(broker: Broker, number: signal.Signals) -> None:
    broker.signal(number)
    broker.kill()


def ids(messages: list[Message]) -> set[int]:
    return {one.content["id"] for one in messages if one.topic == EVENT}


def costs() -> list[dict[str, object]]:
    """Return the processor time of the service without MQTT and with it, in turns."""
    found: dict[int | None, list[float]] = {rate: [] for rate in RATES_HZ}
    with tempfile.TemporaryDirectory() as name, broker_in(Path(name)) as broker:
        for _ in range(TURNS):
            for rate_hz in RATES_HZ:
                with press(name, rate_hz and broker.port, rate_hz) as line:
                    line.contact()
                    begin_s, used_s = monotonic(), processor_s(line.process.pid)
                    while monotonic() - begin_s < TURN_S:
                        line.contact()
                    used_s = processor_s(line.process.pid) - used_s
                    found[rate_hz].append(used_s / (monotonic() - begin_s) * 100)
    return [
        {
            "name": f"processor, {f'MQTT at {rate} Hz' if rate else 'without MQTT'}",
            "value": median(shares),
            "unit": "% of a core",
            "from": min(shares),
            "to": max(shares),
        }
        for rate, shares in found.items()
    ]


if __name__ == "__main__":
    for row in run():
        print(row, flush=True)
