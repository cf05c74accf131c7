"""Sends batches of a surface, and notes in its logs and in the messages what comes of them."""

import logging

from beamtouch_daemon.delivery.client import Answer, ServiceClient, UnreachableError, Verdict
from beamtouch_daemon.delivery.log import Log
from beamtouch_daemon.delivery.log_store import SurfaceLogs
from beamtouch_service.samples import Batch

_log = logging.getLogger(__name__)


class Sending:
    """Sends the batches of one surface."""

    def __init__(self, client: ServiceClient, surface: str, logs: SurfaceLogs) -> None:
        self._client = client
        self._surface = surface
        self._logs = logs

    async def send(self, log: Log, batch: Batch) -> Answer | None:
        """Send a batch of a log with what the log still holds; return the answer, None if there was none."""
        batch = batch.model_copy(update={"oldest": log.oldest, "earlier": self._logs.others(log)})
        try:
            answer = await self._client.post_samples(self._surface, batch)
        except UnreachableError as error:
            advice = f"{error.advice}; " if error.advice else ""
            self._logs.fault.failed(f"no answer from {self._client.url} ({error}); {advice}trying again")
            return None
        if answer.receipt is not None:
            if batch.backlog and log.refusal:
                _log.info("%s: the service takes the samples of boot %s again", self._surface, batch.boot_id)
            if not batch.backlog or self._logs.present is None:
                self._logs.fault.over()
            log.told(answer.receipt)
        elif answer.verdict is Verdict.REFUSED:
            self.refuse(log, batch, answer.explanation)
        elif answer.verdict is Verdict.LATER:
            self._logs.fault.failed(f"the service takes no samples ({answer.explanation}); trying again")
        return answer

    def refuse(self, log: Log, batch: Batch, reason: str) -> None:
        """Note that the service takes no samples of a log for this reason."""
        if not batch.backlog:
            self._logs.fault.failed(f"the service takes no samples ({reason}); trying again")
        elif reason != log.refusal:
            words = "%s: the samples of boot %s wait, the service does not take them (%s)"
            _log.warning(words, self._surface, batch.boot_id, reason)
        log.refusal = reason
