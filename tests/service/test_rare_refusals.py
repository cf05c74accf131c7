"""Refusals that few users meet: each says what to do, and costs nothing else."""

from __future__ import annotations

import sys

import pytest

from beamtouch_service.events.database import EventStoreError
from beamtouch_service.events.store import Store
from beamtouch_service.sections import EventsSection


def test_an_address_that_cannot_be_read_is_not_quoted() -> None:
    with pytest.raises(EventStoreError, match=r"events\.url cannot be read; it looks like postgresql://") as refusal:
        Store(EventsSection(url="postgresql://beamtouch:secret@127.0.0.1:port/beamtouch"))
    assert "secret" not in str(refusal.value)


def test_a_database_without_its_library_names_the_extra(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "psycopg", None)  # as if it were not installed
    with pytest.raises(EventStoreError, match=r"needs psycopg; run: pip install 'beamtouch\[postgresql\]'"):
        Store(EventsSection(url="postgresql://beamtouch@127.0.0.1/beamtouch"))
