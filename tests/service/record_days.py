"""Days in the life of a record, at which its service looks after the limits."""

from beamtouch_service.record.writing.retention import Deleted
from service.bench import Bench

DAY_S = 86_400.0
NOW_S = 1.8e9
"""In 2027."""


class Days:
    """The clocks of a machine, and the services on it, one after the other."""

    def __init__(self) -> None:
        self.clock_s, self._uptime_s = NOW_S, 100.0

    def run(self, bench: Bench, days: float = 0.0, looks: int = 1) -> list[Deleted]:
        """Let a service run for so many days, and look so often meanwhile; return what it deletes at each look."""
        deleted = []
        for _ in range(looks):
            self.rest(days / looks)
            deleted.append(self._look(bench))
        return deleted

    def rest(self, days: float) -> None:
        """Let days pass without a service."""
        self.clock_s += days * DAY_S
        self._uptime_s += days * DAY_S

    def set(self, days: float) -> None:
        """Set the wall clock by so many days."""
        self.clock_s += days * DAY_S

    def _look(self, bench: Bench) -> Deleted:
        assert bench.event_loop is not None
        return bench.event_loop.call(bench.app.context.recorder.tidy, self.clock_s, self._uptime_s)
