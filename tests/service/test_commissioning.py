"""A commissioning from its first press to the record: routes and refusals."""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import httpx2
import numpy as np
import pytest
from anyio.to_thread import run_sync as run_in_thread

from beamtouch_models.runtime import InfluenceCurve
from beamtouch_service.sections import EventsSection
from service.bench import TOKEN, Bench, Row, kind, surface_of, surface_with
from service.event_story import RESTING
from support.surfaces.small_model import model_of

PATH = "/surfaces/press-7/commissioning"
STEP_US = 10_000
SECOND = 105
"""Samples that last a little longer than a press must be held."""
SWAPPED = (1, 0, 2)


class Commissioning:
    """A commissioning of press-7 through the routes."""

    def __init__(self, bench: Bench) -> None:
        self.bench = bench
        self.sequence = 1
        (surface,) = bench.app.context.registry
        assert surface.model
        self.curve = InfluenceCurve.of(surface.model.metadata)
        self.order: Sequence[int] = (0, 1, 2)
        self.is_late = False
        """Whether a press and its lift come in one batch."""

    def send(self, *rows: Row, boot_id: str = "boot-0001") -> None:
        """Send a batch with a second of samples of each row."""
        each = [row for row in rows for _ in range(SECOND)]
        begin_us = STEP_US * self.sequence
        self.bench.send(*each, sequence=self.sequence, boot_id=boot_id, begin_us=begin_us, every_us=STEP_US)
        self.sequence += len(each)

    def press(self, at_mm: dict[str, float], force_n: float = 8.0) -> None:
        moved = force_n * self.curve.at(np.array([list(at_mm.values())]))[0][0]
        row: Row = moved[list(self.order)].tolist()
        if self.is_late:
            self.send(row, RESTING)
        else:
            self.send(row)
            self.send(RESTING)

    def act(self, action: str = "") -> httpx2.Response:
        return self.bench.post(b"", f"{PATH}{action}", TOKEN)

    @property
    def state(self) -> dict[str, Any]:
        found: dict[str, Any] = self.bench.get(PATH).json()
        return found

    @property
    def now(self) -> dict[str, Any]:
        run: dict[str, Any] = self.state["run"]
        return run

    def follow(self) -> str:
        """Begin, and press as asked until every step is done; return the id."""
        self.send(RESTING)
        assert self.act().status_code == 200
        self.send(RESTING)
        while (run := self.now)["step"] < run["steps"]:
            self.press(run["at_mm"])
        return str(run["id"])


@pytest.fixture
def commissioning(bench: Bench) -> Commissioning:
    return Commissioning(bench)


@pytest.mark.promise("docs/how-to/commission-on-the-page.md", "The result lasts until the service stops: download it.")
def test_from_the_first_press_to_the_record(commissioning: Commissioning) -> None:
    commissioning.order = SWAPPED
    run_id = commissioning.follow()
    done = commissioning.now
    assert (done["stage"], done["at_mm"], done["report"]["passed"]) == (None, None, False)
    assert [one["finding"] for one in done["report"]["sensors"]] == ["swapped", "swapped", "right"]
    assert done["report"]["verdict"][0] == "The cables of s1 and s2 are swapped. Swap them back."
    answer = commissioning.act(f"/confirm?run={run_id}&by=%20Ann%20")
    assert answer.status_code == 200
    result = answer.json()
    assert (result["id"], result["by"], result["sensors"]) == (1, "Ann", done["report"]["sensors"])
    assert commissioning.state == {"run": None, "ended": None, "lasting": False}
    assert commissioning.bench.get(f"{PATH}s").json() == {"commissionings": [result]}
    assert commissioning.bench.get(f"{PATH}s/1").json() == result
    text = commissioning.bench.get(f"{PATH}s/1?format=text")
    assert text.headers["content-type"] == "text/plain; charset=utf-8"
    for words in ("NOT PASSED", "by Ann", *result["verdict"], "moves as s2 should"):
        assert words in text.text
    assert kind(commissioning.bench.get(f"{PATH}s/2")) == "no-commissioning"


