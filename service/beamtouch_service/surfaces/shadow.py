"""A candidate that runs beside the model of a surface, on the same samples, after each answer is given.

Whatever happens in it ends the shadow, and nothing else.
"""

import logging
from collections.abc import Callable, Collection, Iterator
from time import thread_time

from beamtouch_models.runtime import ModelFile
from beamtouch_service.samples import Batch, Sample
from beamtouch_service.sections import SurfaceSection
from beamtouch_service.surfaces.comparison import Comparison
from beamtouch_service.surfaces.estimate import CHUNK
from beamtouch_service.surfaces.follower import Decision, Follower
from beamtouch_service.surfaces.freshness import Moment

SLOW_S, SLOW_SAMPLES = 0.005, CHUNK
"""A candidate that works longer [s] on each of so many samples would delay the answers to the next ones."""
BUSY = 1 / 4
"""So does one that works for a larger share of the time that they cover: the model works, too, as do other surfaces."""

_log = logging.getLogger(__name__)


class Shadow:
    """A candidate beside the model of a surface."""

    def __init__(
        self,
        candidate: ModelFile,
        surface: str,
        section: SurfaceSection,
        clock: Callable[[], float] = thread_time,
    ) -> None:
        """Compare it with the model of the surface; `clock` gives the processor time [s]."""
        self.model = candidate
        self.comparison = Comparison()
        self.error: str | None = None
        """Why the comparison has ended; None while it goes on."""
        self._surface, self._clock = surface, clock
        self._follower = Follower(candidate, surface, section, lambda _took_s: None, examines=False)
        self._has_begun = False
        self._worked_s, self._weighed = 0.0, 0
        """Work on the last samples, up to `SLOW_SAMPLES`, and how many these are."""
        self._covered_s = 0.0
        """Time that these cover."""

    def begin(self, follower: Follower) -> None:
        """Begin after the samples of the follower that answers, unless it has begun or has other channels."""
        if not self._has_begun:
            self._has_begun = True
            if follower.model.channels == self.model.channels:
                self._follower.go_on_from(follower)

    def follow(
        self,
        batch: Batch,
        samples: list[Sample],
        moments: list[Moment],
        sender_notes: Collection[str],
        answered: list[Decision],
    ) -> Iterator[None]:
        """Compare on samples that were answered so, one after another."""
        if self.error is not None:
            return
        try:
            taken_us = [round(moment.taken_s * 1e6) for moment in moments]
            decisions = self._follower.follow(batch, samples, taken_us, sender_notes)
            for decided, moment in zip(answered, moments, strict=True):
                yield
                begin_s = self._clock()
                self.comparison.add(decided, next(decisions), moment.passed_s)
                self._require_speed(self._clock() - begin_s, moment.passed_s)
        except Exception as error:  # noqa: BLE001  # a fault of a candidate must not disturb the answer
            self.error = f"the comparison has ended: {str(error) or type(error).__name__}"
            _log.error("surface %s: candidate %s: %s", self._surface, self.model.identity, self.error)

    def _require_speed(self, worked_s: float, passed_s: float) -> None:
        """Raise RuntimeError if the last samples took too long."""
        self._worked_s += worked_s
        self._covered_s += passed_s
        self._weighed += 1
        if self._weighed < SLOW_SAMPLES:
            return
        mean_s, apart_s = self._worked_s / SLOW_SAMPLES, self._covered_s / SLOW_SAMPLES
        self._worked_s, self._covered_s, self._weighed = 0.0, 0.0, 0
        if mean_s > min(SLOW_S, BUSY * apart_s):
            each, apart = (f"{round(time_s * 1e3, 1):g} ms" for time_s in (mean_s, apart_s))
            raise RuntimeError(f"it works {each} on a sample, {apart} apart, which would delay answers")
