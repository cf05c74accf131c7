"""A service with a broker, and a sender whose contacts come one after another."""

from __future__ import annotations

import threading
import time
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from service.bench import PATIENT, Row, batch_of
from service.event_story import RESTING, TOUCHING
from support.running.waiting import wait_until

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence
    from pathlib import Path

    from service.process.broker import Broker
    from service.process.conftest import Service, StartService

CONTACT, EVENT, STATUS = "beamtouch/press-7/contact", "beamtouch/press-7/event", "beamtouch/status"
BATCH_S = 0.01


def now_batch(*rows: Row, sequence: int, quality: list[str] | None = None) -> dict[str, Any]:
    """A batch whose samples were taken just now."""
    begin_us = time.time_ns() // 1000 - 1000 * (len(rows) - 1)
    return batch_of(*rows, sequence=sequence, quality=quality, begin_us=begin_us, every_us=1000)


class Sender(threading.Thread):
    """Touches and lifts until it is told to stop."""

    def __init__(self, service: Service) -> None:
        super().__init__(daemon=True)
        self._service = service
        self._told = threading.Event()
        self.receipts: dict[int, float] = {}
        """Sequence number -> time of the receipt [s since 1970]."""

    def run(self) -> None:
        sequence = 1
        self._service.post(now_batch(RESTING, sequence=sequence))
        self.receipts[sequence] = time.time()
        while not self._told.is_set():
            for row in [TOUCHING] * 3 + [RESTING] * 3:
                sequence += 1
                assert self._service.post(now_batch(row, sequence=sequence)).status_code == 200
                self.receipts[sequence] = time.time()
                time.sleep(BATCH_S)  # the pace of the sender

    def stop(self) -> None:
        self._told.set()
        self.join()


@dataclass
class Line:
    """A folder with a broker, and how services for it are started."""

    broker: Broker
    folder: Path
    start_service: StartService
    model: Path
    token_file: Path

    def start(
        self,
        *mqtt: str,
        stale_ms: float = 60_000,
        degraded_after_s: float = 10,
        port: int | None = None,
        surfaces: Sequence[str] = ("press-7",),
        code: str = PATIENT,
        sections: str = "",
    ) -> Service:
        """Start a service with these lines in `[mqtt]` and further sections, and `code` run before it."""
        lines = ['host = "127.0.0.1"', f"port = {port or self.broker.port}", *mqtt]
        keys = f"model = '{self.model}'\nstale_ms = {stale_ms}\ndegraded_after_s = {degraded_after_s}\n"
        (self.folder / "service.toml").write_text(
            f"[server]\nwrite_token_file = '{self.token_file}'\n[events]\nfile = 'events.db'\n[mqtt]\n"
            + "\n".join(lines)
            + "".join(f"\n[surfaces.{name}]\n{keys}" for name in surfaces)
            + sections
        )
        return self.start_service("--config", self.folder / "service.toml", code=code)


def metric(service: Service, name: str) -> float:
    """Return a figure of the service on its messages."""
    text = service.get("/metrics").text
    return float(next(line.split()[-1] for line in text.splitlines() if line.startswith(f"beamtouch_mqtt_{name} ")))


def events(service: Service, **query: object) -> list[dict[str, Any]]:
    """Return the events as `GET /events` gives them, all of them."""
    parameters = "&".join(f"{name}={value}" for name, value in {"limit": 1000, **query}.items())
    found: list[dict[str, Any]] = service.get(f"/events?{parameters}").json()["events"]
    return found


def wait_connected(service: Service) -> None:
    wait_until(lambda: metric(service, "connected") == 1)


def wait_for(condition: Callable[[], bool]) -> None:
    wait_until(condition, pause_s=0.05)
