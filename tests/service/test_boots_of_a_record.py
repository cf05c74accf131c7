"""What a record holds of each boot in memory: how far it is, what a commit takes, and what comes back from one."""

from math import inf, nan

import pytest

from beamtouch_common.zones import Zone
from beamtouch_models.runtime import ModelFile
from beamtouch_service.record.events.boot_record import MAX_CAPTURED, MAX_WAITING, BootRecord, _short
from beamtouch_service.record.events.changes import Change, Cursor
from beamtouch_service.record.events.event import End, Numbered, OpenEvent
from beamtouch_service.record.events.health import HealthHistory, StoredHealth
from beamtouch_service.record.events.surface_record import LATE_S, SurfaceRecord
from beamtouch_service.samples import MAX_EARLIER, Batch
from beamtouch_service.sections import SurfaceSection
from beamtouch_service.surfaces.estimate import Estimator
from service.bench import Row, parsed, surface_with
from service.event_story import BETWEEN, ODD, RESTING, TOUCHING
from support.surfaces.small_model import model_of

CONTACT: list[Row] = [RESTING, TOUCHING, TOUCHING, RESTING]


def begun(durable: int = 0, model: ModelFile | None = None, section: SurfaceSection | None = None) -> BootRecord:
    return BootRecord("press-7", section or SurfaceSection(), "boot-0001", model or model_of(), durable)


def add(boot: BootRecord, *rows: Row) -> BootRecord:
    """Add samples, each the one that is expected."""
    batch = parsed(*rows, sequence=boot.expected, begin_us=1_000_000 + 5000 * boot.expected)
    for estimate in Estimator(boot.model, "press-7").estimate(batch, batch.samples):
        boot.add(estimate)
    return boot


def commit(boot: BootRecord) -> dict[OpenEvent, int]:
    """Make a boot durable; return the numbers of its new events, from 11 on."""
    change = boot.change()
    numbers = {event: 11 + place for place, (event, number, _) in enumerate(change.events) if number is None}
    boot.note_durable(change, numbers)
    return numbers


def test_a_boot_is_dirty_while_a_sample_or_an_event_is_not_durable() -> None:
    boot = begun(durable=5)
    assert (boot.expected, boot.is_dirty) == (6, False)
    add(boot, RESTING)
    assert (boot.expected, boot.is_dirty, boot.durable) == (7, True, 5)
    commit(boot)
    assert (boot.durable, boot.is_dirty) == (6, False)
    # What was not seen ends an event, though no sample came.
    add(boot, TOUCHING)
    commit(boot)
    assert (boot.is_dirty, boot.has_ended) == (False, False)
    boot.lose()
    assert (boot.is_dirty, boot.has_ended, boot.expected) == (True, True, 8)


def test_an_event_adds_up_how_long_its_contact_was_inside_each_zone() -> None:
    zones = {"gate": Zone(from_mm=120, to_mm=200), "far": Zone(from_mm=250, to_mm=300)}
    boot = add(begun(section=SurfaceSection(zones=zones)), RESTING, *[TOUCHING] * 4)  # at 150 mm, each 5 ms
    assert boot.event is not None
    assert boot.event.event.zones == {"gate": 15_000}
    add(boot, TOUCHING)
    assert boot.event.event.zones == {"gate": 20_000}


def test_what_is_lost_leaves_nothing_known_of_the_state() -> None:
    boot = add(begun(), RESTING, TOUCHING)
    add(boot, BETWEEN)  # it ends no contact
    assert boot.event is not None
    boot.lose()
    add(boot, BETWEEN)  # nor does it begin one
    assert boot.event is None


def test_a_boot_has_room_for_20_000_samples_that_are_not_durable() -> None:
    assert MAX_WAITING == 20_000
    for durable in (0, 50_000):
        boot = begun(durable)
        for waiting, has_room in ((MAX_WAITING - 1, True), (MAX_WAITING, False)):
            boot.expected = durable + 1 + waiting
            assert boot.has_room is has_room


def test_a_change_follows_the_version_before_and_its_events_keep_their_numbers() -> None:
    boot = add(begun(), RESTING, TOUCHING)
    first = boot.change()
    assert (first.version, first.durable, first.model) == (0, 2, boot.model.identity)
    (event,) = [event for event, _, _ in first.events]
    assert (event.number, first.open_event) == (None, event)
    boot.note_durable(first, {event: 7})
    add(boot, TOUCHING)
    second = boot.change()
    assert (second.version, second.durable, [number for _, number, _ in second.events]) == (1, 3, [7])
    boot.note_durable(second, {})
    assert event.number == 7


