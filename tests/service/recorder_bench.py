"""A recorder without a service, and the batches that it takes."""

import asyncio
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager

from beamtouch_service.record.recorder import Recorder
from beamtouch_service.samples import Batch
from beamtouch_service.sections import EventsSection
from beamtouch_service.surfaces.surface import Surface
from service.bench import Row, parsed
from service.event_story import RESTING

PATIENT_S = 30.0
REST: list[Row] = [RESTING] * 3


def batch_of(*rows: Row, first: int = 1, oldest: int | None = 1, boot_id: str = "boot-0001") -> Batch:
    """Return samples from this number on; without rows, a batch that only asks."""
    batch = parsed(*rows, sequence=first, boot_id=boot_id)
    return batch.model_copy(update={"oldest": oldest} | ({} if rows else {"samples": []}))


@asynccontextmanager
async def recording(events: EventsSection | None = None) -> AsyncIterator[Recorder]:
    one = Recorder(events or EventsSection())
    try:
        yield one
    finally:
        await one.close()


async def take(one: Recorder, surface: Surface, *rows: Row, first: int = 1, oldest: int | None = 1) -> tuple[int, int]:
    """Let samples be taken that have a record; return its receipt."""
    durable, expected = await one.take(surface, batch_of(*rows, first=first, oldest=oldest), {})
    assert durable is not None
    assert expected is not None
    return durable, expected


async def commit(one: Recorder) -> None:
    await asyncio.wait([one.commit(everything=True)])
