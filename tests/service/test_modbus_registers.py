"""The register map: complete, without overlaps, and the same in the code and the command."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING

from beamtouch_models.modelfile import State
from beamtouch_service import cli
from beamtouch_service.outputs.modbus.registers import BLOCK, REGISTERS, STATES
from beamtouch_service.problems import Kind
from beamtouch_service.samples import Note, Quality

if TYPE_CHECKING:
    import pytest

CONFIG = """
[modbus_server]
word_order = "little"
[surfaces.press-7]
model = "press-7.onnx"
[surfaces.a-press]
"""


def test_no_two_registers_share_an_address() -> None:
    taken = [place for one in REGISTERS for place in range(one.offset, one.offset + one.type.count)]

    assert len(set(taken)) == len(taken)
    assert max(taken) < BLOCK
    assert len({one.name for one in REGISTERS}) == len(REGISTERS)


def test_every_state_and_every_problem_of_a_surface_has_a_code() -> None:
    problems = {Kind.STALE, Kind.NO_SAMPLES, Kind.OTHER_BEAM, Kind.NO_MODEL, Kind.TOO_FEW_CHANNELS}

    assert set(STATES) == {*State, *problems, Kind.UNUSABLE_ESTIMATE}
    assert len({code for code, _ in STATES.values()}) == len(STATES)
    assert all(code >= 16 for state, (code, _) in STATES.items() if isinstance(state, Kind))


def test_every_note_has_a_bit_and_every_quality_has_registers() -> None:
    assert [note.bit for note in Note] == list(range(len(Note)))
    named = {one.name.replace("_", "-") for one in REGISTERS}
    assert named >= {quality.value for quality in Quality if quality is not Quality.GOOD}


def test_the_command_lists_the_blocks_of_a_configuration(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "service.toml"
    path.write_text(CONFIG)
    assert cli.main(["registers", "--config", str(path)]) == 0
    text = capsys.readouterr().out
    assert cli.main(["registers", "--config", str(path), "--json"]) == 0
    found = json.loads(capsys.readouterr().out)

    assert found["surfaces"] == [
        {"surface": "press-7", "address": 0, "identity": 7881},
        {"surface": "a-press", "address": 50, "identity": 41422},
    ]
    assert (found["function"], found["registers_per_surface"], found["word_order"]) == (4, 50, "little")
    assert [one["name"] for one in found["registers"]] == [one.name for one in REGISTERS]
    assert (found["states"]["contact"], found["states"]["stale"], found["notes"]["rate"]) == (2, 18, 3)
    assert "| `a-press` | 50 to 99  | 41422    |\n\nWord order: little." in text


def test_a_wrong_configuration_is_one_line_and_exit_code_2(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "service.toml"
    for section, complaint in {
        "word_order = 'middle'": "modbus_server.word_order",
        "unit = 1": "modbus_server.unit",
        "port = 65536": "modbus_server.port",
        "idle_s = inf": "modbus_server.idle_s",
        "max_clients = 0": "modbus_server.max_clients",
    }.items():
        path.write_text(f"[modbus_server]\n{section}\n")
        assert cli.main(["registers", "--config", str(path)]) == 2
        (line,) = capsys.readouterr().err.splitlines()
        assert complaint in line
