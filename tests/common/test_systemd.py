"""Notifications to a manager that listens, one that is gone, and none."""

import os
import socket
from pathlib import Path

import pytest

from beamtouch_common.systemd import ServiceManager


def test_a_manager_is_told_of_progress_once_the_start_is_complete(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("NOTIFY_SOCKET", str(tmp_path / "notify"))
    monkeypatch.setenv("WATCHDOG_USEC", "3000000")
    monkeypatch.setenv("WATCHDOG_PID", str(os.getpid()))
    manager = ServiceManager()
    assert manager.watchdog_s == 3.0
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as listener:
        listener.bind(str(tmp_path / "notify"))
        manager.alive()
        manager.ready("two surfaces")
        manager.alive()
        manager.stopping()
        said = [listener.recv(1000).decode() for _ in range(3)]
    assert said == ["READY=1\nSTATUS=two surfaces", "WATCHDOG=1", "STOPPING=1"]


def test_a_manager_that_is_gone_is_no_error(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("NOTIFY_SOCKET", str(tmp_path / "gone"))
    ServiceManager().ready("two surfaces")


def test_the_watchdog_of_another_process_is_none(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("WATCHDOG_USEC", "3000000")
    monkeypatch.setenv("WATCHDOG_PID", "1")
    assert ServiceManager().watchdog_s is None
