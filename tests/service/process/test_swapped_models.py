"""A controller reads a light contact, over Modbus and HTTP, while models are taken and taken back."""

from itertools import groupby
from pathlib import Path
from typing import Any

import pytest

from beamtouch_service import cli
from service.bench import START_US, TOKEN, Row, batch_of
from service.event_story import BETWEEN, TOUCHING
from service.process.conftest import StartService
from service.process.modbus_service import ModbusService, start_modbus
from support.running.waiting import wait_until
from support.surfaces.small_model import content_of, model_of

STATE, CONTACT = 2, 2
"""The register of the state, and its value."""
PATIENCE_S = 120.0


class LightContact:
    """A contact that was touched once, and then is so light that no model would see it begin."""

    def __init__(self, server: ModbusService) -> None:
        self.server, self.sequence = server, 0
        self.states, self.models = list[int](), list[str]()
        self.send(TOUCHING)

    def send(self, row: Row) -> None:
        """Send one sample, and read what a controller sees."""
        self.sequence += 1
        begin_us = START_US + self.sequence * 5000
        assert self.server.http.post(batch_of(row, sequence=self.sequence, begin_us=begin_us)).is_success
        self.states.append(self.server.registers(count=3)[STATE])
        self.models.append(self.server.http.get("/surfaces/press-7/contact").json()["model"])

    def lasts_until(self, model: str) -> None:
        """Let the contact last until this model answers, and three samples longer."""

        def is_in_use() -> bool:
            self.send(BETWEEN)
            return self.models[-3:] == [model] * 3

        wait_until(is_in_use, PATIENCE_S)


@pytest.mark.promise("docs/how-to/rollout.md", "So a contact that lies there stays one, in its zones")
@pytest.mark.promise("docs/reference/trail.md", "in the place of the old one, also by `take` and `take-back`")
def test_a_light_contact_stays_one_while_models_are_taken_and_taken_back(
    start_press: StartService, tmp_path: Path
) -> None:
    server = start_modbus(start_press, "")
    old, new = model_of().identity, model_of("new").identity
    contact = LightContact(server)
    (tmp_path / "press-7.candidate.onnx").write_bytes(content_of("new"))

    def run(word: str) -> int:
        return cli.main([word, "--config", str(tmp_path / "service.toml"), "press-7"])

    def candidate() -> dict[str, Any]:
        said: dict[str, Any] = server.http.get("/surfaces/press-7/candidate").json()
        return said

    wait_until(lambda: candidate()["candidate"] == new, PATIENCE_S)
    contact.send(BETWEEN)
    assert candidate()["comparison"]["states"] == [{"model": "contact", "candidate": "contact", "samples": 1}]
    assert run("take") == 0
    contact.lasts_until(new)
    assert run("take-back") == 0
    contact.lasts_until(old)
    assert set(contact.states) == {CONTACT}
    assert [name for name, _ in groupby(contact.models)] == [old, new, old]

    def noted() -> list[str]:
        entries = server.http.get("/audit?action=model&surface=press-7", TOKEN).json()["entries"]
        return [entry["details"]["model"] for entry in entries[::-1]]

    # The way back is on the trail a minute later, as a state that changes often is told once a minute.
    wait_until(lambda: noted()[:2] == [old, new], PATIENCE_S)
