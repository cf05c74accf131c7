"""The whole line, read by a Modbus client that is not ours: the contacts of `GET /contact`, and their end."""

import math
import os
import threading
from collections.abc import Iterator
from pathlib import Path
from signal import SIGKILL
from typing import Any

import httpx2
import numpy as np
import pytest

from beamtouch_models import modelfile
from beamtouch_models.building.daemon_config import daemon_config
from contact_registers import FIGURES, decoded, expected, single
from example_scenes import SCENES
from forked_line import ForkedLine
from line import Line, Surface
from modbus_client import Poll, compiled, modbus_port, polls
from plain_http import TIMEOUT_S

pytestmark = pytest.mark.long

ENOUGH = 60
"""Contacts to compare, at least: those that both doors gave of the same sample."""
BOTH = {"contact", "clear"}
"""States that must be among them: a fast machine compares enough before the load is first lifted."""
LATER = 200
"""Polls after which the other door has been asked for the same sample, if it is ever."""
ASK_S = 0.005
"""Between two questions; so both doors are asked several times for each sample."""
STALE_MS = 500
STALE = 18


@pytest.fixture(scope="module")
def client(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The client on libmodbus."""
    return compiled(tmp_path_factory)


@pytest.fixture
def line(tmp_path: Path, bench_model: Path) -> Iterator[Line]:
    """A line whose load moves all the time and is lifted now and then."""
    config, script = tmp_path / "generated.toml", tmp_path / "script.toml"
    built = daemon_config(modelfile.load(bench_model).metadata)
    config.write_text(built.replace("rate_hz = 200", "rate_hz = 50"))
    moved = "".join(
        f"[[step]]\nseconds = 0.02\nposition_mm = {200 + 180 * np.sin(step / 20):.2f}\nforce_n = {8 + step % 9}\n"
        for step in range(100)
    )
    script.write_text(f"{moved}[[step]]\nseconds = 0.5\n")
    surfaces = [Surface("bench", "modbus-tcp", script)]
    with ForkedLine(
        tmp_path, SCENES / "bench.toml", bench_model, config, surfaces, {"modbus_server": {"port": 0}}
    ) as line:
        yield line


class Contacts(threading.Thread):
    """Asks for the contact again and again; keeps each by the number of its sample."""

    def __init__(self, url: str) -> None:
        super().__init__(daemon=True)
        self.said: dict[int, dict[str, Any]] = {}
        self.stop = threading.Event()
        self._url = url

    def run(self) -> None:
        """Ask until told to stop."""
        with httpx2.Client(base_url=self._url, trust_env=False, timeout=TIMEOUT_S) as http:
            while not self.stop.wait(ASK_S):
                answer = http.get("/contact")
                if answer.is_success:
                    self.said[answer.json()["sequence"]] = answer.json()


def test_a_client_on_libmodbus_reads_the_contacts_of_a_moving_load_until_they_are_stale(
    line: Line, client: Path, bench: modelfile.ModelFile
) -> None:
    contacts, compared = Contacts(line.url), set[int]()
    waiting: list[Poll] = []
    contacts.start()
    with polls(client, modbus_port(line)) as found:
        for poll in found:
            waiting.append(poll)
            if len(waiting) > LATER:
                compared |= same(waiting.pop(0), bench.channels, contacts.said)
            if len(compared) >= ENOUGH and states(compared, contacts.said) >= BOTH:
                break
        contacts.stop.set()
        contacts.join()
        os.kill(line.pids()["daemon"], SIGKILL)
        require_stale(found)
    assert states(compared, contacts.said) >= BOTH


def states(compared: set[int], said: dict[int, dict[str, Any]]) -> set[str]:
    """Return the states of the contacts that were compared."""
    return {said[number]["state"] for number in compared}


def same(poll: Poll, channels: list[str], said: dict[int, dict[str, Any]]) -> set[int]:
    """Require that a block says what the contact of its sample says; return its number, if there was one."""
    block = decoded(poll.words, channels)
    contact = said.get(block["sequence"])
    if block["state"] is None or contact is None:
        return set()
    assert block == expected(contact)
    assert poll.words[4] <= STALE_MS
    *figures, constant = poll.floats
    assert [None if math.isnan(one) else single(one) for one in figures] == [block[name] for name in FIGURES]
    assert constant == 1234.5
    return {contact["sequence"]}


def require_stale(found: Iterator[Poll]) -> None:
    """Read on until the surface has been stale for 50 polls in a row; no poll may have a figure that is too old."""
    stale = 0
    for poll in found:
        if poll.words[2] == STALE:
            stale += 1
            assert poll.words[4] >= STALE_MS
            assert all(map(math.isnan, poll.floats[:-1]))
            assert poll.words[3] == poll.words[5] == sum(poll.words[22:]) == 0
        else:
            stale = 0
            assert poll.words[4] <= STALE_MS
        if stale >= 50:
            return
    pytest.fail("the client ended")
