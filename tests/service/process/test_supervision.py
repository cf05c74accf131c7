"""What keeps the service going for a year: the service manager and its watchdog."""

import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path

import httpx2
import pytest

from service.bench import BuildModel, batch_of
from service.process.conftest import Service, StartService
from support.programs.service_manager import Manager
from support.running.waiting import wait_until


@pytest.fixture
def manager(tmp_path: Path) -> Iterator[Manager]:
    with closing(Manager(tmp_path)) as manager:
        yield manager


def test_the_manager_hears_of_the_start_of_progress_and_of_the_end(start_press: StartService, manager: Manager) -> None:
    service = start_press(code=manager.code)

    assert manager.until("READY=1")
    assert manager.until("WATCHDOG=1", times=5)
    service.process.send_signal(signal.SIGTERM)
    assert manager.until("STOPPING=1")
    assert service.process.wait(timeout=60) == 0
    assert manager.heard[:2] == ["READY=1", f"STATUS={service.first_line.strip()}"]


def test_a_service_that_stands_still_is_not_alive(start_press: StartService, manager: Manager, tmp_path: Path) -> None:
    sign = tmp_path / "stand still"
    stuck = (
        "import os, time\n"
        "from beamtouch_service.surfaces import surface\n"
        "held = surface.Surface.view\n"
        "def hang(self, now_s):\n"
        f"    if os.path.exists({str(sign)!r}): time.sleep(60)\n"
        "    return held(self, now_s)\n"
        "surface.Surface.view = hang\n"
    )
    start_press(code=f"{manager.code}\n{stuck}")
    assert manager.until("READY=1")
    assert manager.until("WATCHDOG=1")
    sign.touch()

    deadline_s = time.monotonic() + 60
    while manager.until("WATCHDOG=1", within_s=2):
        assert time.monotonic() < deadline_s


def test_ctrl_c_ends_the_service_without_a_word(fresh: Service) -> None:
    code, said = fresh.stop(signal.SIGINT)
    # The digests of the trail are for a log, whatever comes after them.
    assert (code, [line for line in said.splitlines() if " INFO trail: entry " not in line]) == (130, [])


@pytest.mark.promise(
    "docs/reference/problems.md",
    "`stopping`: the service stopped before the whole batch had arrived.",
)
def test_it_stops_with_a_sender_connected(fresh: Service) -> None:
    service = fresh
    answers: list[httpx2.Response] = []
    sent, release = threading.Event(), threading.Event()

    def slow() -> Iterator[bytes]:
        yield b"{"
        sent.set()
        release.wait(60)
        yield b"}"

    def post() -> None:
        answers.append(service.post(slow()))

    sender = threading.Thread(target=post)
    sender.start()
    assert sent.wait(60)
    # A later connection is answered, so the sender's has been accepted, and does not only wait in the kernel's queue.
    assert service.get("/contact").status_code == 503
    code, errors = service.stop(signal.SIGTERM)
    release.set()
    sender.join()
    assert code == 0
    (answer,) = answers
    assert answer.json()["type"] == "urn:beamtouch:problem:stopping"
    assert "Traceback" not in errors


@pytest.mark.parametrize(
    ("section", "broken"),
    [
        ("models", "from beamtouch_service.host import models as part; part.watch = end"),
        (
            "events",
            "from beamtouch_service.record.writing.transactions import Transactions as part; part.commit = fail",
        ),
    ],
)
def test_readiness_names_a_part_that_ended_in_an_unexpected_error(
    start_press: StartService, section: str, broken: str
) -> None:
    service = start_press(code=f"def fail(*_): return 1 / 0\nasync def end(*_): return 1 / 0\n{broken}")

    assert service.post(batch_of()).status_code == 200

    wait_until(lambda: section in service.get("/health/ready").json().get("missing", {}))
    assert "ZeroDivisionError" in service.get("/health/ready").json()["missing"][section]
    assert f'beamtouch_missing{{section="{section}"}} 1.0' in service.get("/metrics").text
    # The others go on.
    assert service.get("/surfaces/press-7/contact").status_code == 200


def test_the_service_runs_where_no_memory_may_become_code(build_model: BuildModel) -> None:
    program = (
        "import ctypes, sys, pathlib\n"
        "if ctypes.CDLL(None).prctl(65, 1, 0, 0, 0): sys.exit(77)\n"  # PR_SET_MDWE, as MemoryDenyWriteExecute=
        "from beamtouch_service.host import models, setup\n"
        "print(models.report(pathlib.Path(sys.argv[1]), as_json=True))\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", program, str(build_model())], capture_output=True, text=True, check=False, timeout=60
    )
    if done.returncode == 77:
        pytest.skip("this kernel cannot forbid it: Linux 6.3 can")
    assert (done.returncode, done.stderr) == (0, "")
