"""Long work in steps: however much begins at once, the event loop turns in between."""

import asyncio
from collections.abc import Iterator
from itertools import count

import pytest

from beamtouch_service import steps
from beamtouch_service.steps import Stepper

pytestmark = pytest.mark.anyio
SLICE = 4


@pytest.fixture(autouse=True)
def _each_look_at_the_clock_takes_a_second(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(steps, "perf_counter", count().__next__)
    monkeypatch.setattr(steps, "SLICE_S", SLICE)


class Work:
    """Counts the steps that all works together take between two turns of the loop."""

    def __init__(self) -> None:
        self.since_turn = self.most = 0

    def steps(self, number: int) -> Iterator[None]:
        for _ in range(number):
            self.since_turn += 1
            self.most = max(self.most, self.since_turn)
            yield

    async def watch(self) -> None:
        while True:
            self.since_turn = 0
            await asyncio.sleep(0)


@pytest.mark.parametrize("length", [1, SLICE - 1, 5 * SLICE])
async def test_the_loop_turns_between_works_that_begin_at_once(length: int) -> None:
    work, stepper = Work(), Stepper()
    watch = asyncio.create_task(work.watch())
    await asyncio.gather(*[stepper.finish(work.steps(length)) for _ in range(40)])
    watch.cancel()
    assert work.most <= 3 * SLICE


async def test_short_work_does_not_wait_for_the_end_of_long_work() -> None:
    work, stepper = Work(), Stepper()
    long = [asyncio.create_task(stepper.finish(work.steps(1_000))) for _ in range(3)]
    await asyncio.sleep(0)
    short = [asyncio.create_task(stepper.finish(work.steps(1))) for _ in range(10)]
    await asyncio.gather(*short)
    assert not any(one.done() for one in long)
    await asyncio.gather(*long)


async def test_work_that_fails_keeps_no_other_from_its_turn() -> None:
    def fail() -> Iterator[None]:
        yield from Work().steps(SLICE - 1)
        raise ValueError("a step")

    stepper = Stepper()
    for _ in range(3):
        with pytest.raises(ValueError, match="a step"):
            await stepper.finish(fail())
    await stepper.finish(Work().steps(1))
