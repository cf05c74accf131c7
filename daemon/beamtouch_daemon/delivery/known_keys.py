"""Batches in the format that the service knows: an older service receives them without the keys that it names.

An older service takes every sample for a settled one. So samples of a moving beam carry the one note that it knows.
"""

import logging
from collections.abc import Iterable
from time import monotonic

from beamtouch_service.samples import Batch, Note, Sample

BATCH_KEYS = frozenset({"notes", "noise_mm", "characteristic"})
SAMPLE_KEYS = frozenset({"readings", "covariance_mm2"})
"""Keys that were added to the format since its first version."""
ASK_AGAIN_S = 60.0
"""All keys are sent again after this time, as a service may be updated without a failed request."""
MOVING = 1.5
"""Variance over that of as many white readings from which a sample's readings move."""

_log = logging.getLogger(__name__)


class KnownKeys:
    """The keys that the service of one surface knows."""

    def __init__(self, surface: str) -> None:
        self._surface = surface
        self._unknown: frozenset[str] = frozenset()
        self._logged: frozenset[str] = frozenset()
        """The unknown keys of the last log line."""
        self._ask_s = 0.0

    def ask_again(self) -> None:
        """Forget what the service knows if that was learnt long ago."""
        if monotonic() >= self._ask_s:
            self.forget()

    def known_part(self, batch: Batch) -> Batch:
        """Return a batch without the keys that the service does not know."""
        return without(batch, self._unknown) if self._unknown else batch

    def refused(self, named: Iterable[str]) -> bool:
        """Note the keys that the service names as unknown; return whether one of them can be left out from now on."""
        new = (BATCH_KEYS | SAMPLE_KEYS).intersection(named) - self._unknown
        if new:
            self._unknown |= new | ({"covariance_mm2"} if "readings" in new else set())
            self._ask_s = monotonic() + ASK_AGAIN_S
        return bool(new)

    def taken(self) -> None:
        """Note that the service took a batch; log a change of the keys that it knows."""
        if self._unknown - self._logged:
            _log.warning(
                "%s: an older service does not know %s; samples are sent without, so it takes those of a moving beam "
                "for settled ones, and %s; update the service",
                self._surface,
                ", ".join(sorted(self._unknown)),
                "cannot say so" if "notes" in self._unknown else f"shows the note `{Note.RATE}` with them",
            )
        elif self._logged and not self._unknown:
            _log.info("%s: the service knows all keys of a batch now", self._surface)
        self._logged = self._unknown

    def forget(self) -> None:
        """Send all keys again, as the service may be another one now."""
        self._unknown = frozenset()


def without(batch: Batch, unknown: frozenset[str]) -> Batch:
    """Return a batch without some of its keys; a note takes the place of the covariances of a moving beam."""
    keys: dict[str, object] = {key: Batch.model_fields[key].default for key in BATCH_KEYS & unknown}
    if "covariance_mm2" in unknown:
        dropped = dict.fromkeys(SAMPLE_KEYS & unknown)
        keys["samples"] = [sample.model_copy(update=dropped) for sample in batch.samples]
        if "notes" not in unknown and any(_moves(sample, batch.noise_mm) for sample in batch.samples):
            keys["notes"] = sorted({*batch.notes, Note.RATE})
    return batch.model_copy(update=keys)


def _moves(sample: Sample, noise_mm: list[float] | None) -> bool:
    """Return whether a sample's covariance is more than the noise of its readings."""
    if sample.covariance_mm2 is None or sample.readings is None or noise_mm is None:
        return False
    variances = [sample.covariance_mm2[row * (row + 3) // 2] for row in range(len(noise_mm))]
    pairs = zip(variances, noise_mm, strict=True)
    return any(variance * sample.readings > MOVING * noise**2 for variance, noise in pairs)
