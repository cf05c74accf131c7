"""Two services behind a balancer, with a sender for each surface."""

from pathlib import Path
from typing import Any

import httpx2

from service.bench import START_US, TOKEN, Row, batch_of
from service.event_story import RESTING, TOUCHING
from service.process.conftest import Service
from support.network.balancer import Balancer
from support.network.plain_http import NO_TLS, TIMEOUT_S
from support.running.waiting import wait_until

SURFACES = [f"press-{number}" for number in range(8)]
CONTACT: list[Row] = [RESTING, TOUCHING, TOUCHING, RESTING]


class Plant:
    """Two services behind a balancer, and a sender for each surface."""

    def __init__(self, folder: Path, services: list[Service], lines: str = "") -> None:
        self.services = services
        self.balancer = Balancer(folder, [service.port for service in services], 30, lines)
        self._sent = dict.fromkeys(SURFACES, 1)

    def get(self, path: str) -> httpx2.Response:
        return httpx2.get(self.balancer.url + path, trust_env=False, verify=NO_TLS, timeout=TIMEOUT_S)

    def deliver(self, name: str, *values: Row) -> None:
        """Send the next samples of a surface, as often as it takes."""
        body = batch_of(*values, sequence=self._sent[name], begin_us=START_US + self._sent[name] * 5000)
        url = f"{self.balancer.url}/surfaces/{name}/samples"
        headers = {"Authorization": f"Bearer {TOKEN}"}

        def is_taken() -> bool:
            try:
                answer = httpx2.post(url, json=body, headers=headers, trust_env=False, timeout=TIMEOUT_S)
            except httpx2.TransportError:
                return False
            return answer.is_success

        wait_until(is_taken)
        self._sent[name] += len(values)

    def having(self, service: Service) -> set[str]:
        """Return the surfaces whose samples a service has."""
        asked = {name: service.get(f"/surfaces/{name}/contact") for name in SURFACES}
        return {name for name, answer in asked.items() if answer.is_success}

    def events(self, count: int) -> list[dict[str, Any]]:
        """Wait for so many events: any service answers, and another one may still be writing."""
        found: list[dict[str, Any]] = []

        def are_written() -> bool:
            found[:] = self.get("/events?limit=1000").json().get("events", [])
            return len(found) >= count

        wait_until(are_written)
        return found
