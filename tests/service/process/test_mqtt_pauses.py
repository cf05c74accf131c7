"""A broker that is away is asked ever more rarely: all services of a plant would meet it when it comes back."""

import socket
import threading
from collections.abc import Iterator
from contextlib import closing, suppress
from time import monotonic

import pytest

from support.running.waiting import wait_until

from .conftest import StartService

FIRST_S = 0.5
ATTEMPTS = 4
TOGETHER_S = FIRST_S * (1 + 2 + 4)
"""The three pauses between four attempts; each is twice as long as the one before."""


class Refusing:
    """A port that takes connections, and ends them before anything is said."""

    def __init__(self) -> None:
        self._listener = socket.create_server(("127.0.0.1", 0))
        self.port: int = self._listener.getsockname()[1]
        self.at_s: list[float] = []
        """When each connection came."""
        threading.Thread(target=self._run, daemon=True).start()

    def _run(self) -> None:
        with suppress(OSError):
            while True:
                connection, _ = self._listener.accept()
                self.at_s.append(monotonic())
                connection.close()

    def close(self) -> None:
        with closing(self._listener):
            self._listener.shutdown(socket.SHUT_RDWR)


@pytest.fixture
def broker() -> Iterator[Refusing]:
    one = Refusing()
    yield one
    one.close()


@pytest.mark.promise("docs/how-to/mqtt.md", "Answers, samples and the record go on, and the service tries again.")
def test_the_pauses_between_attempts_double(start_press: StartService, broker: Refusing) -> None:
    service = start_press(sections=f"[mqtt]\nhost = '127.0.0.1'\nport = {broker.port}\n")
    wait_until(lambda: len(broker.at_s) >= ATTEMPTS)
    # A busy machine only makes them longer.
    assert broker.at_s[ATTEMPTS - 1] - broker.at_s[0] > 0.9 * TOGETHER_S
    assert service.get("/health/live").status_code == 200
