"""Requests of which some fail now and then: they are repeated, counted and described."""

import math
from collections import Counter, deque
from collections.abc import Awaitable, Callable
from enum import StrEnum

from beamtouch_common.uptime import uptime_s
from beamtouch_daemon.sources.registers import Block, RegisterAnswer

TRIES = 3
"""A request that is refused is sent at most this often."""

NEWEST_REQUESTS = 100
"""The newest requests, which show whether some fail."""
FEWEST_FAILED = 2
"""Fewer failed requests than this among them may be chance."""
FEWEST_REQUESTS = 10
"""Number of requests that are needed to say so."""


class Failure(StrEnum):
    """Reason why a request has no answer that can be used. The reason `exception-6` is a refusal with exception 6."""

    SILENT = "silent"
    """No answer."""
    LATE = "late"
    """Its answer came after the timeout."""
    DAMAGED = "damaged"
    """Bytes came, but no intact answer."""
    FOREIGN = "foreign"
    """An answer to another request, or of another unit."""
    CLOSED = "closed"
    """The device has closed the connection."""
    UNREACHABLE = "unreachable"
    """There was no connection."""


EXCEPTIONS = {
    1: "it does not know this function",
    2: "it has no such register: asked for {registers}; addresses count from 0, so a manual's 30001 or 40001 is 0",
    3: "it refuses that many registers: asked for {registers}",
    4: "device failure",
    5: "it needs more time",
    6: "device busy",
    8: "memory error",
    10: "gateway path unavailable",
    11: "gateway: the device does not answer",
}
_BUSY = "stop other masters that ask it, and look in its manual how often it may be asked"
_REMEDIES = {
    "exception-4": "look in its manual what that means",
    "exception-5": _BUSY,
    "exception-6": _BUSY,
    "exception-10": "look in the manual of the gateway how many clients and requests it can take",
    "exception-11": "check supply, wiring and timeout of the unit's line behind the gateway",
    Failure.SILENT: "check supply and wiring, or raise timeout_ms",
    Failure.LATE: "raise timeout_ms",
    Failure.DAMAGED: "check wiring, termination and baud",
    Failure.FOREIGN: "stop other masters that ask it",
    Failure.CLOSED: "look in its manual how many connections it allows, and for how long",
    Failure.UNREACHABLE: "check its network",
}
_WORDS = {
    Failure.SILENT: "no answer",
    Failure.LATE: "late answer",
    Failure.DAMAGED: "damaged answer",
    Failure.FOREIGN: "answer to another request",
    Failure.CLOSED: "connection closed",
    Failure.UNREACHABLE: "no connection",
}


class Requests:
    """Outcomes of the requests to one unit."""

    def __init__(self) -> None:
        self.asked = 0
        self.failures = 0
        """Failed requests, for any reason."""
        self.failed: Counter[str] = Counter()
        """The same by reason."""
        self._newest: deque[str] = deque(maxlen=NEWEST_REQUESTS)
        """Reason of each, empty if it was answered."""
        self._newest_failures = 0

    def answered(self) -> None:
        """Count a request that was answered."""
        self._add("")

    def fail(self, reason: str) -> None:
        """Count a request that failed."""
        self.failures += 1
        self.failed[reason] += 1
        self._add(reason)

    def forget(self) -> None:
        """Let the requests so far say nothing of the next ones, because the unit was away."""
        self._newest.clear()
        self._newest_failures = 0

    @property
    def failed_share(self) -> float:
        """Share of the newest requests that have failed; 0 if that may be chance."""
        is_chance = self._newest_failures < FEWEST_FAILED or len(self._newest) < FEWEST_REQUESTS
        return 0.0 if is_chance else self._newest_failures / len(self._newest)

    def describe(self, name: str) -> str:
        """Return how many of the newest requests to unit `name` have failed and why; empty if none has."""
        if not self._newest_failures:
            return ""
        reasons = Counter(filter(None, self._newest)).most_common()
        words = ", ".join(f"{_reason_words(reason)} ({number})" for reason, number in reasons)
        remedy = _REMEDIES.get(reasons[0][0], "look in its manual what that means")
        return f"{self._newest_failures} of {len(self._newest)} requests to {name} fail: {words}; {remedy}"

    def _add(self, reason: str) -> None:
        self.asked += 1
        if len(self._newest) == NEWEST_REQUESTS and self._newest[0]:
            self._newest_failures -= 1
        self._newest.append(reason)
        self._newest_failures += bool(reason)


async def insist(
    ask: Callable[[Block], Awaitable[RegisterAnswer]], block: Block, refused_within_s: float = math.inf
) -> RegisterAnswer:
    """Ask for a block, again while the refusal may pass, and return the last answer.

    It is as old as the first request, because it may be the late answer to that one.

    Parameters
    ----------
    ask : Sends a request once.
    block : What to ask for.
    refused_within_s : A refusal that took longer is not followed by another request.
    """
    first = answer = await ask(block)
    refusals: tuple[int, ...] = ()
    while answer.may_pass and len(refusals) < TRIES - 1 and uptime_s() - first.asked_s <= refused_within_s:
        refusals = (*refusals, answer.exception)
        answer = await ask(block)
    return answer._replace(asked_s=first.asked_s, refusals=refusals)


def reason_of(exception: int) -> str:
    """Return the reason for which a request fails that is refused with an exception."""
    return f"exception-{exception}"


def refusal_text(exception: int, block: Block) -> str:
    """Return what a refusal means, and what to do."""
    last = block.first + block.count - 1
    registers = f"{block.first}" if block.count == 1 else f"{block.first} to {last}"
    meaning = EXCEPTIONS.get(exception, "an error").format(registers=registers)
    remedy = _REMEDIES.get(reason_of(exception))
    return f"exception {exception}: {meaning}{f'; {remedy}' if remedy else ''}"


def exception_words(exception: int) -> str:
    """Return a refusal in a few words."""
    return f"exception {exception}, {EXCEPTIONS.get(exception, 'an error').partition(':')[0]}"


def _reason_words(reason: str) -> str:
    return _WORDS[Failure(reason)] if reason in _WORDS else exception_words(int(reason.removeprefix("exception-")))
