"""What tests of faults share: a cable that can be pulled, samples that are the counts, a log file."""

import asyncio
import sqlite3
from collections.abc import AsyncIterator, Callable, Iterator
from contextlib import asynccontextmanager, closing, contextmanager
from pathlib import Path

import pytest

from beamtouch_service.samples import Batch, Sample
from support.surfaces import configs

from .lines import Terminal
from .process import PATIENT_STOP, Daemon, started, summary_of
from .service import Service
from .waits import until

LOG_FILE = "beamtouch-daemon.samples"
RATE_HZ = 200.0
BACK_S = 2.0
SLACK_S = 5.0
"""What a busy machine may add."""
TURN_S = 0.02


class Cable:
    """A name under which a device can be plugged in, out, and in again, as /dev/serial/by-id has them."""

    def __init__(self, folder: Path) -> None:
        self.path = folder / "usb-beamtouch"
        self._line: Terminal | None = None

    def plug(self) -> Terminal:
        self.unplug()
        self._line = Terminal()
        self.path.symlink_to(self._line.path)
        return self._line

    def unplug(self) -> None:
        self.path.unlink(missing_ok=True)
        if self._line is not None:
            self._line.unplug()
            self._line = None


@contextmanager
def cable(folder: Path) -> Iterator[Cable]:
    one = Cable(folder)
    try:
        yield one
    finally:
        one.unplug()


def plain(source: str) -> str:
    """Return a surface whose samples are the counts themselves, negative: no filter, a gap is a count."""
    text = configs.surface(source=source, rate_hz=RATE_HZ)
    text = text.replace("-0.0001", "1.0").replace("= 4.5", "= 0.0").replace("= 2.5", "= 0.0")
    text = text.replace("[1.0, 4.0]", "[0.0, 65535.0]")
    head, _, tail = text.partition('kind = "moving-average"\nwindow = 1')
    return f'{head}kind = "none"{tail}'


def counts_of(samples: list[Sample]) -> list[tuple[float, float]]:
    """Return the counts of samples of which both channels are good."""
    return [
        (-first, -second)
        for first, second in (sample.deflection_mm for sample in samples)
        if first is not None and second is not None
    ]


async def soon(holds: Callable[[], bool], within_s: float = BACK_S + SLACK_S) -> None:
    """Wait for what must come soon, in turns that take the longer the more starved the machine is."""
    for _ in range(round(within_s / TURN_S)):
        if holds():
            return
        await asyncio.sleep(TURN_S)
    pytest.fail(f"it did not come within {within_s:g} s")


async def everything(service: Service) -> None:
    """Wait until the record of a service has every sample up to the newest that was sent."""
    newest = {(name, batch.boot_id): batch.samples[-1].sequence for name, batch, _ in service.batches if batch.samples}
    async with asyncio.timeout(60):
        while any(service.record.durable.get(boot, 0) < number for boot, number in newest.items()):  # noqa: ASYNC110
            await asyncio.sleep(0.05)


@asynccontextmanager
async def running(
    folder: Path, source: str, url: str, code: str = "", *, publish: str = "", prefix: tuple[str, ...] = ()
) -> AsyncIterator[Daemon]:
    config = configs.write(folder, plain(source), url=url)
    config.write_text(config.read_text().replace("batch_ms", f"{publish}\nbatch_ms"))
    code = "; ".join(filter(None, [code, PATIENT_STOP]))
    async with started("run", config, "--summary", folder / "summary.json", code=code, prefix=prefix) as daemon:
        yield daemon


async def leave_samples(folder: Path, config: Path, enough: Callable[[], bool]) -> dict[str, int]:
    """Run a daemon whose service is away until it has read enough; return what its summary says of its only surface."""
    async with started("run", config, "--summary", folder / "summary.json") as daemon:
        await until(enough)
        assert (await daemon.stop()).code == 0
    counts: dict[str, int]
    (counts,) = summary_of(folder).values()
    return counts


def names(batches: list[Batch]) -> list[tuple[str, int]]:
    """Return what names each sample for good."""
    return [(batch.boot_id, sample.sequence) for batch in batches for sample in batch.samples]


def batches_in(path: Path) -> list[Batch]:
    """Return all batches in a log file."""
    if not path.exists():
        return []
    with closing(sqlite3.connect(path)) as database:
        rows = database.execute("SELECT content FROM chunk ORDER BY id").fetchall()
    return [Batch.model_validate_json(content) for (content,) in rows]


def samples_in(path: Path) -> list[Sample]:
    """Return all samples in a log file."""
    return [sample for batch in batches_in(path) for sample in batch.samples]
