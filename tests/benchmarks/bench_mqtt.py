"""The service with an MQTT broker that is killed, frozen and started again during 200 contacts, and what MQTT costs.

A subscriber keeps all that arrives: no event may be missing. A relay notes when each contact leaves the service: none
may be older than its limit.
"""

import http.client
import json
import re
import shutil
import signal
import socket
import subprocess
import sys
import tempfile
import threading
from collections.abc import Iterator
from contextlib import closing, contextmanager, suppress
from pathlib import Path
from statistics import median
from time import monotonic, sleep, time, time_ns

sys.path.insert(0, str(Path(__file__).parent.parent))

from processes import processor_s
from service.process.broker import Broker, Message, broker_in
from service.small_model import write_model
from waiting import wait_until

CONTACTS = 200
FROZEN_S = (2.0, 8.0)
"""Shorter and longer than the service waits for an answer of the broker."""
TURNS, TURN_S = 3, 6.0
RATES_HZ = (None, 20, 50)
"""Without MQTT, and the limits of its rate."""
EVENT, CONTACT = "beamtouch/press-7/event", "beamtouch/press-7/contact"
BATCH_S = 0.02
"""From batch to batch; each has two samples."""
TOUCHING_BATCHES, RESTING_BATCHES = 4, 4
STALE_S = 0.5
TOKEN = "a-token-of-this-benchmark"  # noqa: S105
_CONTACT = re.compile(rb'"age_ms":([0-9.]+),"sampled_at":"[^"]+","sequence":([0-9]+),')
_LONGEST = 1000
"""No contact is longer."""


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


class Press:
    """A service of one surface, and the sender of its samples."""

    def __init__(self, folder: Path, port: int | None, rate_hz: int | None = 20) -> None:
        (folder / "token").write_text(TOKEN)
        mqtt = f"[mqtt]\nhost = '127.0.0.1'\nport = {port}\nmax_rate_hz = {rate_hz}\n" if port else ""
        config = folder / "service.toml"
        config.write_text(
            "[server]\nport = 0\nwrite_token_file = 'token'\n[events]\nfile = 'events.db'\n"
            f"{mqtt}[surfaces.press-7]\nmodel = '{write_model(folder)}'\nstale_ms = {STALE_S * 1e3}\n"
        )
        program = [sys.executable, "-m", "beamtouch_service.cli", "run", "--config", str(config)]
        self._log = (folder / "log").open("wb")
        self.process = subprocess.Popen(program, stdout=subprocess.PIPE, stderr=self._log, text=True)
        assert self.process.stdout is not None
        port = int(self.process.stdout.readline().rpartition(":")[2])
        self._client = http.client.HTTPConnection("127.0.0.1", port)
        self._sequence = 0
        self.receipts: dict[int, float] = {}
        """Sequence number -> time of the receipt [s since 1970]. On a busy machine, a batch is old when it arrives."""

    def get(self, path: str) -> bytes:
        self._client.request("GET", path)
        return self._client.getresponse().read()

    def metric(self, name: str) -> float:
        lines = self.get("/metrics").decode().splitlines()
        return float(next(line.split()[-1] for line in lines if line.startswith(f"beamtouch_mqtt_{name} ")))

    def contact(self) -> None:
        """Touch and lift once."""
        for _ in range(TOUCHING_BATCHES):
            self._send([0.5, 0.25, 0.125])
        for _ in range(RESTING_BATCHES):
            self._send([0.0, 0.0, 0.0])

    def _send(self, row: list[float]) -> None:
        begin_s, now_us = monotonic(), time_ns() // 1000
        samples = [
            {
                "sequence": self._sequence + index,
                "acquired_unix_us": now_us - 10_000 * (1 - index),
                "deflection_mm": row,
                "quality": ["good"] * 3,
            }
            for index in range(2)
        ]
        self._sequence += 2
        batch = {"boot_id": "boot-0001", "channels": ["s1", "s2", "s3"], "newest_age_ms": 0.0, "samples": samples}
        headers = {"Authorization": f"Bearer {TOKEN}"}
        self._client.request("POST", "/surfaces/press-7/samples", json.dumps(batch), headers)
        answer = self._client.getresponse()
        said = answer.read()
        assert answer.status == 200, said
        self.receipts[self._sequence - 1] = time()
        sleep(max(0.0, begin_s + BATCH_S - monotonic()))

    def since_receipt_ms(self, sequence: int, at_s: float) -> float:
        """Return the time from the receipt of a sample [ms]; less than 0 if its contact was faster."""
        return (at_s - self.receipts[sequence]) * 1e3

    def close(self) -> None:
        self.process.terminate()
        self.process.communicate()
        self._log.close()


@contextmanager
def press(within: str, port: int | None, rate_hz: int | None = 20) -> Iterator[Press]:
    one = Press(Path(tempfile.mkdtemp(dir=within)), port, rate_hz)
    try:
        yield one
    finally:
        one.close()


class Relay:
    """Listens on a port of its own. A connection ends when either side ends it."""

    def __init__(self, port: int) -> None:
        self._broker = port
        self._listener = socket.create_server(("127.0.0.1", 0))
        self.port = int(self._listener.getsockname()[1])
        self.left: list[tuple[int, float]] = []
        """Sequence number of each contact that left the service, and the time [s since 1970]."""
        threading.Thread(target=self._accept, daemon=True).start()

    def close(self) -> None:
        self._listener.shutdown(socket.SHUT_RDWR)
        self._listener.close()

    def _accept(self) -> None:
        with suppress(OSError):
            while True:
                client = self._listener.accept()[0]
                try:
                    broker = socket.create_connection(("127.0.0.1", self._broker))
                except OSError:
                    client.close()
                    continue
                threading.Thread(target=self._carry, args=(client, broker, True), daemon=True).start()
                threading.Thread(target=self._carry, args=(broker, client, False), daemon=True).start()

    def _carry(self, source: socket.socket, sink: socket.socket, outwards: bool) -> None:
        kept = b""
        with suppress(OSError):
            while content := source.recv(1 << 16):
                if outwards:
                    kept = self._note(kept + content, time())
                sink.sendall(content)
        for end in (source, sink):
            with suppress(OSError):
                end.shutdown(socket.SHUT_RDWR)

    def _note(self, content: bytes, now_s: float) -> bytes:
        """Note the contacts in what left, and return what may be the beginning of the next one."""
        end = 0
        for found in _CONTACT.finditer(content):
            self.left.append((int(found[2]), now_s))
            end = found.end()
        return content[end:][-_LONGEST:]


if __name__ == "__main__":
    for row in run():
        print(row, flush=True)