def test_a_step_that_is_not_seen_is_skipped_and_nothing_passes_then(commissioning: Commissioning) -> None:
    commissioning.send(RESTING)
    commissioning.act()
    commissioning.send(RESTING)
    commissioning.press(commissioning.now["at_mm"])
    for step in range(1, 6):
        answer = commissioning.act(f"/skip?run={commissioning.now['id']}&step={step}")
        assert answer.json()["run"]["step"] == step + 1
    report = commissioning.now["report"]
    assert [one["finding"] for one in report["sensors"]] == ["right", "unseen", "unseen"]
    assert report["passed"] is False
    assert report["verdict"][0].startswith("The press above s2 and s3 was not seen.")
    assert [one["says"] for one in report["places"]] == ["the press was not seen"] * 3


def test_skip_waits_for_a_new_rest(commissioning: Commissioning) -> None:
    commissioning.send(RESTING)
    commissioning.act()
    commissioning.send(RESTING)
    commissioning.send([0.5, 0.2, 0.1])
    assert commissioning.now["stage"] == "lift"
    commissioning.act(f"/skip?run={commissioning.now['id']}&step=0")
    assert (commissioning.now["step"], commissioning.now["stage"]) == (1, "rest")
    commissioning.send([0.0, 0.0, 0.4])
    assert commissioning.now["stage"] == "rest", "it is unexplained: a load may lie on"
    commissioning.send(*[[0.0, 0.0, 0.4]] * 10)
    assert (commissioning.now["step"], commissioning.now["stage"]) == (1, "press")


def test_nothing_begins_where_nothing_could_be_seen_of_a_press() -> None:
    bench = Bench(surface_with(None))
    assert kind(bench.post(b"", PATH)) == "no-model"
    bench = Bench(surface_of())
    assert kind(bench.post(b"", PATH)) == "no-samples"
    bench.send(RESTING)
    bench.now_s += 10
    assert kind(bench.post(b"", PATH)) == "stale"
    assert kind(bench.post(b"", "/surfaces/nobody/commissioning")) == "unknown-surface"
    # Too few channels may be the very fault that is looked for.
    bench.send([0.0, None, None], sequence=2, quality=["good", "missing", "missing"])
    assert bench.problem() == "too-few-channels"
    assert bench.get("/contact").json()["detail"].startswith("Only 1 channel works; the model needs ")
    assert bench.post(b"", PATH).status_code == 200


@pytest.mark.promise(
    "docs/how-to/commission-on-the-page.md",
    (
        "A button that was meant for an earlier step changes nothing. One commissioning of a surface can be under "
        "way at a time."
    ),
)
@pytest.mark.promise(
    "docs/reference/problems.md",
    "nothing was changed, because no commissioning is under way, or another one or another step than the request names",
)
def test_several_people_cannot_undo_each_others_steps(commissioning: Commissioning) -> None:
    commissioning.send(RESTING)
    run_id = commissioning.act().json()["run"]["id"]
    answers = {
        "": "other-commissioning",
        f"/skip?run={run_id}&step=1": "other-commissioning",
        "/skip?run=another&step=0": "other-commissioning",
        f"/confirm?run={run_id}&by=Ann": "other-commissioning",
        f"/confirm?run={run_id}": "invalid-request",
        f"/confirm?run={run_id}&by=%20%00": "invalid-request",
        "/abandon?run=another": "other-commissioning",
        "/skip?step=0": "invalid-request",
        f"/confirm?run={run_id}&by={'x' * 81}": "invalid-request",
    }
    assert {action: kind(commissioning.act(action)) for action in answers} == answers
    assert commissioning.now["step"] == 0
    assert commissioning.act(f"/abandon?run={run_id}").json()["ended"] == "It was abandoned."
    assert kind(commissioning.act(f"/abandon?run={run_id}")) == "no-commissioning"
    again = commissioning.act().json()["run"]["id"]
    assert again != run_id
    assert kind(commissioning.act(f"/skip?run={run_id}&step=0")) == "other-commissioning"


