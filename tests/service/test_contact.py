"""The contact: its figures, its age, its state from sample to sample, and the problem instead. Numbers by hand."""

import pytest

from beamtouch_models.runtime.metadata import POSITION_OUTPUTS
from service.bench import FIGURES, START_US, Bench, Row, surface_of
from service.event_story import RESTING, TOUCHING

BETWEEN: Row = [0.02, 0.0, 0.0]
"""Log odds of a fifth of those of a touch."""


@pytest.mark.promise("docs/reference/contact.md", "Left out if no zones are configured.")
def test_the_contact_is_the_one_of_the_design(bench: Bench) -> None:
    receipt = bench.send(age_ms=12.3, sequence=4711)
    assert receipt == {"accepted": 1, "repeated": 0, "durable": 4710, "expected": 4712, "stale_ms": 500.0}
    response = bench.get("/contact")
    assert (response.status_code, response.headers["cache-control"]) == (200, "no-store")
    contact = response.json()
    assert str(contact.pop("model")).startswith("press-7@")
    assert contact == {
        "surface": "press-7",
        "state": "contact",
        "position_mm": 150.0,
        "position_low_mm": 149.0,
        "position_high_mm": 151.0,
        "force_n": 8.75,
        "force_low_n": 7.75,
        "force_high_n": 9.75,
        "age_ms": 12.3,
        "sampled_at": "2026-11-20T23:40:46.123Z",
        "sequence": 4711,
        "readings": None,
        "misfit": 0.0,
        "quality": "good",
        "degraded_channels": [],
        "notes": [],
    }
    for path in ("/surfaces/press-7/contact", "/contact?surface=press-7"):
        assert bench.get(path).json() == response.json()


@pytest.mark.promise(
    "docs/reference/contact.md",
    "Position and force are numbers only in the state `contact`, so a client that reads nothing else cannot be misled.",
)
def test_figures_are_rounded_and_there_are_none_on_a_beam_at_rest(bench: Bench) -> None:
    # The position is 100 + 100 s2 + 200 s3, the force 10 times the sum.
    bench.send([0.5, 0.2345678, 0.0])
    contact = bench.contact()
    assert [contact[name] for name in FIGURES] == [123.4568, 122.4568, 124.4568, 7.3457, 6.3457, 8.3457]
    bench.send(RESTING, sequence=2)
    contact = bench.contact()
    assert (contact["state"], {contact[name] for name in FIGURES}) == ("clear", {None})


@pytest.mark.promise("docs/reference/contact.md", "Null without a contact, or if the model does not estimate force.")
def test_a_model_without_force_gives_null_for_it() -> None:
    bench = Bench(surface_of(outputs=POSITION_OUTPUTS))
    bench.send(TOUCHING)
    assert [bench.contact()[name] for name in FIGURES] == [150.0, 149.0, 151.0, None, None, None]


@pytest.mark.promise("docs/reference/contact.md", "Channels that took no part; empty if the quality is good.")
def test_channels_are_matched_by_name_and_one_that_is_not_good_is_left_out_and_named(bench: Bench) -> None:
    bench.send([9.0, 0.125, 0.5, 0.25], channels=["spare", "s3", "s1", "s2"])
    assert bench.contact()["position_mm"] == 150.0
    bench.send([0.5, 0.25, 3.0], sequence=2, quality=["good", "good", "stuck"])
    contact = bench.contact()
    assert (contact["position_mm"], contact["quality"], contact["degraded_channels"]) == (125.0, "degraded", ["s3"])
    bench.send([0.5, None, 0.1], sequence=3, quality=["good", "missing", "stuck"])
    problem = bench.get("/contact").json()
    assert (problem["status"], problem["bad_channels"]) == (503, {"s2": "missing", "s3": "stuck"})
    assert bench.get("/health/ready").json()["surfaces"]["press-7"] == problem
    bench.send(TOUCHING, sequence=4)
    assert bench.contact()["quality"] == "good"


@pytest.mark.promise("docs/reference/problems.md", "`unusable-estimate`: the answer of the model is not finite")
@pytest.mark.promise("docs/reference/contact.md", "On a surface of two sensors, each contact has this note")
def test_each_contact_on_a_surface_of_two_sensors_has_a_note() -> None:
    bench, found = Bench(surface_of(channels=2)), []
    for sequence, row in enumerate(([0.0, 0.0], [0.5, 0.25], [0.5, 0.25], [0.0, 0.0]), 1):
        bench.send(row, sequence=sequence)
        found.append((bench.contact()["state"], bench.contact()["notes"]))
    assert found == [("clear", []), *[("contact", ["unchecked"])] * 2, ("clear", [])]


