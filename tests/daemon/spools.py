"""Batches for a spool, and what comes out of it."""

import time
from collections.abc import Iterator

from beamtouch_daemon.delivery.spool import Spool
from beamtouch_service.samples import Batch, Quality, Sample

ROOM = 10_000_000


def batch_of(first: int, number: int = 10, age_s: float = 0.0) -> Batch:
    samples = [
        Sample(
            sequence=sequence,
            acquired_unix_us=round((time.time() - age_s) * 1e6),
            deflection_mm=[0.25, None],
            quality=[Quality.GOOD, Quality.MISSING],
        )
        for sequence in range(first, first + number)
    ]
    return Batch(boot_id="boot-0001", channels=["s1", "s2"], newest_age_ms=age_s * 1e3, samples=samples)


def drained(spool: Spool, surface: str = "bench") -> Iterator[Batch]:
    while (oldest := spool.oldest(surface)) is not None:
        spool.remove(surface, oldest)
        yield oldest.batch
