"""Stories of samples that are delivered to a service, and the events that it makes of them."""

from __future__ import annotations

from time import monotonic, sleep
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from service.conftest import Bench, MakeBatch

START_US = 1_795_218_046_123_456
Row = list[float | None]
TOUCHING: Row = [0.5, 0.25, 0.125]
HARDER: Row = [0.5, 0.5, 0.25]
RESTING: Row = [0.0, 0.0, 0.0]
BETWEEN: Row = [0.05, 0.0, 0.0]
"""It ends no contact, and begins none."""
ODD: Row = [0.5, 0.25, 0.75]
"""Neither rest nor a single contact. The state follows from the third in a row, and for two more samples."""


def settle(bench: Bench) -> None:
    """Wait until late samples are on record; queries do not wait for them."""
    recorder, deadline_s = bench.app.context.recorder, monotonic() + 60
    assert recorder is not None
    while recorder.late_waiting:
        assert monotonic() < deadline_s
        sleep(0.001)


class Story:
    """Samples 5 ms apart, number 0 at `START_US`, delivered to a service in any parts and order."""

    def __init__(self, bench: Bench, make_batch: MakeBatch, rows: list[Row]) -> None:
        self.bench, self.make_batch, self.rows = bench, make_batch, rows

    def deliver(self, first: int, last: int, *, age_ms: float = 0.0, boot_id: str = "boot-0001") -> None:
        """Send the samples from `first` up to, but not including, `last`."""
        body = self.make_batch(*self.rows[first:last], sequence=first, age_ms=age_ms, boot_id=boot_id)
        for offset, sample in enumerate(body["samples"]):
            sample["acquired_unix_us"] = START_US + (first + offset) * 5000
        self.bench.now_s += 0.001
        assert self.bench.post(body).status_code == 200

    @property
    def events(self) -> list[dict[str, Any]]:
        """All events, oldest first, without the members that depend on the order of delivery."""
        settle(self.bench)
        events, following = list[dict[str, Any]](), ""
        while following is not None:
            page = self.bench.get(f"/events?path=true{following and f'&after={following}'}").json()
            events, following = events + page["events"], page["next"]
        return [{name: event[name] for name in event if name not in ("id", "model")} for event in reversed(events)]
