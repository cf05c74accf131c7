"""Delivery of one surface's samples to the service: batches, retries, and a bounded queue."""

import asyncio
import contextlib
import logging
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass
from http import HTTPStatus
from time import monotonic

import httpx2

from beamtouch_daemon.faults import BACKOFF_MIN_S, Backoff, Fault, Tally
from beamtouch_daemon.pipeline import Taken
from beamtouch_service.samples import MAX_SAMPLES, Batch

MAX_BATCH = min(1000, MAX_SAMPLES)
MAX_BATCH_VALUES = 16_000
"""Samples in one request, and values in them, at most: under half of the MiB that the service takes."""
REQUEST_TIMEOUT_S = 2.0
MAX_DETAIL = 200
"""Characters of the service's explanation in the log."""

_NEVER_ACCEPTED = {HTTPStatus.BAD_REQUEST, HTTPStatus.REQUEST_ENTITY_TOO_LARGE, HTTPStatus.UNPROCESSABLE_ENTITY}
_log = logging.getLogger(__name__)


class Outbox:
    """The samples that wait for delivery, bounded: when it is full the oldest are dropped and counted."""

    def __init__(self, most: int, name: str) -> None:
        self.dropped = 0
        """Samples that will never be delivered."""
        self._most = most
        self._waiting: deque[Taken] = deque()
        self._changed = asyncio.Event()
        self._closed = asyncio.Event()
        self._tally = Tally(_log, f"{name}: %d samples dropped")

    def __len__(self) -> int:
        return len(self._waiting)

    @property
    def is_closed(self) -> bool:
        """Whether no more samples will come."""
        return self._closed.is_set()

    def put(self, samples: Sequence[Taken]) -> None:
        """Add samples, newest last."""
        self._waiting.extend(samples)
        self._trim()
        self._changed.set()

    def take(self, most: int) -> list[Taken]:
        """Remove and return up to `most` samples, oldest first."""
        return [self._waiting.popleft() for _ in range(min(most, len(self._waiting)))]

    def put_back(self, samples: Sequence[Taken]) -> None:
        """Return samples taken before, because they could not be delivered; they may be dropped for newer ones."""
        self._waiting.extendleft(reversed(samples))
        self._trim()

    def drop(self, number: int) -> None:
        """Count samples as dropped that were taken and cannot be delivered."""
        self.dropped += number
        self._tally.add(number)

    def close(self) -> None:
        """Say that no more samples will come, and that nobody should wait any longer than needed."""
        self._closed.set()
        self._changed.set()

    async def filled(self) -> bool:
        """Wait until there is a sample; False if there is none and never will be."""
        while not self._waiting and not self._closed.is_set():
            self._changed.clear()
            await self._changed.wait()
        return bool(self._waiting)

    async def pause(self, delay_s: float) -> None:
        """Wait for `delay_s`, or until closed."""
        with contextlib.suppress(TimeoutError):
            async with asyncio.timeout(delay_s):
                await self._closed.wait()

    def _trim(self) -> None:
        excess = len(self._waiting) - self._most
        if excess > 0:
            self.take(excess)
            self.drop(excess)


@dataclass(frozen=True)
class Sender:
    """What a batch says of where it comes from."""

    surface: str
    channels: list[str]
    boot_id: str


class Publisher:
    """Sends one surface's samples in order; an answer that never came is asked for again, which changes nothing."""

    def __init__(self, client: httpx2.AsyncClient, sender: Sender, outbox: Outbox, batch_s: float) -> None:
        self.published = 0
        """Samples that the service has acknowledged."""
        self._client = client
        self._sender = sender
        self._outbox = outbox
        self._batch_s = batch_s
        self._most = min(MAX_BATCH, MAX_BATCH_VALUES // len(sender.channels))
        self._fault = Fault(_log, f"{sender.surface}: publishing")

    async def run(self) -> None:
        """Deliver until the outbox is closed and empty."""
        backoff = Backoff()
        next_s = monotonic()
        while await self._outbox.filled():
            if len(self._outbox) < self._most:
                await self._outbox.pause(next_s - monotonic())
            next_s = monotonic() + self._batch_s
            if await self._deliver(self._outbox.take(self._most)):
                backoff.reset()
            elif self._outbox.is_closed:
                await asyncio.sleep(BACKOFF_MIN_S)
            else:
                await self._outbox.pause(backoff.next())

    async def _deliver(self, samples: Sequence[Taken]) -> bool:
        """Send one batch; return False if it has to be sent again."""
        try:
            response = await self._post(samples)
        except httpx2.TransportError as error:
            self._outbox.put_back(samples)
            self._fault.failed(f"no answer from {self._client.base_url} ({type(error).__name__}); trying again")
            return False
        except BaseException:  # cancelled: what may not have arrived stays counted
            self._outbox.put_back(samples)
            raise
        if response.is_success:
            self.published += len(samples)
            self._fault.recovered()
            return True
        if response.status_code in _NEVER_ACCEPTED:
            self._outbox.drop(len(samples))
            self._fault.failed(f"the service will never take a batch ({_explanation(response)}); it is dropped")
            return True
        self._outbox.put_back(samples)
        self._fault.failed(f"the service takes no samples ({_explanation(response)}); trying again")
        return False

    async def _post(self, samples: Sequence[Taken]) -> httpx2.Response:
        batch = Batch(
            boot_id=self._sender.boot_id,
            channels=self._sender.channels,
            newest_age_ms=max(0.0, (monotonic() - samples[-1].monotonic_s) * 1e3),
            samples=[taken.sample for taken in samples],
        )
        return await self._client.post(
            f"/surfaces/{self._sender.surface}/samples",
            content=batch.model_dump_json(),
            headers={"content-type": "application/json"},
        )


def make_client(url: str, token: str) -> httpx2.AsyncClient:
    """Return a client of the service at `url` that shows `token`; proxies in the environment are not for this."""
    return httpx2.AsyncClient(
        base_url=url,
        headers={"authorization": f"Bearer {token}"},
        timeout=REQUEST_TIMEOUT_S,
        trust_env=False,
    )


def _explanation(response: httpx2.Response) -> str:
    """Return the status and what the service says of it, in one line."""
    if response.status_code == HTTPStatus.UNAUTHORIZED:
        return "status 401: wrong token; correct publish.token_file and restart"
    try:
        detail = str(response.json()["detail"])[:MAX_DETAIL]
    except (ValueError, KeyError, TypeError):
        return f"status {response.status_code}"
    return f"status {response.status_code}: {detail}"