def test_a_commissioning_that_is_not_at_its_end_says_how_many_steps_are_left(commissioning: Commissioning) -> None:
    commissioning.send(RESTING)
    begun = commissioning.act().json()["run"]
    number = begun["steps"]
    for step in range(number):
        refusal = commissioning.act(f"/confirm?run={begun['id']}&by=Ann").json()["detail"]
        assert refusal == f"Steps that are left: {number - step}. Do them, skip them, or abandon it."
        commissioning.act(f"/skip?run={begun['id']}&step={step}")
    assert commissioning.act(f"/confirm?run={begun['id']}&by=Ann").status_code == 200


@pytest.mark.promise(
    "docs/how-to/commission-on-the-page.md",
    "When another daemon sends, the beam must lie still first.",
    "The commissioning is gone, and the page says so.",
)
def test_another_model_ends_it_and_another_sender_begins_at_rest(commissioning: Commissioning) -> None:
    commissioning.send(RESTING)
    commissioning.act()
    commissioning.send(RESTING)
    assert commissioning.now["stage"] == "press"
    commissioning.send([0.5, 0.2, 0.1], boot_id="boot-0002")
    assert (commissioning.now["stage"], commissioning.now["step"]) == ("rest", 0)
    commissioning.bench.adopt(model_of("press-7", min_channels=3))
    commissioning.send(RESTING, boot_id="boot-0002")
    assert commissioning.state["run"] is None
    assert "The model of the surface changed" in commissioning.state["ended"]


@pytest.mark.promise(
    "docs/how-to/commission-on-the-page.md",
    "The page says that the surface is stale. The steps so far stay",
)
def test_a_surface_that_falls_silent_says_so_and_keeps_the_steps(commissioning: Commissioning) -> None:
    commissioning.send(RESTING)
    commissioning.act()
    commissioning.send(RESTING)
    commissioning.press(commissioning.now["at_mm"])
    asked = commissioning.now["prompt"]
    commissioning.bench.now_s += 10
    assert commissioning.now["prompt"] == "The newest sample is too old. Go on once samples come again."
    commissioning.send(RESTING)
    assert (commissioning.now["prompt"], commissioning.now["step"]) == (asked, 1)


@pytest.mark.promise(
    "docs/how-to/commission-on-the-page.md",
    "It stays under way until somebody goes on or presses Abandon.",
    "It changes nothing else: the surface answers as always.",
)
def test_a_commissioning_that_nobody_goes_on_with_stays_and_the_surface_answers_as_always(bench: Bench) -> None:
    commissioned, plain = Commissioning(bench), Commissioning(Bench(surface_of()))
    commissioned.send(RESTING)
    plain.send(RESTING)
    assert commissioned.act().status_code == 200
    for row in (RESTING, [0.5, 0.25, 0.125], [0.5, 0.25, 0.75], RESTING):
        for commissioning in (commissioned, plain):
            commissioning.send(row)
        assert commissioned.bench.contact() == plain.bench.contact()
    events = [commissioning.bench.get("/events?path=true").json() for commissioning in (commissioned, plain)]
    assert events[0] == events[1] != {"events": [], "next": None}
    commissioned.bench.now_s += 30 * 86_400
    step = commissioned.now["step"]
    commissioned.send(RESTING)
    commissioned.press(commissioned.now["at_mm"])
    assert commissioned.now["step"] == step + 1


def damage(database: Path) -> bytes:
    """Overwrite a database; return what it was."""
    whole = database.read_bytes()
    for one in database.parent.glob(f"{database.name}*"):
        one.write_bytes(b"no database" * 4096)
    return whole


def restore(database: Path, whole: bytes) -> None:
    for one in database.parent.glob(f"{database.name}*"):
        one.unlink()
    database.write_bytes(whole)


