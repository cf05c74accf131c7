"""The dialogue in which known loads are recorded, in the process of the test, and how long each takes."""

import asyncio
from pathlib import Path

import pytest

from beamtouch_daemon.commands import record
from beamtouch_daemon.commands.record import Dialogue, LoadRefusedError, record_load
from beamtouch_daemon.config.settings import Surface
from beamtouch_daemon.measuring.known_loads import Load, LoadFile, parse_load
from beamtouch_daemon.processing.pipeline import TimedSample

from .acquiring import Beam, Nothing
from .publishing import taken
from .surfaces import RATE_HZ, mean_of, surface_of

SURFACE = surface_of(noise_mm=0.003, filter=mean_of(1))
PLATE = surface_of(2, loads={"x_mm": [0.0, 400.0], "y_mm": [0.0, 300.0], "max_force_n": 20.0})


class Talk:
    """A dialogue with these answers; loads of more than 100 N are refused unless they are accepted."""

    def __init__(
        self, folder: Path, monkeypatch: pytest.MonkeyPatch, *answers: str, surface: Surface = SURFACE
    ) -> None:
        left = [f"{answer}\n" for answer in answers]
        monkeypatch.setattr(record, "typed_line", lambda: left.pop(0) if left else "")
        monkeypatch.setattr(record, "is_terminal", lambda: False)
        self.recorded = list[str]()
        self.file = LoadFile(folder / "loads.csv", surface, append=False)
        self.dialogue = Dialogue(self.file, surface, self._record)

    def _record(self, load: Load) -> list[TimedSample]:
        if not load.is_accepted and load.force_n > 100:
            raise LoadRefusedError("it moved")
        self.recorded.append(f"{load}{' accepted' if load.is_accepted else ''}")
        return taken(1, 5)


def loads(*words: str) -> list[Load]:
    return [parse_load(each.split(), SURFACE, is_accepted=False) for each in words]


def test_loads_are_typed_until_an_empty_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    typed = ("150 10", "abc", "70 500", "70 500 accept", "undo", "90 5", "", "10 3")
    talk = Talk(tmp_path, monkeypatch, *typed)
    talk.dialogue.record_stated()
    assert talk.recorded == ["10 N at 150 mm", "500 N at 70 mm accepted", "5 N at 90 mm"]
    assert (talk.file.loads, [str(load) for load in talk.dialogue.refused]) == (2, [])
    question = "put it on, then enter position in mm and force in N (empty line: done; undo): "
    asked, said = list[str](), list[str]()
    for line in capsys.readouterr().err.splitlines():
        (asked if line.endswith(": ") else said).append(line)
    assert asked == [f"load {number}: {question}" for number in (1, 2, 2, 2, 3, 2, 3)]
    assert [line for line in said if "abc" not in line and "give two numbers" not in line] == [
        "load 1: 10 N at 150 mm, 5 samples",
        "500 N at 70 mm not recorded: it moved; put it on again, or answer accept to record it without checks",
        "load 2: 500 N at 70 mm, 5 samples",
        "load 2, 500 N at 70 mm, is removed",
        "load 2: 5 N at 90 mm, 5 samples",
    ]


