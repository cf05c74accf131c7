"""A model that takes the place of another one of its beam: what was known of the beam stays known."""

from pathlib import Path

import pytest

from beamtouch_common.zones import Zone
from beamtouch_models.runtime import ModelFile
from beamtouch_service.sections import EventsSection, SurfaceSection
from beamtouch_service.surfaces.surface import Surface
from service.bench import Bench, Row, parsed, surface_of
from service.event_story import BETWEEN, ODD, RESTING, TOUCHING, Story
from support.surfaces.small_model import model_of

WEAK: Row = [0.2, 0.0, 0.0]
"""It begins a contact on a beam that has lain still, and on no other one."""
NOW_S = 100.0


class Line:
    """Samples of one sender, one batch each, and the state after each."""

    def __init__(self, section: SurfaceSection | None = None) -> None:
        self.surface, self.sequence = surface_of(section=section), 0

    def send(self, *rows: Row) -> list[tuple[str | None, list[str]]]:
        """Send samples; return state and notes after each."""
        said = []
        for row in rows:
            self.sequence += 1
            now_s = NOW_S + self.sequence / 200
            self.surface.receive(parsed(row, sequence=self.sequence), now_s)
            view = self.surface.view(now_s)
            said.append((view.state and view.state.value, view.notes))
        return said

    @property
    def answered_by(self) -> str | None:
        return self.surface.view(NOW_S + self.sequence / 200).answered_by


def other(name: str = "other") -> ModelFile:
    return model_of(name)


@pytest.mark.promise("docs/how-to/upgrade.md", "A new model of the same beam goes on from the state that is there")
def test_a_contact_that_no_model_would_see_begin_stays() -> None:
    line = Line()
    line.send(TOUCHING, BETWEEN)
    line.surface.adopt(other())
    assert line.answered_by == model_of().identity  # the answer stays, until a sample has come
    assert line.send(BETWEEN) == [("contact", ["unsteady"])]
    assert line.answered_by == other().identity
    assert line.send(RESTING) == [("clear", [])]


def test_a_beam_that_has_lain_still_is_touched_as_lightly_as_before() -> None:
    line = Line()
    line.send(*[RESTING] * 6)
    line.surface.adopt(other())
    assert line.send(WEAK) == [("contact", [])]
    # Without rest, it is not: see `WEAK`.
    fresh = Line()
    assert fresh.send(WEAK) == [("clear", ["unsteady"])]


def test_an_unexplained_stretch_stays_for_as_long_as_under_one_model() -> None:
    line = Line()
    line.send(TOUCHING, ODD, ODD, ODD)
    line.surface.adopt(other())
    states = [state for state, _ in line.send(TOUCHING, TOUCHING, TOUCHING)]
    assert states == ["unexplained", "unexplained", "contact"]


def test_a_contact_stays_in_its_zone_and_enters_it_once() -> None:
    line = Line(SurfaceSection(zones={"gate": Zone(from_mm=120, to_mm=200)}))
    line.send(TOUCHING)
    line.surface.adopt(other())
    line.send(TOUCHING)
    view = line.surface.view(NOW_S)
    assert (view.zones["gate"], view.totals.zone_entries) == ("inside", {"gate": 1})


def test_a_model_that_comes_during_a_batch_goes_on_from_its_end() -> None:
    line = Line()
    received = line.surface.begin(parsed(RESTING, TOUCHING, BETWEEN, sequence=1), NOW_S)
    next(received.steps)
    line.surface.adopt(other("first"))
    line.surface.adopt(other())
    assert len(list(received.steps)) == 2
    line.sequence = 3
    assert line.send(BETWEEN) == [("contact", ["unsteady"])]


@pytest.mark.promise("docs/how-to/rollout.md", "The event that is open ends as `unseen`, and a new one begins")
def test_the_record_has_the_contact_that_goes_on(tmp_path: Path) -> None:
    """No model would see it begin now: the record goes on from the state as the answer does."""
    bench = Bench(surface_of(), events=EventsSection(file=tmp_path / "events.db"))
    story = Story(bench, [RESTING] * 8 + [TOUCHING] * 4 + [BETWEEN] * 12 + [RESTING] * 6)
    story.deliver(0, 16)
    bench.adopt(other())
    story.deliver(16, 24)
    assert bench.contact()["state"] == "contact"
    story.deliver(24, 30)
    assert [(one["begin"], one["end"]) for one in story.events] == [("touch", "unseen"), ("unseen", "lift")]


@pytest.mark.parametrize("why", ["samples are missing", "another sender", "other channels", "no model before"])
def test_nothing_is_known_where_the_state_may_be_another_one(why: str) -> None:
    line, channels, boot_id = Line(), None, "boot-0001"
    if why == "no model before":
        line.surface = Surface("press-7", None)
    line.send(TOUCHING)
    if why == "samples are missing":
        line.sequence += 1
    if why == "another sender":
        boot_id = "boot-0002"
    if why == "other channels":
        channels = ["t1", "t2", "t3"]
    line.surface.adopt(model_of("other", prefix="t" if channels else "s"))
    now_s = NOW_S + 1
    line.surface.receive(parsed(BETWEEN, sequence=line.sequence + 1, channels=channels, boot_id=boot_id), now_s)
    assert line.surface.view(now_s).status == "clear"


def test_the_answer_is_never_older_than_its_limit() -> None:
    bench = Bench(surface_of(section=SurfaceSection(stale_ms=500)))
    bench.send(TOUCHING)
    bench.adopt(other())
    bench.now_s += 0.5
    assert bench.contact()["age_ms"] == 500
    bench.now_s += 0.001
    assert bench.problem() == "stale"
