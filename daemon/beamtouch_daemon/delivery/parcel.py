"""Samples on their way to the service: one batch, or parts of it if the service finds it too large."""

import logging
from collections.abc import Callable, Sequence
from typing import Generic, TypeVar

from beamtouch_daemon.delivery.client import TOO_LARGE, Answer, ServiceClient, Verdict
from beamtouch_daemon.delivery.unreachable import UnreachableError
from beamtouch_daemon.faults import Fault
from beamtouch_service.samples import Batch

_log = logging.getLogger(__name__)
_T = TypeVar("_T")


class Parcel(Generic[_T]):
    """Samples, oldest first, and their fate.

    Parameters
    ----------
    items
        The samples, or objects that contain them.
    batch_of
        Returns a batch of some of them, with its present age.
    """

    def __init__(self, items: Sequence[_T], batch_of: Callable[[Sequence[_T]], Batch]) -> None:
        self.taken = 0
        """Samples that the service has acknowledged."""
        self.refused: list[tuple[Batch, str]] = []
        """Batches that the service will never take, with its reason."""
        self._batch_of = batch_of
        self._parts = [list(items)]

    @property
    def left(self) -> list[_T]:
        """Samples that were neither taken nor refused for good."""
        return [item for part in reversed(self._parts) for item in part]

    async def send(self, client: ServiceClient, surface: str, fault: Fault) -> Verdict:
        """Send the remaining samples until none are left, or until the service takes no more.

        Returns
        -------
        Verdict
            The verdict on the last part: TAKEN or NEVER if nothing is left, otherwise the reason.
        """
        verdict = Verdict.TAKEN
        while self._parts:
            part = self._parts[-1]
            batch = self._batch_of(part)
            try:
                answer = await client.post_samples(surface, batch.model_dump_json(exclude_defaults=True).encode())
            except UnreachableError as error:
                advice = f"{error.advice}; " if error.advice else ""
                fault.failed(f"no answer from {client.url} ({error}); {advice}trying again")
                return Verdict.LATER
            verdict = _verdict(answer, len(part))
            if verdict is Verdict.TOO_LARGE:
                half = len(part) // 2
                self._parts[-1:] = [part[half:], part[:half]]
            elif verdict is Verdict.TAKEN:
                self._parts.pop()
                self.taken += len(part)
                fault.recovered()
            elif verdict is Verdict.NEVER:
                self._parts.pop()
                self.refused.append((batch, answer.explanation))
            else:
                fault.failed(f"the service takes no samples ({answer.explanation}); trying again")
                return verdict
        return verdict


def _verdict(answer: Answer, samples: int) -> Verdict:
    """Return the verdict. A single sample cannot be split; only the service, not a proxy, may call it too large."""
    if answer.verdict is not Verdict.TOO_LARGE or samples > 1:
        return answer.verdict
    return Verdict.NEVER if answer.type == TOO_LARGE else Verdict.LATER