@pytest.mark.promise(
    "docs/how-to/commission-on-the-page.md",
    "The result waits. Press Put on record again when the page no longer complains.",
)
def test_while_the_record_is_away_the_result_waits(tmp_path: Path) -> None:
    path = tmp_path / "events.db"
    commissioning = Commissioning(Bench(surface_of(), events=EventsSection(file=path)))
    run_id = commissioning.follow()
    whole = damage(path)
    refusal = commissioning.act(f"/confirm?run={run_id}&by=Ann")
    assert (refusal.status_code, kind(refusal)) == (503, "record-unavailable")
    assert commissioning.now["id"] == run_id
    restore(path, whole)
    assert commissioning.act(f"/confirm?run={run_id}&by=Ann").status_code == 200


@pytest.mark.promise(
    "docs/how-to/commission-on-the-page.md",
    "The commissioning is gone, and the page says so. Results on record stay.",
)
def test_a_service_that_starts_again_has_the_results_and_no_commissioning(tmp_path: Path) -> None:
    events = EventsSection(file=tmp_path / "events.db")
    commissioning = Commissioning(Bench(surface_of(), events=events))
    result = commissioning.act(f"/confirm?run={commissioning.follow()}&by=Ann").json()
    assert commissioning.act().status_code == 200
    assert (commissioning.state["run"] is not None, commissioning.state["lasting"]) == (True, True)
    commissioning.bench.stop()
    again = Bench(surface_of(), events=events)
    assert again.get(PATH).json()["run"] is None
    assert again.get(f"{PATH}s").json() == {"commissionings": [result]}


@pytest.mark.parametrize("is_away", [False, True])
def test_while_a_result_is_being_written_nothing_else_happens_to_its_run(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, is_away: bool
) -> None:
    path = tmp_path / "events.db"
    bench = Bench(surface_of(), events=EventsSection(file=path))
    commissioning = Commissioning(bench)
    run_id = commissioning.follow()
    recorder = bench.app.context.recorder
    write, answers, whole = recorder.write, dict[str, str](), b""

    def act_meanwhile() -> None:
        for action in ("", f"/confirm?run={run_id}&by=Ann", f"/abandon?run={run_id}"):
            answers[action.partition("?")[0]] = kind(commissioning.act(action))
        answers["id"] = commissioning.now["id"]
        bench.adopt(model_of("press-7", min_channels=3))
        commissioning.send(RESTING)

    async def write_slowly(query: Callable[[Any], int]) -> int:
        nonlocal whole
        await run_in_thread(act_meanwhile)
        if is_away:
            whole = damage(path)
        return await write(query)

    with monkeypatch.context() as patch:
        patch.setattr(recorder, "write", write_slowly)
        answer = commissioning.act(f"/confirm?run={run_id}&by=Ann")
    other = "other-commissioning"
    assert answers == {"": other, "/confirm": other, "/abandon": other, "id": run_id}
    assert answer.status_code == (503 if is_away else 200)
    assert (commissioning.state["run"] is not None) is is_away
    if is_away:
        restore(path, whole)
        assert commissioning.act(f"/confirm?run={run_id}&by=Ann").status_code == 200


def test_a_mark_gets_what_the_surface_said_during_its_press_also_when_the_samples_come_late(bench: Bench) -> None:
    in_time, late = Commissioning(bench), Commissioning(Bench(surface_of()))
    late.is_late = True
    for commissioning in (in_time, late):
        commissioning.follow()
    places = in_time.now["report"]["places"]
    assert "contact" in [one["state"] for one in places]
    assert late.now["report"]["places"] == places


def test_a_name_is_one_line_of_what_can_be_printed(commissioning: Commissioning) -> None:
    run_id = commissioning.follow()
    name = "Ann%0Aresult%20%20%20%20PASSED%00%1B%5B2J%E2%80%AE%0D%0A"
    answer = commissioning.act(f"/confirm?run={run_id}&by={name}")
    assert answer.json()["by"] == "Ann result PASSED [2J"
    lines = commissioning.bench.get(f"{PATH}s/1?format=text").text.splitlines()
    assert [line for line in lines if line.startswith("result")] == ["result    NOT PASSED"]
    assert len([line for line in lines if "Ann" in line]) == 1
