"""One request of a boot: what all batches state, and what the answer means for the boot and its pace."""

import logging
from time import monotonic

from beamtouch_daemon.delivery.boots import Boot, SurfaceLogs
from beamtouch_daemon.delivery.client import ServiceAnswer, ServiceClient, UnreachableError, Verdict
from beamtouch_service.samples import Batch

_logger = logging.getLogger(__name__)


async def send(client: ServiceClient, logs: SurfaceLogs, boot: Boot, batch: Batch) -> ServiceAnswer | None:
    """Send a batch of a boot with what its log still holds; return the answer, None if there was none."""
    batch = batch.model_copy(update={"oldest": boot.log.oldest, "earlier": logs.others(boot)})
    begin_s = monotonic()
    try:
        answer = await client.post_samples(logs.name, batch, boot.pace.timeout_s)
    except UnreachableError as error:
        boot.pace.unanswered(len(batch.samples), monotonic() - begin_s)
        advice = f"{error.advice}; " if error.advice else ""
        logs.fault.failed(f"no answer from {client.url} ({error}); {advice}trying again")
        _debug_outcome(logs, batch, f"no answer: {error}")
        return None
    _debug_outcome(logs, batch, answer)
    if answer.receipt is not None:
        now_s = monotonic()
        boot.pace.answered(len(batch.samples), now_s - begin_s, now_s, is_backlog=batch.backlog)
        if batch.backlog and boot.refusal:
            _logger.info("%s: the service takes the samples of boot %s again", logs.name, batch.boot_id)
        if not batch.backlog or logs.present is None:
            logs.fault.over()
        boot.acknowledge(answer.receipt)
        if boot is logs.present:
            _note_pace(logs, boot)
    elif answer.verdict is Verdict.REFUSED:
        note_refusal(logs, boot, batch, answer.explanation)
    elif answer.verdict is Verdict.LATER:
        boot.pace.unanswered(len(batch.samples), monotonic() - begin_s)
        logs.fault.failed(f"the service takes no samples ({answer.explanation}); trying again")
    return answer


def _debug_outcome(logs: SurfaceLogs, batch: Batch, outcome: ServiceAnswer | str) -> None:
    """Write to the debug log what a request brought, and what became of it."""
    if _logger.isEnabledFor(logging.DEBUG):
        numbers = [sample.sequence for sample in batch.samples]
        samples = f"samples {numbers[0]} to {numbers[-1]}" if numbers else "no samples"
        if isinstance(outcome, ServiceAnswer):
            receipt = outcome.receipt
            outcome = f"{outcome.verdict.value}: {outcome.explanation}" if receipt is None else f"taken: {receipt}"
        kind = "backlog" if batch.backlog else "live"
        _logger.debug("%s: %s batch of boot %s, %s: %s", logs.name, kind, batch.boot_id, samples, outcome)


def _note_pace(logs: SurfaceLogs, boot: Boot) -> None:
    """Say that the line is thin while the record lacks more than a request brings."""
    if boot.pace.is_thin and len(boot.missing) > boot.pace.most:
        words = f"the line to the service is thin: requests hold at most {boot.pace.most} samples, the newest go first"
        logs.slow.failed(f"{words}, and {len(boot.missing)} wait for the record", reason="thin")
    elif not boot.is_behind:
        logs.slow.over("the record has caught up on a thin line")


def note_refusal(logs: SurfaceLogs, boot: Boot, batch: Batch, reason: str) -> None:
    """Note that the service takes no samples of a boot for this reason."""
    if not batch.backlog:
        logs.fault.failed(f"the service takes no samples ({reason}); trying again")
    elif reason != boot.refusal:
        words = "%s: the samples of boot %s wait, the service does not take them (%s)"
        _logger.warning(words, logs.name, batch.boot_id, reason)
    boot.refusal = reason
