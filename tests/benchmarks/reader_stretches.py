"""How long a reader of the record works between two rests: `python tests/benchmarks/reader_stretches.py`.

An answer to `GET /contact` may wait for the interpreter as long as a reader works without a rest. A reader makes pages
of a record of 4000 events with whole paths. Said is the processor time of its thread for a page, and the longest part
of it between two rests. Other programs on the machine do not count.
"""

import sys
import time
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory

sys.path.insert(0, str(Path(__file__).parent.parent))
sys.path.insert(0, str(Path(__file__).parent))

from record_readers import SECTIONS, copy, record
from serving import service
from shipped import build

from beamtouch_service.api import events
from beamtouch_service.record.reading.readers import Reader
from beamtouch_service.record.writing.transactions import Transactions
from beamtouch_service.sections import EventsSection

EVENTS, PAGES = 4000, 10


class Timed(Reader):
    """A reader that notes how long it worked between two rests [s]."""

    def __init__(self, transactions: Transactions) -> None:
        self.stretches_s = list[float]()
        super().__init__(transactions.database)

    def begin(self) -> None:
        """Begin to work."""
        super().begin()
        self._worked_s = time.thread_time()

    def rest(self) -> None:
        """Rest if it is time."""
        now_s = time.thread_time()
        before_s = self._worked_s
        super().rest()
        if self._worked_s != before_s:
            self.stretches_s.append(now_s - before_s)

    def end(self) -> None:
        """Note the last stretch of a part."""
        self.stretches_s.append(time.thread_time() - self._worked_s)
        self.begin()


def make_page(reader: Timed, query: events.EventQuery) -> None:
    """Make a page as the service does."""
    keys = events._find(reader, query, None)[: query.limit]
    reader.end()
    make: Callable[..., Iterator[bytes]] = (
        events._as_csv if query.format == "csv" else partial(events._as_json, path=query.path, following=None)
    )
    for _ in make(reader, keys=keys):
        reader.end()


def main() -> None:
    """Run."""
    with TemporaryDirectory() as place:
        folder = Path(place)
        model = build(folder)
        with service(folder, SECTIONS) as (_, port):
            record(port, model)
        copy(folder / "events.db", EVENTS)
        transactions = Transactions(EventsSection(file=folder / "events.db"))
        for words, query in (
            ("50 events with paths", events.EventQuery(path=True, limit=50)),
            ("1000 events", events.EventQuery(limit=1000)),
            ("1000 events as CSV", events.EventQuery(limit=1000, format="csv")),
        ):
            make_page(Timed(transactions), query)  # makes the statements
            reader = Timed(transactions)
            for _ in range(PAGES):
                make_page(reader, query)
            page_ms, longest_ms = sum(reader.stretches_s) / PAGES * 1e3, max(reader.stretches_s) * 1e3
            print(f"{words}: {page_ms:.1f} ms a page, at most {longest_ms:.2f} ms without a rest", flush=True)
        transactions.close()


if __name__ == "__main__":
    main()
