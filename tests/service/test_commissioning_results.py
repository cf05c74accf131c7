"""The results of a commissioning: the words for errors of position, and the record of them."""

from collections.abc import Callable
from pathlib import Path

import pytest

from beamtouch_models.runtime import State
from beamtouch_service.commissioning import results
from beamtouch_service.commissioning.report import PlaceResult, Report, SensorResult
from beamtouch_service.commissioning.verdict import advise_places, judge_place
from beamtouch_service.record import Action, Entry
from beamtouch_service.record.reading.readers import Reader
from beamtouch_service.record.writing.retention import Retention
from beamtouch_service.record.writing.transactions import Transactions
from beamtouch_service.sections import EventsSection


def place(at_mm: float, position_mm: float | None, half_mm: float = 1.0) -> PlaceResult:
    if position_mm is None:
        return judge_place(PlaceResult(at_mm={"position": at_mm}, state=State.UNEXPLAINED))
    stated_mm = {"position": (position_mm, position_mm - half_mm, position_mm + half_mm)}
    return judge_place(PlaceResult(at_mm={"position": at_mm}, state=State.CONTACT, stated_mm=stated_mm))


@pytest.mark.promise(
    "docs/how-to/commission-on-the-page.md",
    "If all three positions are wrong by the same millimetres, look from where you measured.",
)
@pytest.mark.parametrize(
    ("stated", "is_wired", "last"),
    [
        ((103.0, 198.0, 305.9), True, "The largest error of a position is 5.9 mm."),
        (
            (112.0, 211.0, 310.0),
            True,
            "All positions are about 11 mm too large: the marks may count from another point.",
        ),
        (
            (88.0, 189.0, 290.0),
            True,
            "All positions are about 11 mm too small: the marks may count from another point.",
        ),
        ((106.2, 198.0, 300.0), True, "This is more than aim explains. Repeat the commissioning; if it stays so,"),
        ((101.0, None, 300.0), True, "The largest error of a position is 1.0 mm."),
        ((None, None, None), True, "At 300 mm: no position: unexplained."),
        ((112.0, 211.0, 310.0), False, "Positions mean little until every sensor moves as it should."),
    ],
)
def test_the_words_for_errors_of_position(stated: tuple[float | None, ...], is_wired: bool, last: str) -> None:
    places = [place(at_mm, position_mm) for at_mm, position_mm in zip((100.0, 200.0, 300.0), stated, strict=True)]
    sentences = advise_places(places, is_wired=is_wired)
    assert sentences[-1].startswith(last)
    assert len([one for one in sentences if "no position" in one]) == stated.count(None)


@pytest.fixture(params=["memory", "file", "PostgreSQL"])
def open_transactions(request: pytest.FixtureRequest, tmp_path: Path) -> Callable[[], Transactions]:
    events = EventsSection()
    if request.param == "file":
        events = EventsSection(file=tmp_path / "events.db")
    elif request.param == "PostgreSQL":
        events = EventsSection(url=request.getfixturevalue("events_url"))
    return lambda: Transactions(events)


@pytest.mark.promise(
    "docs/how-to/commission-on-the-page.md",
    "The service keeps the last 20 results of each surface, whatever their age",
)
def test_each_result_is_on_record_once_and_the_newest_of_each_surface_are_kept(
    open_transactions: Callable[[], Transactions],
) -> None:
    transactions = open_transactions()
    at_rest = {
        "beam": "b",
        "begun_at": "x",
        "sensors": [SensorResult(name="s1", at_mm={"position": 1.5})],
        "places": [],
    }
    reports = [
        Report.model_validate({"surface": name, "model": f"m@{number}", **at_rest})
        for name in ("left", "right")
        for number in range(results.MAX_KEPT + 2)
    ]
    entries = [Entry(0, Action.COMMISSIONING, "{}", "left", f"run-{index}") for index in range(len(reports))]
    runs = [(f"run-{index}", report, entries[index]) for index, report in enumerate(reports)]
    numbers = [results.add(transactions, *run) for run in runs]
    assert results.add(transactions, *runs[-1]) == numbers[-1]
    Retention(EventsSection()).tidy(transactions.database, 1e12, 1e12)
    if transactions.is_lasting:
        transactions.close()
        transactions = open_transactions()
    for name in ("left", "right"):
        kept = results.read(Reader(transactions.database), name)
        assert [one.model for one in kept] == [f"m@{number}" for number in range(results.MAX_KEPT + 1, 1, -1)]
        assert {(one.surface, one.sensors[0].at_mm["position"]) for one in kept} == {(name, 1.5)}
    transactions.close()