def test_what_could_not_be_made_durable_comes_before_what_changed_since_and_once() -> None:
    boot = add(begun(), *CONTACT, RESTING, TOUCHING)
    change = boot.change()
    first, second = (event for event, _, _ in change.events)
    add(boot, RESTING, RESTING, TOUCHING)
    boot.take_back(change)
    again = [event for event, _, _ in boot.change().events]
    assert (again[:2], len(again)) == ([first, second], 3)
    assert [event.event.end for event in again] == [End.LIFT, End.LIFT, End.OPEN]


def test_best_samples_are_those_of_ended_events_under_the_model_in_use_once() -> None:
    boot = add(begun(), *CONTACT, TOUCHING)
    (best,) = boot.take_best()
    assert best.deflection_mm == TOUCHING
    assert boot.take_best() == []
    boot.adopt(model_of("other"))  # ends the second one
    assert boot.take_best() == []
    add(boot, RESTING, *[ODD] * 6, RESTING, RESTING, RESTING, *CONTACT)
    assert [one.is_contact for one in boot.take_best()] == [False, True]


def test_an_event_without_a_best_sample_gives_none() -> None:
    boot = begun()
    batch = parsed(RESTING, TOUCHING, RESTING)
    batch.samples[1].quality[2] = batch.samples[1].quality[0].__class__("stuck")
    for estimate in Estimator(boot.model, "press-7").estimate(batch, batch.samples):
        boot.add(estimate)
    assert len(boot.change().events) == 1
    assert boot.take_best() == []


@pytest.mark.parametrize(("number", "lost"), [(2, 0), (4, 0), (5, 1), (9, 5)])
def test_samples_before_the_oldest_one_are_lost_and_end_the_event(number: int, lost: int) -> None:
    boot = add(begun(), RESTING, TOUCHING, TOUCHING)
    assert boot.expected == 4
    assert boot.pass_to(number) == lost
    assert (boot.expected, boot.event is None) == (max(4, number), bool(lost))


def cursor_of(boot: BootRecord, model: str = "") -> Cursor:
    """Return what is on record of a boot after a commit."""
    change = boot.change()
    event = None if boot.event is None else Numbered(7, boot.event.event)
    return Cursor("boot-0001", change.durable, 3, model or change.model, change.memory, event)


def test_a_boot_goes_on_from_its_cursor() -> None:
    before = add(begun(), RESTING, TOUCHING)
    boot = begun(durable=2)
    boot.go_on(cursor_of(before))
    assert boot.event is not None
    assert (boot.event.number, boot.change().version) == (7, 3)
    add(boot, TOUCHING, RESTING)
    ((_, number, row),) = boot.change().events
    assert (number, row["end"], row["begin"], row["samples"]) == (7, "lift", "touch", 2)
    assert len(boot.take_best()) == 1


@pytest.mark.parametrize("damage", ["a@1", "z@1", "memories", "rest", "load"])
def test_a_cursor_that_cannot_be_gone_on_from_ends_its_event_and_says_so(
    caplog: pytest.LogCaptureFixture, damage: str
) -> None:
    caplog.set_level("INFO", "beamtouch_service")
    cursor = cursor_of(add(begun(), RESTING, TOUCHING), model=damage if "@" in damage else "")
    cursor.memory.pop(damage, None)
    boot = begun(durable=2)
    boot.go_on(cursor)
    ((_, number, row),) = boot.change().events
    assert (boot.event, number, row["end"]) == (None, 7, "unseen")
    (line,) = caplog.messages
    reason = f"another model decided it ({damage})" if "@" in damage else f"'{damage}'"
    assert line == f"surface press-7: an event of boot boot-0001 cannot go on: {reason}"


def test_the_sample_before_an_event_says_how_it_begins() -> None:
    rows: list[Row] = [TOUCHING, RESTING, TOUCHING, RESTING, *[ODD] * 5, *[TOUCHING] * 4, RESTING]
    boot = add(begun(), *rows)
    boot.lose()
    add(boot, TOUCHING, RESTING, *[ODD] * 5)
    boot.lose()
    add(boot, *[ODD] * 5)
    found = [(row["kind"], row["begin"], row["end"]) for _, _, row in boot.change().events]
    assert found == [
        ("contact", "unseen", "lift"),
        ("contact", "touch", "lift"),
        ("unexplained", "clear", "contact"),
        ("contact", "unexplained", "lift"),
        ("contact", "unseen", "lift"),
        ("unexplained", "clear", "unseen"),
        ("unexplained", "unseen", "open"),
    ]


MISSING: Row = [None, None, None]


