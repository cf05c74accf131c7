"""Dialogues whose standard input is closed, or no text: an end or a wrong answer, never a hang."""

import asyncio
import os
import subprocess
import sys
from pathlib import Path

import pytest

from . import configs
from .devices import pymodbus_server
from .test_init import template

pytestmark = pytest.mark.anyio

CLOSED = ("sh", "-c", 'exec "$@" <&-', "sh")


async def typed(*words: str | Path, prefix: tuple[str, ...] = (), answers: bytes = b"") -> tuple[int, list[str]]:
    """Run the daemon; return its exit code and its lines on standard error."""
    program = [*prefix, sys.executable, "-m", "beamtouch_daemon", *map(str, words)]
    environment = os.environ | {"PYTHONIOENCODING": "utf-8:strict"}  # as with LANG=en_US.UTF-8
    done = await asyncio.to_thread(
        subprocess.run, program, input=answers, capture_output=True, timeout=120, env=environment
    )
    return done.returncode, done.stderr.decode().replace("beamtouch-daemon: ", "").splitlines()


async def test_init_without_answers_says_which_option_is_missing(tmp_path: Path) -> None:
    code, said = await typed("init", tmp_path / "daemon.toml", prefix=CLOSED)
    assert (code, said[-1].partition(":")[0]) == (2, "--model-config")


async def test_record_without_answers_records_nothing(tmp_path: Path) -> None:
    async with pymodbus_server([20_000, 21_000]) as port:
        config = configs.write(tmp_path, configs.surface(source=configs.tcp(port)))
        code, said = await typed("record", config, "-o", tmp_path / "loads.csv", prefix=CLOSED)
    assert code == 1
    assert said[-1].startswith("load 1: put it on")
    assert len((tmp_path / "loads.csv").read_text().splitlines()) == 1


async def test_an_answer_that_is_no_text_is_a_wrong_answer(tmp_path: Path) -> None:
    async with pymodbus_server([20_000, 21_000]) as port:
        config = configs.write(tmp_path, configs.surface(source=configs.tcp(port)))
        code, said = await typed("record", config, "-o", tmp_path / "loads.csv", answers=b"150\xa0mm 10\n")
    assert code == 1
    assert any(line.startswith("give two numbers") for line in said)


async def test_a_source_whose_name_is_no_text_is_wrong_input(tmp_path: Path) -> None:
    model = template(tmp_path)
    name = b"rtu:/dev/tty\xff".decode(errors="surrogateescape")
    code, said = await typed("init", tmp_path / "daemon.toml", "--model-config", model, "--source", name)
    assert (code, said[-1]) == (2, "the source and the files must have names in UTF-8")
    assert not (tmp_path / "daemon.toml").exists()
