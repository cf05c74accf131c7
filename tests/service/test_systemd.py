"""Sockets that a manager passes on in a number that the service cannot use."""

import os

import pytest

from beamtouch_service.config import ConfigError
from beamtouch_service.host.systemd import activated


@pytest.fixture(autouse=True)
def _ours(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("LISTEN_PID", str(os.getpid()))


def test_several_sockets_are_refused_and_not_passed_on(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("LISTEN_FDS", "2")
    with pytest.raises(ConfigError, match="2 sockets were passed on; the service takes one"):
        activated()
    assert not {"LISTEN_PID", "LISTEN_FDS"} & os.environ.keys()


def test_none_is_as_good_as_no_manager(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("LISTEN_FDS", "0")
    assert activated() is None
