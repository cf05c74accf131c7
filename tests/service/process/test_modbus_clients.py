"""mbpoll, a client that is not ours, reads what `GET /contact` gives, and is told what it may not do."""

from __future__ import annotations

import re
import subprocess
from typing import TYPE_CHECKING

import pytest

from contact_registers import FIGURES, single
from parts import require
from service.conftest import batch_of

from .modbus_service import ModbusService, start_modbus

if TYPE_CHECKING:
    from pathlib import Path

    from .conftest import StartService

pytestmark = pytest.mark.usefixtures("token_file")


def mbpoll(server: ModbusService, *options: str) -> subprocess.CompletedProcess[str]:
    """Run mbpoll once, with addresses from 0."""
    command = [require("mbpoll", "mbpoll"), "-m", "tcp", "-p", str(server.port), "-0", "-1", "-o", "10", *options]
    return subprocess.run(command, capture_output=True, text=True, check=False, timeout=60)


def values(done: subprocess.CompletedProcess[str]) -> list[str]:
    """Return the values that mbpoll printed."""
    assert done.returncode == 0, done.stdout + done.stderr
    return re.findall(r"^\[\d+\]:\s+(\S+)", done.stdout, re.MULTILINE)


@pytest.mark.parametrize(("word_order", "option"), [("big", ["-B"]), ("little", [])])
def test_mbpoll_reads_a_contact(
    start_service: StartService, tmp_path: Path, word_order: str, option: list[str]
) -> None:
    server = start_modbus(start_service, tmp_path, f'word_order = "{word_order}"')
    assert server.http.post(batch_of([0.2, 0.3, 0.3], sequence=70_000)).status_code == 200
    contact = server.http.get("/surfaces/press-7/contact").json()

    words = values(mbpoll(server, "-t", "3", "-r", "0", "-c", "8", "127.0.0.1"))
    assert (int(words[0]), int(words[2]), int(words[3])) == (7881, 2, 0)
    floats = values(mbpoll(server, "-t", "3:float", *option, "-r", "8", "-c", "6", "127.0.0.1"))
    # It prints six digits.
    assert [float(one) for one in floats] == [pytest.approx(single(contact[name]), rel=1e-5) for name in FIGURES]
    (sequence,) = values(mbpoll(server, "-t", "3:int", *option, "-r", "6", "-c", "1", "127.0.0.1"))
    assert sequence == "70000"


def test_mbpoll_is_told_what_it_may_not_do(start_service: StartService, tmp_path: Path) -> None:
    server = start_modbus(start_service, tmp_path)

    for complaint, options in {
        "Illegal data address": ["-t", "3", "-r", "100", "127.0.0.1"],
        "Illegal function": ["-t", "4", "-r", "0", "127.0.0.1", "1"],
        "Read output (holding) register failed: Illegal function": ["-t", "4", "-r", "0", "127.0.0.1"],
        "Write discrete output (coil) failed: Illegal function": ["-t", "0", "-r", "0", "127.0.0.1", "1"],
    }.items():
        done = mbpoll(server, *options)
        assert complaint in done.stdout + done.stderr
    assert server.registers(52, 1) == [16]
