"""Stories of samples that are delivered to a service, and the events that it makes of them."""

from typing import Any

from service.conftest import Bench, Row, batch_of
from waiting import wait_until

START_US = 1_795_218_046_123_456
TOUCHING: Row = [0.5, 0.25, 0.125]
HARDER: Row = [0.5, 0.5, 0.25]
RESTING: Row = [0.0, 0.0, 0.0]
BETWEEN: Row = [0.05, 0.0, 0.0]
"""It ends no contact, and begins none."""
ODD: Row = [0.5, 0.25, 0.75]
"""Neither rest nor a single contact. The state follows from the third in a row, and for two more samples."""


class Story:
    """Samples 5 ms apart, the first one at `START_US`, of a sender that keeps them until they are on record."""

    def __init__(self, bench: Bench, rows: list[Row], boot_id: str = "boot-0001") -> None:
        self.bench, self.rows, self.boot_id = bench, rows, boot_id
        self.oldest: int | None = 1
        self.later_us = 0
        """Pause of the device before the samples that are delivered next."""
        self.earlier: list[str] = []

    def offer(self, first: int, last: int, **members: object) -> dict[str, Any]:
        """Send the samples from index `first` up to, but not including, `last` once; return the receipt."""
        rows = self.rows[first:last]
        body = batch_of(*rows or [RESTING], sequence=first + 1, boot_id=self.boot_id)
        body["samples"] = body["samples"][: len(rows)]
        for offset, sample in enumerate(body["samples"]):
            sample["acquired_unix_us"] = START_US + (first + offset) * 5000 + self.later_us
        body |= {"oldest": self.oldest, "earlier": self.earlier} | members
        self.bench.now_s += 0.001
        answer = self.bench.post(body)
        assert answer.status_code == 200, answer.text
        receipt: dict[str, Any] = answer.json()
        return receipt

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

    @property
    def events(self) -> list[dict[str, Any]]:
        """All events, oldest first, without the members that differ between services."""
        events, following = list[dict[str, Any]](), ""
        while following is not None:
            page = self.bench.get(f"/events?path=true{following and f'&after={following}'}").json()
            events, following = events + page["events"], page["next"]
        return [{name: event[name] for name in event if name not in ("id", "model")} for event in reversed(events)]
