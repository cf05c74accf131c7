"""The broker's answers to the requests of one connection, each by the number of its request."""

import asyncio

from paho.mqtt.reasoncodes import ReasonCode

from beamtouch_service.outputs.mqtt.failures import LOST, NO_ANSWER, BrokerError

BrokerAnswer = asyncio.Future[ReasonCode | None]
"""The broker's answer to a request; None if the connection is lost before, or where an answer has no reason."""


class BrokerAnswers:
    """Requests that wait for their answers."""

    def __init__(self) -> None:
        self._loop = asyncio.get_running_loop()
        self._waiting: dict[int, BrokerAnswer] = {}
        self._loss = ""
        """Why the connection is lost; empty while it is not."""

    def expect(self, number: int) -> BrokerAnswer:
        """Return the answer to come of a request; call this before the event loop may read it."""
        answer: BrokerAnswer = self._loop.create_future()
        answer.add_done_callback(lambda _: self._waiting.pop(number))
        self._waiting[number] = answer
        return answer

    def give(self, number: int, reason: ReasonCode | None) -> None:
        """Give the answer to a request; nothing waits for one that came too late."""
        answer = self._waiting.get(number)
        if answer is not None and not answer.done():
            answer.set_result(reason)

    def lose(self, reason: str) -> None:
        """Answer all requests with the reason for which the connection is lost. The first reason counts."""
        self._loss = self._loss or reason
        for number in list(self._waiting):
            self.give(number, None)

    async def wait(self, answer: BrokerAnswer, timeout_s: float) -> ReasonCode:
        """Return an answer; raises BrokerError if the connection is lost, or after `timeout_s` [s]."""
        try:
            async with asyncio.timeout(timeout_s):
                reason = await answer
        except TimeoutError:
            raise BrokerError(NO_ANSWER) from None
        if reason is None:
            raise BrokerError(self._loss or LOST)
        return reason
