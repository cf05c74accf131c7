"""Parts of a program that are begun again after an error, and named until they have recovered."""

import asyncio
import logging
from collections.abc import Awaitable, Callable
from types import SimpleNamespace

import pytest

from beamtouch_common import parts
from beamtouch_common.parts import Parts

NAME = "beamtouch.test"
Logged = list[tuple[str, str]]


class Timer:
    """A call that is due after a time, unless it is cancelled."""

    def __init__(self, after_s: float, call: Callable[..., None], *given: object) -> None:
        self.after_s, self.is_cancelled = after_s, False
        self._call, self._given = call, given

    def cancel(self) -> None:
        self.is_cancelled = True

    def fire(self) -> None:
        self._call(*self._given)


class World:
    """Parts on a clock of their own: pauses take no time, and timers fire when a test says so."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.parts = Parts(logging.getLogger(NAME))
        self.pauses_s, self.named, self.timers = list[float](), list[str](), list[Timer]()
        loop = SimpleNamespace(call_later=self._later)
        monkeypatch.setattr(parts, "asyncio", SimpleNamespace(sleep=self._sleep, get_running_loop=lambda: loop))

    async def _sleep(self, seconds: float) -> None:
        assert self.timers[-1].is_cancelled
        self.pauses_s.append(seconds)
        self.named.append(self.parts.failing["mqtt"])
        await asyncio.sleep(0)

    def _later(self, after_s: float, call: Callable[..., None], *given: object) -> Timer:
        self.timers.append(Timer(after_s, call, *given))
        return self.timers[-1]

    def keep(self, work: Callable[[int], object], expected: type[Exception] | tuple[()] = ()) -> None:
        """Keep a part that does `work` of the number of its attempt, from 1."""

        async def attempt() -> None:
            work(len(self.timers))

        task: Awaitable[None] = self.parts.keep("mqtt", attempt, expected)
        asyncio.run(asyncio.wait_for(task, 60))


@pytest.fixture
def world(monkeypatch: pytest.MonkeyPatch) -> World:
    return World(monkeypatch)


@pytest.fixture
def logged(caplog: pytest.LogCaptureFixture) -> Callable[[], Logged]:
    caplog.set_level(logging.INFO, NAME)
    return lambda: [(record.levelname, record.getMessage()) for record in caplog.records]


def failing(*errors: Exception) -> Callable[[int], None]:
    """Return work that fails with each of these errors, and then succeeds."""

    def work(attempt: int) -> None:
        if attempt <= len(errors):
            raise errors[attempt - 1]

    return work


def test_a_part_is_begun_again_after_pauses_that_double_up_to_half_a_minute(
    world: World, logged: Callable[[], Logged]
) -> None:
    world.keep(failing(*[ValueError("a")] * 7))
    assert world.pauses_s == [1, 2, 4, 8, 16, 30, 30]
    assert world.parts.failures == {"mqtt": 7}
    assert set(world.named) == {"unexpected error (ValueError('a')); restarting"}
    assert world.parts.failing == {"mqtt": ""}
    # The same error is logged once a minute.
    assert logged() == [("CRITICAL", "mqtt: unexpected error; restarting in 1 s"), ("INFO", "mqtt: runs again")]
    assert all(timer.is_cancelled for timer in world.timers)


def test_each_other_error_is_logged_with_its_traceback_and_the_first_of_a_group_is_named(
    world: World, logged: Callable[[], Logged], caplog: pytest.LogCaptureFixture
) -> None:
    group = ExceptionGroup("all", [ExceptionGroup("some", [KeyError("first"), OSError()]), TypeError()])
    world.keep(failing(ValueError("a"), ValueError("b"), group))
    assert world.named == [
        f"unexpected error ({error}); restarting"
        for error in ("ValueError('a')", "ValueError('b')", "KeyError('first')")
    ]
    assert [words for _, words in logged()] == [
        *(f"mqtt: unexpected error; restarting in {pause_s} s" for pause_s in (1, 2, 4)), "mqtt: runs again",
    ]  # fmt: skip
    assert [record.exc_info is not None for record in caplog.records] == [True, True, True, False]


def test_an_expected_error_ends_a_part_and_one_that_never_failed_says_nothing(
    world: World, logged: Callable[[], Logged]
) -> None:
    with pytest.raises(KeyError):
        world.keep(failing(KeyError()), KeyError)
    assert (world.parts.failing, world.parts.failures, world.pauses_s) == ({}, {"mqtt": 0}, [])
    world.keep(lambda _: None)
    assert (world.parts.failing, logged()) == ({}, [])


def test_a_part_that_runs_for_ten_seconds_or_as_long_as_the_last_pause_has_recovered(
    world: World, logged: Callable[[], Logged]
) -> None:
    named = list[str]()

    def work(attempt: int) -> None:
        if attempt == 7:
            world.timers[-1].fire()
            named.append(world.parts.failing["mqtt"])
        if attempt <= 8:
            raise ValueError("a")

    world.keep(work)
    assert [timer.after_s for timer in world.timers] == [10, 10, 10, 10, 10, 16, 30, 10, 10]
    assert named == [""]
    assert world.pauses_s == [1, 2, 4, 8, 16, 30, 1, 2]
    assert [words for _, words in logged()].count("mqtt: runs again") == 2


def attempted(kept: Parts, whose: str = "", error: Exception | None = None) -> None:
    with kept.attempt("page", whose):
        if error is not None:
            raise error


def test_what_is_called_again_and_again_is_named_until_it_succeeds_for_all_for_whom_it_failed(
    logged: Callable[[], Logged], caplog: pytest.LogCaptureFixture
) -> None:
    kept = Parts(logging.getLogger(NAME))
    attempted(kept, "press-7")
    assert (kept.failing, kept.failures) == ({}, {})
    attempted(kept, "press-7", ValueError("a"))
    attempted(kept, "press-8", OSError("b"))
    assert kept.failing == {"page": "unexpected error (ValueError('a'))"}
    attempted(kept, "press-7")
    assert kept.failing == {"page": "unexpected error (OSError('b'))"}
    attempted(kept, "press-9")
    attempted(kept, "press-8", OSError("b"))
    assert kept.failures == {"page": 3}
    attempted(kept, "press-8")
    assert kept.failing == {"page": ""}
    assert logged() == [
        ("CRITICAL", "page of press-7: unexpected error; all else goes on"),
        ("CRITICAL", "page of press-8: unexpected error; all else goes on"),
        ("INFO", "page of press-7: runs again"),
        ("INFO", "page of press-8: runs again"),
    ]
    assert [record.exc_info is not None for record in caplog.records] == [True, True, False, False]


def test_what_works_for_nobody_in_particular_is_named_alone(logged: Callable[[], Logged]) -> None:
    kept = Parts(logging.getLogger(NAME))
    attempted(kept, error=ValueError("a"))
    attempted(kept, error=ValueError("c"))
    attempted(kept)
    attempted(kept)
    assert (kept.failing, kept.failures) == ({"page": ""}, {"page": 2})
    error = ("CRITICAL", "page: unexpected error; all else goes on")
    assert logged() == [error, error, ("INFO", "page: runs again")]
