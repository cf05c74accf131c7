"""What a Modbus RTU unit is asked before its answer counts as new, request by request, on a clock of the test."""

import asyncio
from collections.abc import Callable, Sequence

import pytest

from beamtouch_daemon.sources import rtu_unit
from beamtouch_daemon.sources.reading import NoAnswerError
from beamtouch_daemon.sources.registers import Block, RegisterAnswer
from beamtouch_daemon.sources.rtu_unit import Unit, forgotten_s, probes_for

BLOCK = Block(30, 2)
REFUSED, BUSY = RegisterAnswer(exception=2), RegisterAnswer(exception=6)
Answer = RegisterAnswer | None


class Line:
    """A line whose unit gives an answer to each request, or none."""

    timeout_s = 0.001

    def __init__(self, unit: Callable[[Block], Answer] = lambda block: RegisterAnswer((7,) * block.count)) -> None:
        self.asked: list[Block] = []
        self.is_noisy = list[bool]()
        """Whether answers that nobody asked for come, in turn; then none do."""
        self.listened = 0
        self.unit = unit

    async def ask(self, block: Block) -> RegisterAnswer:
        self.asked.append(block)
        if (answer := self.unit(block)) is None:
            raise NoAnswerError("silent")
        return answer

    async def is_quiet(self) -> bool:
        self.listened += 1
        return not (self.is_noisy and self.is_noisy.pop(0))


class Bench:
    """A unit with its line, at a time that the test sets."""

    def __init__(self, blocks: Sequence[Block] = (BLOCK,)) -> None:
        self.now_s = 1000.0
        self.unit = Unit(3, lambda: self.now_s)
        self.unit.will_be_asked(blocks)
        self.line = Line()

    def read(self, block: Block = BLOCK) -> list[Block]:
        """Read a block; return what was asked."""
        self.line.asked.clear()
        asyncio.run(self.unit.read(self.line, block))
        return list(self.line.asked)

    def fail(self, match: str) -> list[Block]:
        """Read a block, which fails; return what was asked."""
        self.line.asked.clear()
        with pytest.raises(NoAnswerError, match=match):
            asyncio.run(self.unit.read(self.line, BLOCK))
        return list(self.line.asked)


def test_the_first_value_follows_two_probes_that_were_found_and_a_silence() -> None:
    bench = Bench()
    first, *probes, last = bench.read()
    assert (first, last, bench.line.listened) == (BLOCK, BLOCK, 1)
    assert len(probes) == 4
    assert probes[:2] == probes[2:]
    assert set(probes) <= set(probes_for([BLOCK]))
    assert bench.read() == [BLOCK]


def test_after_a_missing_answer_one_probe_precedes_the_value_and_the_next_time_the_other() -> None:
    bench = Bench()
    _, first, second, *_ = bench.read()
    probes = []
    for _ in range(3):
        bench.line.unit = lambda block: None if block == BLOCK else RegisterAnswer()
        bench.fail("silent")
        bench.line.unit = lambda block: RegisterAnswer((7,) * block.count)
        probe, value = bench.read()
        assert value == BLOCK
        probes.append(probe)
    assert probes == [first, second, first]


def test_a_refusal_of_a_value_proves_nothing() -> None:
    bench = Bench()
    bench.read()
    bench.line.unit = lambda block: REFUSED if block == BLOCK else RegisterAnswer()
    assert bench.read() == [BLOCK]
    assert len(bench.read()) == 2  # a probe, as the refusal may be an earlier one
    bench.line.unit = lambda _block: RegisterAnswer((7, 8), refusals=(6,))
    assert len(bench.read()) == 2
    assert len(bench.read()) == 2


def test_an_answer_that_nobody_asked_for_makes_a_probe_precede_each_value_for_10_s() -> None:
    bench = Bench()
    bench.read()
    bench.unit.suspect()
    for after_s, number in ((0.0, 2), (9.9, 2), (10.0, 1)):
        bench.now_s = 1000.0 + after_s
        assert len(bench.read()) == number


def test_answers_in_the_silence_of_a_start_repeat_it_up_to_three_times() -> None:
    bench = Bench()
    bench.line.is_noisy = [True, False]
    assert (len(bench.read()), bench.line.listened) == (8, 2)
    assert len(bench.read()) == 1
    bench.unit.restart()
    bench.line.is_noisy = [True] * 5
    assert (len(bench.read()), bench.line.listened) == (7, 5)
    assert len(bench.read()) == 2  # another master may be asking it


@pytest.mark.parametrize(("after_s", "asked"), [(59.9, 2), (60.0, 6)])
def test_probes_are_found_again_after_a_minute_in_which_nothing_was_proven(after_s: float, asked: int) -> None:
    bench = Bench()
    bench.read()
    bench.line.unit = lambda _block: None
    bench.fail("silent")
    bench.line.unit = lambda block: RegisterAnswer((7,) * block.count)
    bench.now_s += after_s
    assert len(bench.read()) == asked


