"""Writes of the record to the disk: an SD card wears out by what is written again and again."""

from pathlib import Path

import pytest

from beamtouch_service.sections import EventsSection
from service.bench import Bench, Row, surface_of
from service.event_story import HARDER, RESTING, TOUCHING, Story
from service.record_file import execute

PAGE_BYTES = 1024 + 24
"""A page of the file, with its head in the write-ahead log."""
CONTACT: list[Row] = [*[RESTING] * 3, *[TOUCHING] * 9]


class Disk:
    """A service whose record is a file."""

    def __init__(self, path: Path, rows: list[Row]) -> None:
        self.bench = Bench(surface_of(), events=EventsSection(file=path))
        self.story = Story(self.bench, rows)
        self.story.is_growing = True
        self._path, self._log = path, path.with_name(f"{path.name}-wal")

    def pages(self, first: int, last: int) -> float:
        """Deliver samples and make them durable; return how many pages that writes."""
        execute(self._path, "PRAGMA wal_checkpoint(TRUNCATE)")
        self.story.deliver(first, last)
        self.bench.get("/events")
        return self._log.stat().st_size / PAGE_BYTES


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "events.db"


def test_a_beam_at_rest_writes_one_page(path: Path) -> None:
    disk = Disk(path, [RESTING] * 30)
    disk.pages(0, 10)
    assert round(disk.pages(10, 20)) == 1
    assert round(disk.pages(20, 30)) == 1
    assert disk.pages(30, 30) == 0  # nothing came


def test_a_contact_that_goes_on_writes_some_pages_however_long_it_is(path: Path) -> None:
    disk = Disk(path, [RESTING, *([TOUCHING] * 50 + [HARDER] * 50) * 20])
    written = [disk.pages(first, first + 100) for first in range(0, 2000, 100)]
    assert max(written[1:]) <= 8


def test_a_contact_writes_some_pages_however_many_were_before(path: Path) -> None:
    disk = Disk(path, CONTACT * 160)
    early = [disk.pages(first, first + 12) for first in range(0, 240, 12)]
    for first in range(240, 1200, 240):
        disk.pages(first, first + 240)
    late = [disk.pages(first, first + 12) for first in range(1200, 1920, 12)]
    assert max(early[1:] + late) <= 35
    assert sum(late) / 60 <= 25
    assert disk.bench.get("/surfaces/press-7").json()["health"]["s1"]["contacts"] > 100
