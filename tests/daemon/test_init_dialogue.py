"""`init` on a terminal: its questions, wrong answers, and the ends of the dialogue."""

import asyncio
from pathlib import Path

import pytest

from .answering import at_terminal
from .test_init import content, template

pytestmark = pytest.mark.anyio


async def test_on_a_terminal_it_asks_and_asks_again_after_a_wrong_answer(tmp_path: Path) -> None:
    model, path = template(tmp_path), tmp_path / "daemon.toml"
    answers = {
        "configuration that": [str(tmp_path / "absent.toml"), str(tmp_path / "bench.onnx"), str(model)],
        "source": ["/dev/ttyUSB0", "rtu:/dev/ttyUSB0"],
        "baud": ["fast", "9600"],
        "parity": ["mark", "even"],
        "unit": ["300", "3"],
        "function": [""],
        "service [": ["nowhere", "https://beams.example:8420"],
        "token [": [""],
        "certificate to trust": [""],
    }
    (tmp_path / "bench.onnx").touch()
    code, said = await asyncio.to_thread(at_terminal, ["init", str(path)], answers)
    assert code == 0, said
    assert f"{tmp_path / 'bench.onnx'}: the daemon reads no models" in said
    assert not any(answers.values())
    assert f"there is no file '{tmp_path / 'absent.toml'}'" in said
    assert "'300' is not a whole number from 1 to 247" in said
    assert content(path)["surfaces"]["bench"]["source"] == {
        "kind": "modbus-rtu",
        "port": "/dev/ttyUSB0",
        "baud": 9600,
        "parity": "even",
        "unit": 3,
        "function": 4,
    }
    publish = content(path)["publish"]
    assert publish["url"] == "https://beams.example:8420"
    assert (publish["token_file"], publish["certificate_file"]) == ("beamtouch.token", "certificate.pem")


async def test_a_path_that_no_file_can_have_writes_nothing(tmp_path: Path) -> None:
    model, path = template(tmp_path), tmp_path / "daemon.toml"
    answers = {"source": ["tcp://plc"], "unit": [""], "function": [""], "service [": [""], "token [": ["a\x16\x00b"]}
    arguments = ["init", str(path), "--model-config", str(model)]
    code, said = await asyncio.to_thread(at_terminal, arguments, answers)
    assert code == 2
    assert "publish.token_file: must be the path of a file" in said
    assert not path.exists()


async def test_ctrl_c_at_a_question_ends_it_with_130_and_writes_nothing(tmp_path: Path) -> None:
    path = tmp_path / "daemon.toml"
    code, said = await asyncio.to_thread(at_terminal, ["init", str(path)], {"configuration that": ["\x03"]})
    assert code == 130
    assert "beamtouch-daemon: interrupted" in said
    assert not path.exists()


async def test_the_end_of_the_answers_writes_nothing(tmp_path: Path) -> None:
    path = tmp_path / "daemon.toml"
    code, said = await asyncio.to_thread(at_terminal, ["init", str(path)], {"configuration that": ["\x04"]})
    assert code == 2
    assert "the answers ended; nothing was written" in said
    assert not path.exists()