def test_a_value_that_comes_keeps_its_probes_known() -> None:
    bench = Bench()
    bench.read()
    bench.now_s += 50.0
    bench.read()
    bench.line.unit = lambda _block: None
    bench.fail("silent")
    bench.now_s += 50.0
    bench.line.unit = lambda block: RegisterAnswer((7,) * block.count)
    assert len(bench.read()) == 2


def test_more_blocks_make_a_unit_prove_itself_again_and_the_same_ones_do_not() -> None:
    bench = Bench()
    bench.read()
    bench.unit.will_be_asked([BLOCK])
    assert bench.read() == [BLOCK]
    other = Block(80, 5, 3)
    bench.unit.will_be_asked([other])
    asked = bench.read(other)
    assert (asked[0], asked[-1], len(asked)) == (other, other, 6)


def test_a_probe_that_is_refused_for_now_says_why() -> None:
    bench = Bench()
    bench.read()
    bench.unit.suspect()
    bench.line.unit = lambda block: RegisterAnswer((7, 8)) if block == BLOCK else BUSY
    assert len(bench.fail("unit 3 answers with exception 6: device busy; stop other masters")) == 1


def test_a_probe_that_is_answered_otherwise_than_before_is_found_again() -> None:
    bench = Bench()
    bench.read()
    bench.unit.suspect()
    bench.line.unit = lambda block: RegisterAnswer((7, 8)) if block == BLOCK else REFUSED
    assert len(bench.fail("unit 3 answers otherwise than before")) == 1
    bench.line.unit = lambda block: RegisterAnswer((7,) * block.count)
    assert len(bench.read()) == 6


def test_two_refusals_of_one_function_look_alike_and_are_no_two_probes() -> None:
    bench = Bench()
    bench.line.unit = lambda block: RegisterAnswer((7, 8)) if block == BLOCK else REFUSED
    _, *learned, value = bench.read()
    assert value == BLOCK
    used = learned[-2:]
    assert used[0].function != used[1].function


@pytest.fixture
def impatient(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let answers be forgotten after a hundredth of a second."""
    monkeypatch.setattr(rtu_unit, "FORGOTTEN_S", 0.01)


@pytest.mark.usefixtures("impatient")
def test_a_unit_that_answers_no_probes_is_left_alone_after_a_missing_answer() -> None:
    bench = Bench()

    def unit(block: Block) -> Answer:
        return RegisterAnswer((7, 8)) if block == BLOCK else None

    bench.line.unit = unit
    assert not bench.unit.is_unprovable
    asked = bench.read()
    assert (asked[0], asked[-1], bench.line.listened) == (BLOCK, BLOCK, 0)
    assert set(asked[1:-1]) == set(probes_for([BLOCK]))
    assert bench.unit.is_unprovable
    assert bench.read() == [BLOCK]
    bench.unit.suspect()
    assert bench.read() == [BLOCK]  # a probe is of no use
    bench.line.unit = lambda _block: None
    bench.fail("silent")
    bench.line.unit = unit
    bench.now_s += 0.009
    assert bench.fail("unit 3 is not polled for 0.01 s, so that no late answer counts as a new one") == []
    bench.now_s += 0.002
    assert bench.read() == [BLOCK]


@pytest.mark.usefixtures("impatient")
@pytest.mark.parametrize(("refusal", "is_settled"), [(BUSY, True), (REFUSED, False)])
def test_a_unit_without_probes_that_has_not_read_a_request_owes_no_answer(
    refusal: RegisterAnswer, is_settled: bool
) -> None:
    bench = Bench()
    bench.line.unit = lambda block: RegisterAnswer((7, 8)) if block == BLOCK else None
    bench.read()
    bench.line.unit = lambda _block: refusal
    bench.read()
    bench.line.unit = lambda block: RegisterAnswer((7, 8)) if block == BLOCK else None
    if is_settled:
        assert bench.read() == [BLOCK]
    else:
        assert bench.fail("is not polled") == []


def test_an_answer_is_forgotten_after_5_s_or_ten_timeouts() -> None:
    assert [forgotten_s(timeout_s) for timeout_s in (0.1, 0.5, 0.75)] == [5.0, 5.0, 7.5]


@pytest.mark.parametrize(
    ("blocks", "probes"),
    [
        (
            [Block(30, 2)],
            {Block(30, count) for count in (1, 3, 4)} | {Block(30, 1, function) for function in (1, 2, 3)},
        ),
        (
            [Block(30, 5), Block(90, 1, 3), Block(7, 3)],
            {Block(30, count) for count in (1, 2, 6, 7)} | {Block(30, 1, function) for function in (1, 2)},
        ),
        (
            [Block(65_535, 1)],
            {Block(65_534, 2), Block(65_533, 3)} | {Block(65_535, 1, function) for function in (1, 2, 3)},
        ),
        (
            [Block(0, 125)],
            {Block(0, count) for count in (1, 2, 123, 124)} | {Block(0, 1, function) for function in (1, 2, 3)},
        ),
    ],
)
def test_probes_have_another_function_or_a_length_close_by(blocks: list[Block], probes: set[Block]) -> None:
    assert set(probes_for(blocks)) == probes