@pytest.mark.parametrize("name", [*FIGURES, "contact_log_odds", "misfit"])
def test_what_is_not_finite_is_never_an_answer(name: str) -> None:
    bench = Bench(surface_of(spoiled=name))
    bench.send([1.0, 0.5, 0.5])
    problem = bench.get("/contact")
    assert "NaN" not in problem.text
    assert problem.json()["type"] == "urn:beamtouch:problem:unusable-estimate"
    assert f"{name} is not a finite number" in problem.json()["detail"]
    assert bench.get("/health/ready").json()["surfaces"]["press-7"] == problem.json()


@pytest.mark.promise("docs/reference/problems.md", "or its interval misses the beam.")
@pytest.mark.parametrize(
    ("row", "answer"),
    [
        ((0.5, 0.0, 0.0, 1.0), 400.0),
        ((0.5, 0.005, 0.0, 1.0), 400.5),
        ((0.9, 0.0, 0.0, -0.335), -0.5),
        ((0.5, 0.02, 0.0, 1.0), "position_mm is 402, off a beam of 400 mm"),
        ((0.9, 0.0, 0.0, -0.4), "position_mm is -20, off a beam of 400 mm"),
    ],
)
def test_a_position_beyond_the_end_is_an_answer_only_while_its_interval_meets_the_beam(
    row: tuple[float, ...], answer: float | str
) -> None:
    bench = Bench(surface_of(channels=4))
    bench.send(list(row))
    if isinstance(answer, float):
        assert bench.contact()["position_mm"] == pytest.approx(answer, abs=1e-3)
    else:
        assert answer in bench.get("/contact").json()["detail"]


@pytest.mark.parametrize(
    ("unix_us", "sampled_at"),
    [
        (0, "1970-01-01T00:00:00.000Z"),
        (1_795_218_046_123_999, "2026-11-20T23:40:46.123Z"),
        (2**53 - 1, "2255-06-05T23:47:34.740Z"),
    ],
)
def test_times_are_rfc_3339_with_milliseconds(bench: Bench, unix_us: int, sampled_at: str) -> None:
    sample = {"sequence": 1, "acquired_unix_us": unix_us, "deflection_mm": TOUCHING, "quality": ["good"] * 3}
    bench.send(members={"samples": [sample]})
    assert bench.contact()["sampled_at"] == sampled_at


def test_a_note_of_the_sender_stands_with_the_contact_until_it_is_gone(bench: Bench) -> None:
    bench.send(members={"notes": ["rate"]})
    assert bench.contact()["notes"] == ["rate"]
    bench.send(sequence=2)
    assert bench.contact()["notes"] == []


@pytest.mark.promise("docs/reference/service-configuration.md", "No contact is given from a sample older than this.")
@pytest.mark.promise("README.md", "no position comes from samples older than a surface's limit")
@pytest.mark.promise("docs/reference/samples.md", "A sample that arrives again counts as repeated and changes nothing.")
@pytest.mark.promise(
    "docs/reference/http.md",
    "200 while every surface can answer `GET /contact` and nothing else is missing, otherwise 503 with the reasons",
)
def test_no_samples_then_fresh_then_stale(bench: Bench) -> None:
    assert (bench.problem(), bench.problem("/health/ready")) == ("no-samples", "not-ready")
    bench.send(age_ms=100)
    assert bench.contact()["age_ms"] == 100.0
    assert bench.get("/health/ready").json() == {"status": "ready"}
    bench.now_s += 0.25
    assert bench.contact()["age_ms"] == 350.0
    # A repeated batch makes nothing younger.
    assert bench.send(age_ms=0)["repeated"] == 1
    bench.now_s += 0.15
    assert bench.contact()["age_ms"] == 500.0
    bench.now_s += 1e-6
    stale = bench.get("/contact")
    assert (stale.status_code, stale.json()["type"]) == (503, "urn:beamtouch:problem:stale")
    assert (stale.json()["surface"], stale.json()["age_ms"], stale.json()["stale_ms"]) == ("press-7", 500.0, 500.0)
    assert bench.get("/health/ready").json()["surfaces"]["press-7"]["type"] == "urn:beamtouch:problem:stale"
    assert bench.get("/health/live").json() == {"status": "live"}
    # A newer sample counts however old it is: then the one before was older still.
    bench.send(TOUCHING, sequence=2)
    bench.send(RESTING, sequence=3, age_ms=1e12)
    assert bench.problem() == "stale"


