"""Writes that wait for a database: in order, bounded, and small while a contact goes on."""

from beamtouch_service.events.backlog import Backlog
from beamtouch_service.events.findings import Finish
from beamtouch_service.events.segments import MAX_POINTS, End, Point, Segment

BOOT = "boot-0001"


def segment(first: int, last: int, surface: str = "press-7") -> Segment:
    path: list[Point] = [(number * 5000, 100.0, 5.0) for number in range(first, last + 1)]
    return Segment(surface, "tiny@000000", BOOT, first, last, first * 5000, last * 5000, samples=len(path), path=path)


def test_writes_come_in_order_and_a_contact_that_goes_on_is_one_of_them() -> None:
    backlog = Backlog()
    for step in range(60):
        assert backlog.add("press-7", [segment(step * 200, step * 200 + 199)])
        assert backlog.add("press-8", [segment(step * 200, step * 200 + 199, "press-8")])
    assert backlog.add("press-7", [Finish(BOOT, 11_999, End.LIFT, 60_000_000)])
    assert len(backlog) == 3

    first, second, third = (backlog.take_first() for _ in range(3))
    assert first
    assert second
    assert third
    assert [one.surface for one in (first, second, third)] == ["press-7", "press-8", "press-7"]
    (whole,) = first.commands
    assert isinstance(whole, Segment)
    assert (whole.first_sequence, whole.last_sequence, whole.samples) == (0, 11_999, 12_000)
    assert len(whole.path) <= MAX_POINTS
    assert third.commands == [Finish(BOOT, 11_999, End.LIFT, 60_000_000)]
    assert backlog.take_first() is None


def test_a_full_backlog_takes_nothing_until_there_is_room() -> None:
    backlog = Backlog(max_weight=250)
    assert backlog.add("press-7", [segment(0, 99)])
    assert backlog.add("press-7", [segment(200, 299)])
    assert not backlog.add("press-7", [segment(400, 499)])
    assert not backlog.add("press-7", [segment(300, 399)])
    assert backlog.take_first()
    assert backlog.add("press-7", [segment(400, 499)])
    assert len(backlog) == 2
