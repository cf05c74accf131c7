"""Stories of samples that are delivered to a service, and the events that it makes of them."""

from itertools import takewhile
from typing import Any

import httpx2

from service.bench import START_US, Bench, Row, batch_of
from support.running.waiting import wait_until

TOUCHING: Row = [0.5, 0.25, 0.125]
HARDER: Row = [0.5, 0.5, 0.25]
RESTING: Row = [0.0, 0.0, 0.0]
BETWEEN: Row = [0.05, 0.0, 0.0]
"""It ends no contact, and begins none."""
ODD: Row = [0.5, 0.25, 0.75]
"""Neither rest nor a single contact. The state follows from the third in a row, and for two more samples."""
STILL: dict[str, Any] = {"readings": 4}
MOVING: dict[str, Any] = {"readings": 50, "covariance_mm2": [1e-3, 0.0, 1e-3, 0.0, 0.0, 1e-3]}


class Story:
    """Samples 5 ms apart, the first one at `START_US`, of a sender that keeps them until they are on record."""

    def __init__(self, bench: Bench, rows: list[Row], boot_id: str = "boot-0001") -> None:
        self.bench, self.rows, self.boot_id = bench, rows, boot_id
        self.oldest: int | None = 1
        self.later_us = 0
        """Pause of the device before the samples that are delivered next."""
        self.earlier: list[str] = []
        self.is_growing = False
        """Whether a sample is the mean of all readings since the beam changed."""

    def offer(self, first: int, last: int, **members: object) -> dict[str, Any]:
        """Send the samples from index `first` up to, but not including, `last` once; return the receipt."""
        rows = self.rows[first:last]
        begin_us = START_US + first * 5000 + self.later_us
        body = batch_of(*rows or [RESTING], sequence=first + 1, boot_id=self.boot_id, begin_us=begin_us)
        body["samples"] = body["samples"][: len(rows)]
        if self.is_growing:
            for index, sample in enumerate(body["samples"], first):
                sample["readings"] = self._readings(index)
        body |= {"oldest": self.oldest, "earlier": self.earlier} | members
        self.bench.now_s += 0.001
        answer = self.bench.post(body)
        assert answer.status_code == 200, answer.text
        receipt: dict[str, Any] = answer.json()
        return receipt

    def _readings(self, index: int) -> int:
        """Return the number of rows up to this one that are the same."""
        return sum(1 for _ in takewhile(lambda row: row is self.rows[index], self.rows[index::-1]))

    def deliver(self, first: int, last: int, **members: object) -> dict[str, Any]:
        """Send samples, and again as a backlog until the record can be read; return the receipt."""
        receipts = [self.offer(first, last, **members)]

        def is_read() -> bool:
            if receipts[-1]["expected"] is None:
                receipts.append(self.offer(first, last, **members | {"backlog": True, "newest_age_ms": None}))
            return receipts[-1]["expected"] is not None

        wait_until(is_read, pause_s=0.05)
        return receipts[-1]

    def backlog(self, first: int, last: int) -> dict[str, Any]:
        """Send samples from the log; return the receipt."""
        return self.deliver(first, last, backlog=True, newest_age_ms=None)

    def ask(self) -> dict[str, Any]:
        """Ask how far the record is."""
        return self.backlog(0, 0)

    def catch_up(self) -> None:
        """Send what the record lacks."""
        self.backlog(self.ask()["expected"] - 1, len(self.rows))

    def _read(self, path: str) -> dict[str, Any]:
        """Return an answer; a database that is busy for a while may be asked again."""
        pages: list[dict[str, Any]] = []

        def is_read() -> bool:
            response = self.bench.get(path)
            pages.append(response.json())
            return response.status_code != httpx2.codes.SERVICE_UNAVAILABLE

        wait_until(is_read, pause_s=0.05)
        return pages[-1]

    @property
    def events(self) -> list[dict[str, Any]]:
        """All events, oldest first, without the members that differ between services."""
        events, following = list[dict[str, Any]](), ""
        while following is not None:
            page = self._read(f"/events?path=true{following and f'&after={following}'}")
            events, following = events + page["events"], page["next"]
        return [{name: event[name] for name in event if name not in ("id", "model")} for event in reversed(events)]


def story_of(bench: Bench, rows: list[Row]) -> Story:
    """Deliver rows to a service, in order; return the story."""
    story = Story(bench, rows)
    story.deliver(0, len(rows))
    return story


def send(bench: Bench, *samples: tuple[Row, dict[str, Any]], sequence: int = 1) -> None:
    """Send these samples, 100 ms apart, each with its further members."""
    begin_us = 1_795_218_000_000_000 + sequence * 100_000
    members = batch_of(*(row for row, _ in samples), sequence=sequence, begin_us=begin_us, every_us=100_000)
    for sample, (_, more) in zip(members["samples"], samples, strict=True):
        sample.update(more)
    noise_mm = [0.01] * len(members["channels"])
    bench.send(members=members | {"noise_mm": noise_mm, "characteristic": "as-taken"})