@pytest.mark.promise("docs/reference/samples.md", "A late sample never replaces a newer one.")
def test_the_newest_sample_counts_whatever_comes_after_it(bench: Bench) -> None:
    bench.send([0.5, 0.5, 0.0], TOUCHING, sequence=1000)
    before = bench.contact()
    assert (before["sequence"], before["position_mm"]) == (1001, 150.0)
    for sequence, age_ms in ((999, 0.0), (500, 3_600_000.0), (1, 3_600_000.0)):
        bench.send(RESTING, RESTING, sequence=sequence, age_ms=age_ms)
        assert bench.contact() == before
    bench.send(RESTING, RESTING, RESTING, BETWEEN, sequence=999)
    assert (bench.contact()["sequence"], bench.contact()["state"]) == (1002, "contact")


def states(bench: Bench, rows: list[Row], each: int = 1) -> str:
    """The state after each batch of so many samples: c(ontact) or l(ifted)."""
    found = ""
    for start in range(0, len(rows), each):
        bench.now_s += 0.005 * each
        bench.send(*rows[start : start + each], sequence=start + 1)
        found += {"contact": "c", "clear": "l"}[bench.contact()["state"]]
    return found


@pytest.mark.promise("docs/reference/contact.md", "the log odds fall to an eighth of the threshold")
def test_between_the_thresholds_the_state_is_what_it_was(bench: Bench) -> None:
    """A contact ends at an eighth of the log odds at which it begins."""
    assert states(bench, [BETWEEN, TOUCHING, *[BETWEEN] * 6, RESTING, BETWEEN]) == "lc" + "c" * 6 + "ll"


@pytest.mark.parametrize(("each", "found"), [(1, "ccll"), (2, "cl"), (4, "l")])
def test_a_batch_is_answered_as_its_samples_one_by_one(bench: Bench, each: int, found: str) -> None:
    assert states(bench, [TOUCHING, BETWEEN, RESTING, BETWEEN] * 10, each) == found * 10


@pytest.mark.promise(
    "docs/reference/contact.md",
    "Over missing samples, and samples that allow no decision, a contact continues for at most `stale_ms`.",
)
def test_a_sample_without_an_answer_leaves_the_state_and_a_long_gap_does_not(bench: Bench) -> None:
    bench.send(TOUCHING, sequence=1)
    bench.send([None, None, None], sequence=2, quality=["missing"] * 3)
    assert bench.problem() == "too-few-channels"
    assert bench.get("/contact").json()["detail"].startswith("Only 0 channels work; the model needs ")
    bench.send(BETWEEN, sequence=3)
    assert bench.contact()["state"] == "contact"
    bench.send(BETWEEN, sequence=900)
    assert bench.contact()["state"] == "clear"


def test_a_channel_or_a_noise_that_changes_is_weighed_anew(bench: Bench) -> None:
    bench.send(TOUCHING, sequence=1)
    assert bench.contact()["notes"] == []
    bench.send(TOUCHING, sequence=2, members={"noise_mm": [0.05] * 3})
    assert bench.contact()["notes"] == ["noise"]
    bench.send(TOUCHING, sequence=3, channels=["s3", "s2", "s1"])
    # Now s1 is 0.125 mm, and s3 is 0.5 mm: the model knows no such contact.
    assert (bench.contact()["notes"], bench.contact()["misfit"]) == (["unsteady"], 250.0)


@pytest.mark.promise(
    "docs/reference/contact.md",
    "Time of the sample by the sender's clock (RFC 3339). It never decides freshness.",
)
@pytest.mark.parametrize("days", [40, -40, 3653])
def test_a_clock_of_the_sender_that_is_set_changes_no_answer(days: int) -> None:
    """BETWEEN ends no contact, but begins none either: it shows whether what was before it counts."""
    answers = []
    for set_us in (0, days * 86_400_000_000):
        bench, found = Bench(surface_of()), []
        for number, row in enumerate([RESTING, *[TOUCHING] * 3, BETWEEN, BETWEEN, TOUCHING, RESTING], 1):
            bench.now_s += 0.005
            bench.send(row, sequence=number, begin_us=START_US + 5000 * number + (set_us if number > 4 else 0))
            found.append({key: value for key, value in bench.contact().items() if key != "sampled_at"})
        answers.append(found)
    assert [answer["state"] for answer in answers[0]] == ["clear", *["contact"] * 6, "clear"]
    assert answers[0] == answers[1]
