"""Notifications to a manager that listens, one that is gone, and none."""

import os
import socket
from contextlib import suppress
from pathlib import Path

import pytest

from beamtouch_common.systemd import ServiceManager


def test_a_manager_that_is_gone_is_no_error(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("NOTIFY_SOCKET", str(tmp_path / "gone"))
    ServiceManager().ready("two surfaces")


@pytest.mark.timeout(60)
def test_a_manager_that_does_not_read_holds_nobody_up(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    address = str(tmp_path / "notify")
    monkeypatch.setenv("NOTIFY_SOCKET", address)
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as manager:
        manager.bind(address)
        told = ServiceManager()
        told.ready("two surfaces")
        kept = int(Path("/proc/sys/net/unix/max_dgram_qlen").read_text())
        for _ in range(kept + 10):
            told.alive()
        told.stopping()
        assert manager.recv(100) == b"READY=1\nSTATUS=two surfaces"
        manager.setblocking(False)
        with suppress(BlockingIOError):
            while True:
                assert manager.recv(100) == b"WATCHDOG=1"
        told.alive("one surface")
        assert manager.recv(100) == b"WATCHDOG=1\nSTATUS=one surface"


def test_the_watchdog_of_another_process_is_none(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("WATCHDOG_USEC", "3000000")
    monkeypatch.setenv("WATCHDOG_PID", "1")
    assert ServiceManager().watchdog_s is None


@pytest.mark.parametrize(
    ("variables", "watchdog_s"),
    [
        ({}, None),
        ({"WATCHDOG_USEC": "2500000"}, 2.5),
        ({"WATCHDOG_USEC": "2500000", "WATCHDOG_PID": str(os.getpid())}, 2.5),
        ({"WATCHDOG_USEC": "soon"}, None),
    ],
)
def test_the_watchdog_of_this_process_has_its_time(
    monkeypatch: pytest.MonkeyPatch, variables: dict[str, str], watchdog_s: float | None
) -> None:
    for name in ("WATCHDOG_USEC", "WATCHDOG_PID", "NOTIFY_SOCKET"):
        monkeypatch.delenv(name, raising=False)
    for name, text in variables.items():
        monkeypatch.setenv(name, text)
    told = ServiceManager()
    assert told.watchdog_s == watchdog_s
    told.ready("without a manager, nothing is sent")


def test_a_manager_in_the_abstract_namespace_hears_of_progress_only_after_the_start(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    name = f"beamtouch-test-{os.getpid()}"
    monkeypatch.setenv("NOTIFY_SOCKET", f"@{name}")
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as manager:
        manager.bind(f"\0{name}")
        manager.settimeout(60)
        told = ServiceManager()
        told.alive("not yet")
        told.ready("two surfaces")
        told.alive("one surface")
        told.alive()
        told.stopping()
        heard = [manager.recv(100).decode() for _ in range(4)]
    assert heard == ["READY=1\nSTATUS=two surfaces", "WATCHDOG=1\nSTATUS=one surface", "WATCHDOG=1", "STOPPING=1"]