def test_on_a_plate_a_load_has_three_numbers(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    talk = Talk(tmp_path, monkeypatch, "150 80 10", "20 30 7 accept", "undo now", "", surface=PLATE)
    talk.dialogue.record_stated()
    assert talk.recorded == ["10 N at 150, 80 mm", "7 N at 20, 30 mm accepted"]
    assert capsys.readouterr().err.count("put it on, then enter x and y in mm and force in N (empty line: done") == 4


def test_given_loads_are_recorded_in_their_order_after_enter(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    answers = ("undo", "", "undo", "", "now", "", "accept")
    talk = Talk(tmp_path, monkeypatch, *answers)
    talk.dialogue.record_given(loads("150 10", "70 500"))
    assert talk.recorded == ["10 N at 150 mm", "10 N at 150 mm", "500 N at 70 mm accepted"]
    assert (talk.file.loads, talk.dialogue.refused) == (2, [])
    said = capsys.readouterr().err.splitlines()
    assert said[0] == "load 1: put 10 N at 150 mm on, then press Enter (undo): "
    assert said[1] == "there is no load to remove"
    assert "load 1, 10 N at 150 mm, is removed" in said
    assert "'now': press Enter once the load is on, or type undo or accept" in said
    assert [line for line in said if "put 500 N" in line] == [
        "load 2: put 500 N at 70 mm on, then press Enter (undo): "
    ] * 4


def test_a_dialogue_whose_answers_end_stops_and_what_was_refused_or_removed_is_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    talk = Talk(tmp_path, monkeypatch, "", "undo", "", "", "")
    talk.dialogue.record_given(loads("150 10", "70 500", "90 5"))
    assert talk.recorded == ["10 N at 150 mm", "10 N at 150 mm"]
    assert [str(load) for load in talk.dialogue.refused] == ["500 N at 70 mm"]


def loaded(at: int, further: float = 0.0) -> tuple[float, float]:
    """Return counts of a load with noise."""
    wave = 20.0 if at % 2 else -20.0
    return 21_000.0 + wave + further, 20_000.0 - wave


def recorded(
    monkeypatch: pytest.MonkeyPatch, beam: Beam, seconds: float, *, is_accepted: bool = False, rate_hz: float = RATE_HZ
) -> list[TimedSample]:
    monkeypatch.setattr(record, "source_of", lambda _: beam)
    surface = surface_of(noise_mm=0.003, filter=mean_of(1), rate_hz=rate_hz)
    return asyncio.run(record_load(surface, {}, parse_load(["150", "10"], SURFACE, is_accepted=is_accepted), seconds))


@pytest.mark.parametrize(
    ("rate_hz", "seconds", "is_accepted", "samples", "given"),
    [
        (200.0, 0.3, False, 60, 100 + 60),  # half a second at rest, and what was asked for
        (200.0, 0.3, True, 60, 60),
        (200.0, 0.001, False, 2, 100 + 2),
        (20.0, 1.5, False, 30, 20 + 30),  # 20 readings at rest
    ],
)
def test_a_load_is_recorded_for_its_time_once_it_rests(
    monkeypatch: pytest.MonkeyPatch, rate_hz: float, seconds: float, is_accepted: bool, samples: int, given: int
) -> None:
    beam = Beam(loaded)
    found = recorded(monkeypatch, beam, seconds, is_accepted=is_accepted, rate_hz=rate_hz)
    assert (len(found), beam.given) == (samples, given)
    assert [one.sample.sequence for one in found] == list(range(given - samples + 1, given + 1))


def test_a_beam_that_settles_late_is_waited_for(monkeypatch: pytest.MonkeyPatch) -> None:
    beam = Beam(lambda at: loaded(at, max(0, 150 - at) * 20))
    recorded(monkeypatch, beam, 0.3)
    assert 150 + 60 < beam.given <= 150 + 100 + 60


def test_a_load_that_does_not_settle_in_time_is_refused_with_the_reason(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(record, "GIVE_UP_S", 0.5)
    with pytest.raises(LoadRefusedError, match=r"^not settled within 0.5 s: s1[: ].*[^;]$"):
        recorded(monkeypatch, Beam(lambda at: loaded(at, 40 * (at % 400))), 0.3, rate_hz=20.0)


def test_without_readings_a_load_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(record, "GIVE_UP_S", 0.02)
    monkeypatch.setattr(record, "source_of", lambda _: Nothing())
    with pytest.raises(LoadRefusedError, match=r"^not settled within 0.02 s: no readings arrived$"):
        asyncio.run(record_load(SURFACE, {}, loads("150 10")[0], 0.3))