@pytest.mark.parametrize(
    ("rows", "event"),
    [
        ([RESTING, TOUCHING, MISSING, TOUCHING, RESTING], ("touch", "lift", True, 2)),
        ([RESTING, MISSING, TOUCHING, RESTING], ("unseen", "lift", False, 1)),
    ],
)
def test_a_sample_that_cannot_be_decided_ends_no_event_and_no_touch_is_seen_after_it(
    rows: list[Row], event: tuple[str, str, bool, int]
) -> None:
    boot = begun()
    for row in rows:
        batch = parsed(row, sequence=boot.expected, quality=["missing"] * 3 if row is MISSING else None)
        for estimate in Estimator(boot.model, "press-7").estimate(batch, batch.samples):
            boot.add(estimate)
    ((_, _, found),) = boot.change().events
    assert tuple(found[name] for name in ("begin", "end", "degraded", "samples")) == event


def test_an_event_keeps_its_first_five_unexplained_samples_and_no_others() -> None:
    boot = add(begun(), RESTING, TOUCHING, TOUCHING, *[ODD] * 9)
    ((_, _, row),) = boot.change().events
    # The state follows from the third odd sample.
    assert [sample["sequence"] for sample in row["capture"]] == [6, 7, 8, 9, 10]


def test_what_a_stretch_keeps_has_six_digits_and_no_number_that_json_lacks() -> None:
    assert MAX_CAPTURED == 5
    assert [_short(value) for value in (1.23456789, 123456.789, inf, -inf, nan)] == [
        1.23457,
        123457.0,
        None,
        None,
        None,
    ]


class Held:
    """The record of a surface in memory, whose sender keeps its samples."""

    def __init__(self) -> None:
        self.surface, self.model = surface_with(model_of()), model_of()
        self.record = SurfaceRecord(self.surface, self.model, HealthHistory("press-7", self.model, StoredHealth()))

    def hear(self, *rows: Row, boot_id: str = "boot-0001", oldest: int | None = 1, sequence: int = 1) -> Batch:
        """Take samples of a boot, which is new or not."""
        batch = parsed(*rows, boot_id=boot_id, sequence=sequence).model_copy(update={"oldest": oldest})
        self.record.put(batch, [])
        self.record.hear(batch)
        for estimate in Estimator(self.model, "press-7").estimate(batch, batch.samples):
            self.record.add(batch, estimate)
        return batch

    def commit(self, now_s: float) -> Change | None:
        change = self.record.change(now_s)
        if change:
            numbers = {event: 1 for boot in change.boots for event, number, _ in boot.events if number is None}
            self.record.note_durable(change, numbers)
        return change

    def boot(self, boot_id: str = "boot-0001") -> BootRecord:
        found = self.record.boot(boot_id)
        assert found is not None
        return found


def test_what_nobody_waits_for_is_due_three_seconds_after_the_last_change() -> None:
    held = Held()
    held.hear(RESTING)
    assert held.record.is_due(0.0)  # the first one
    held.commit(100.0)
    held.hear(RESTING, sequence=2)
    assert [held.record.is_due(now_s) for now_s in (100.0, 102.999, 103.0)] == [False, False, True]
    assert LATE_S == 3.0


def test_what_somebody_waits_for_is_due_at_once() -> None:
    held = Held()
    held.hear(*CONTACT[:2])
    held.commit(100.0)
    held.hear(TOUCHING, sequence=3)
    assert not held.record.is_due(100.0)
    held.hear(RESTING, sequence=4)
    assert held.record.is_due(100.0)  # an event has ended
    held.commit(100.0)
    held.record.hear(parsed().model_copy(update={"samples": [], "oldest": 1}))
    assert held.record.is_due(100.0)  # it was asked for
    held.commit(100.0)
    held.hear(RESTING, sequence=5, oldest=None)
    assert held.record.is_due(100.0)  # the sender keeps nothing


def test_samples_that_wait_and_samples_that_are_lost_are_counted_over_all_boots() -> None:
    held = Held()
    held.hear(RESTING, TOUCHING)
    held.hear(RESTING, boot_id="boot-0002")
    assert (held.record.waiting, held.record.lost) == (3, 0)
    held.commit(0.0)
    assert held.record.waiting == 0
    held.hear(RESTING, sequence=7, oldest=6)
    assert (held.record.lost, held.record.waiting) == (3, 3)  # those too
    held.hear(RESTING, boot_id="boot-0002", sequence=4, oldest=None)
    assert held.record.lost == 5


def test_a_boot_begins_with_the_oldest_sample_of_its_sender_or_with_the_first_of_the_batch() -> None:
    held = Held()
    held.hear(RESTING, oldest=3, sequence=9)
    assert (held.boot().expected, held.boot().durable) == (3, 2)
    held.hear(RESTING, RESTING, boot_id="boot-0002", oldest=None, sequence=9)
    assert (held.boot("boot-0002").expected, held.boot("boot-0002").durable) == (11, 8)
    assert held.record.lost == 0
    asking = parsed(boot_id="boot-0003").model_copy(update={"samples": [], "oldest": None})
    held.record.put(asking, [])
    assert held.record.boot("boot-0003") is None


