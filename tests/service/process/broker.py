"""A real mosquitto on a free port of loopback, and subscribers to it."""

import json
import signal
import socket
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from support.network.free_ports import free_port
from support.running.debian_parts import require
from support.running.waiting import wait_until


@dataclass(frozen=True)
class Message:
    """A message, as a subscriber got it."""

    at_s: float
    """Time of arrival [s since 1970]."""
    is_retained: bool
    content_type: str
    expiry_s: str
    topic: str
    text: str

    @property
    def content(self) -> dict[str, Any]:
        found: dict[str, Any] = json.loads(self.text)
        return found


class Subscriber:
    """A `mosquitto_sub` that writes what it gets to a file."""

    def __init__(self, port: int, path: Path, *options: str) -> None:
        program = require("mosquitto_sub", "mosquitto-clients")
        self._path = path
        with path.open("wb") as file:
            form = ("-F", r"%U\t%r\t%C\t%E\t%t\t%p", "-q", "1", "-V", "5")
            where = ("-h", "127.0.0.1", "-p", str(port))
            self._process = subprocess.Popen([program, *where, *form, *options], stdout=file)

    @property
    def messages(self) -> list[Message]:
        """Return what came so far."""
        lines = self._path.read_text().split("\n")[:-1]
        found = [line.split("\t", 5) for line in lines]
        return [Message(float(at), retained == "1", *rest) for at, retained, *rest in found]

    def of(self, topic: str) -> list[dict[str, Any]]:
        """Return the content of the messages of a topic so far."""
        return [message.content for message in self.messages if message.topic == topic]

    def texts(self, topic: str) -> list[str]:
        return [message.text for message in self.messages if message.topic == topic]

    def close(self) -> None:
        self._process.kill()
        self._process.wait()


class Broker:
    """A mosquitto with a configuration of its own. It keeps its port when it starts again."""

    def __init__(self, folder: Path, *lines: str) -> None:
        self._program = require("mosquitto", "mosquitto")
        self.folder = folder
        self.port = free_port()
        self._config = folder / "mosquitto.conf"
        self.configure(*lines)
        self._process: subprocess.Popen[bytes] | None = None
        self._subscribers: list[Subscriber] = []

    def configure(self, *lines: str, anonymous: bool = True) -> None:
        """Write the configuration, which a start reads."""
        allow = f"allow_anonymous {str(anonymous).lower()}"
        # As another user it could not read the folder of the test.
        head = (f"listener {self.port} 127.0.0.1", allow, "user root", "max_queued_messages 0")
        self._config.write_text("\n".join([*head, *lines, ""]))

    def start(self) -> None:
        with (self.folder / "mosquitto.log").open("ab") as log:
            self._process = subprocess.Popen([self._program, "-v", "-c", str(self._config)], stdout=log, stderr=log)
        wait_until(self._listens)

    @property
    def log(self) -> str:
        return (self.folder / "mosquitto.log").read_text()

    def signal(self, number: signal.Signals) -> None:
        assert self._process is not None
        self._process.send_signal(number)

    def kill(self) -> None:
        """Kill it and wait for its end."""
        assert self._process is not None
        self._process.kill()
        self._process.wait()

    def subscribe(self, *options: str) -> Subscriber:
        """Return a subscriber that the broker knows."""
        known = self.log.count("Sending SUBACK")
        made = Subscriber(self.port, self.folder / f"subscriber{len(self._subscribers)}", *options)
        self._subscribers.append(made)
        wait_until(lambda: self.log.count("Sending SUBACK") > known)
        return made

    def close(self) -> None:
        for subscriber in self._subscribers:
            subscriber.close()
        if self._process is not None:
            self.kill()

    def _listens(self) -> bool:
        with suppress(OSError), socket.create_connection(("127.0.0.1", self.port)):
            return True
        return False


@contextmanager
def broker_in(folder: Path, *lines: str) -> Iterator[Broker]:
    """Give a broker that runs; at the end, it and its subscribers are ended."""
    broker = Broker(folder, *lines)
    try:
        broker.start()
        yield broker
    finally:
        broker.close()