def test_a_sample_that_is_not_expected_or_for_which_there_is_no_room_is_left_out() -> None:
    held = Held()
    held.hear(RESTING)
    held.hear(RESTING, sequence=3)
    assert held.boot().expected == 2
    held.boot().expected = MAX_WAITING + 1
    held.hear(RESTING, sequence=MAX_WAITING + 1)
    held.hear(RESTING, sequence=MAX_WAITING + 9, oldest=MAX_WAITING + 9)
    assert (held.boot().expected, held.record.lost) == (MAX_WAITING + 1, 0)


def test_of_idle_boots_the_newest_64_stay_in_memory() -> None:
    held = Held()
    held.hear(RESTING, TOUCHING, boot_id="boot-open")
    for number in range(MAX_EARLIER + 2):
        held.hear(RESTING, boot_id=f"boot-{number:04}")
    change = held.commit(0.0)
    assert change is not None
    assert len(change.boots) == MAX_EARLIER + 3
    held.commit(1.0)
    kept = held.record.boot_ids
    assert (len(kept), kept[:2]) == (MAX_EARLIER, ["boot-open", "boot-0003"])
    held.hear(RESTING, boot_id="boot-dirty")
    held.commit(2.0)
    assert "boot-dirty" in held.record.boot_ids


def test_boots_that_are_idle_and_few_stay_in_memory() -> None:
    held = Held()
    for boot_id in ("boot-0001", "boot-0002"):
        held.hear(RESTING, boot_id=boot_id)
        held.commit(0.0)
        held.commit(1.0)
    assert held.record.boot_ids == ["boot-0001", "boot-0002"]


def test_what_is_on_record_of_a_boot_is_taken_once() -> None:
    held, before = Held(), add(begun(), RESTING, TOUCHING)
    cursor = cursor_of(before)
    held.record.put(parsed(boot_id="boot-0002"), [cursor])
    assert held.record.boot_ids == ["boot-0001", "boot-0002"]
    first = held.boot()
    assert (first.durable, first.event is None) == (2, False)
    held.record.put(parsed(), [cursor])
    assert held.boot() is first


@pytest.mark.parametrize(
    ("newest", "earlier", "stays"),
    [
        ("boot-0002", [], False),
        ("boot-0002", ["boot-0001"], True),
        ("boot-0001", [], True),
        ("boot-0003", [], True),
        ("", [], True),
    ],
)
def test_a_boot_that_the_sender_of_the_newest_sample_does_not_name_is_over(
    newest: str, earlier: list[str], *, stays: bool
) -> None:
    held = Held()
    held.hear(RESTING, TOUCHING)
    if newest:
        held.surface.receive(parsed(RESTING, boot_id=newest), 1000.0)
    batch = parsed(RESTING, boot_id="boot-0002").model_copy(update={"oldest": 1, "earlier": earlier})
    held.record.put(batch, [])
    held.record.hear(batch)
    assert (held.boot().event is not None) is stays
    assert held.boot().expected == 3


def test_another_model_ends_the_events_of_all_boots_and_begins_a_health() -> None:
    held = Held()
    held.hear(RESTING, TOUCHING)
    held.record.adopt(held.model)
    assert held.boot().event is not None
    held.record.adopt(model_of("other"))
    assert held.boot().event is None
    assert held.surface.health is not None
    assert held.surface.health.model == model_of("other").identity


@pytest.mark.parametrize("adopts", [False, True])
def test_the_health_of_a_surface_is_stated_once_it_is_durable_unless_the_model_is_another(*, adopts: bool) -> None:
    held = Held()
    held.hear(*CONTACT)
    change = held.record.change(0.0)
    assert change is not None
    assert [best.deflection_mm for best in change.best] == [TOUCHING]
    change.health.add(change.best)
    if adopts:
        held.record.adopt(model_of("other"))
    held.record.note_durable(change, {})
    assert change.health.next is None
    assert change.health.stored.version == 1
    assert held.surface.health is not None
    assert (held.surface.health is change.health.state) is not adopts
    # The next one follows that version.
    assert held.record.change(1.0) is None or adopts


def test_without_a_change_there_is_nothing_to_commit_and_what_comes_back_is_urgent() -> None:
    held = Held()
    assert held.commit(0.0) is None
    held.hear(*CONTACT[:2])
    change = held.record.change(1.0)
    assert change is not None
    assert (change.surface, change.has_ended, change.best) == ("press-7", False, [])
    assert not held.record.is_due(1.0)
    held.record.take_back(change)
    assert held.record.is_due(1.0)
    again = held.record.change(2.0)
    assert again is not None
    assert [event for event, _, _ in again.boots[0].events] == [event for event, _, _ in change.boots[0].events]
