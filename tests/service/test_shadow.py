"""A candidate beside the model: what is compared, what is said of it, and that nothing in it moves the answer."""

import onnx
import pytest
from onnx import helper

from beamtouch_models import runtime
from beamtouch_models.runtime import ModelFile
from beamtouch_models.runtime.metadata import POSITION_OUTPUTS
from beamtouch_service.samples import Batch
from beamtouch_service.sections import SurfaceSection
from beamtouch_service.surfaces.comparison import ENOUGH_SAMPLES, ENOUGH_TOUCHED, ComparisonReport
from beamtouch_service.surfaces.fields import encode
from beamtouch_service.surfaces.shadow import SLOW_SAMPLES, Shadow
from beamtouch_service.surfaces.surface import Surface
from service.bench import Row, batch_of, parsed, surface_of
from service.event_story import BETWEEN, MOVING, ODD, RESTING, TOUCHING
from support.surfaces.small_model import ModelOptions, content_of, model_of

NOW_S = 100.0
DOUBTFUL: Row = [0.5, 0.25, 0.27]
"""A contact with a misfit of 20 of at most 30 under the small model."""
LIMIT_MM = 1.2
"""Sum of deflections beyond which the graph of `failing` fails."""


class Beside:
    """A surface with a candidate, and a sender of samples `apart_ms` apart."""

    def __init__(self, candidate: ModelFile, surface: Surface | None = None) -> None:
        self.surface, self.sequence, self.apart_ms = surface or surface_of(), 0, 5
        self.shadow = self.surface.shadow = Shadow(candidate, "press-7", SurfaceSection())

    def send(self, *rows: Row) -> ComparisonReport:
        """Send samples in one batch; return what is known then."""
        batch = parsed(*rows, sequence=self.sequence + 1, every_us=self.apart_ms * 1000)
        self.sequence += len(rows)
        self.surface.receive(batch, NOW_S + self.sequence * self.apart_ms / 1e3)
        return self.shadow.comparison.report()

    def send_moving(self, row: Row) -> None:
        """Send a sample of a beam that moves."""
        body = batch_of(row, sequence=self.sequence + 1)
        body["samples"][0] |= MOVING
        self.sequence += 1
        self.surface.receive(Batch.model_validate(body), NOW_S + self.sequence / 200)


def failing() -> ModelFile:
    """Return a model whose graph fails for a large load: it looks something up beyond the end of a table."""
    model = onnx.load_from_string(content_of("failing"))
    (place,) = [place for place, node in enumerate(model.graph.node) if node.output[0] == "pushed"]
    model.graph.node[place].output[0] = "pushed_well"
    looked_up = [
        helper.make_node("Greater", ["total", "limit"], ["beyond"]),
        helper.make_node("Cast", ["beyond"], ["index"], to=onnx.TensorProto.INT64),
        helper.make_node("Gather", ["table", "index"], ["nothing"]),
        helper.make_node("Add", ["pushed_well", "nothing"], ["pushed"]),
    ]
    for offset, node in enumerate(looked_up, start=place + 1):
        model.graph.node.insert(offset, node)
    for name, shape, value in (("limit", [], LIMIT_MM), ("table", [1], 0.0)):
        model.graph.initializer.append(helper.make_tensor(name, onnx.TensorProto.FLOAT, shape, [value]))
    return runtime.load_bytes(model.SerializeToString(), "failing")


def test_alike_models_do_not_differ() -> None:
    beside = Beside(model_of("other"))
    beside.send(*[RESTING] * 150)
    report = beside.send(*[TOUCHING] * 60)
    assert (report.samples, report.differing, report.contacts) == (210, 0, 60)
    assert report.since == "2026-11-20T23:40:46.123Z"
    assert report.compared_s == pytest.approx(209 * 0.005, abs=0.002)
    assert [(one.model, one.candidate, one.samples) for one in report.states] == [
        ("clear", "clear", 150),
        ("contact", "contact", 60),
    ]
    force = report.figures["force_n"]
    assert (force.mean, force.mean_size, force.largest) == (0, 0, 0)
    assert (force.model_width, force.candidate_width) == (2, 2)
    assert report.is_worse is False
    assert report.verdict == (
        "The state differs in 0 of 210 samples. In 60 contacts of both, the position differs by 0 mm on average, 0 mm "
        "at most and the force differs by 0 N on average, 0 N at most. Its intervals are as wide for the position and "
        "as wide for the force. It explains the samples as well as the model."
    )


def test_differences_are_those_of_the_contacts_of_both() -> None:
    """Forces of 8.75 and of 10 N, of which the candidate says a fifth more: 1.75 and 2 N."""
    beside = Beside(model_of(force_n_per_mm=12.0))
    beside.send(RESTING, TOUCHING)
    report = beside.send([0.5, 0.5, 0.0])
    force, position = report.figures["force_n"], report.figures["position_mm"]
    assert (force.mean, force.mean_size, force.largest) == (1.875, 1.875, 2.0)
    assert (force.model_outside, force.candidate_outside) == (2, 2)
    assert (position.largest, position.model_outside, position.candidate_outside) == (0, 0, 0)
    assert report.is_worse is None
    assert report.verdict.endswith(
        f"Too few to judge: that takes {ENOUGH_SAMPLES} samples, {ENOUGH_TOUCHED} of them touched."
    )


def test_a_model_without_force_differs_in_the_position_alone() -> None:
    report = Beside(model_of(outputs=POSITION_OUTPUTS)).send(RESTING, TOUCHING)
    assert list(report.figures) == ["position_mm"]


@pytest.mark.promise(
    "docs/how-to/rollout.md", "one that leaves more samples unexplained or undecided, or explains contacts less well"
)
def test_a_candidate_that_explains_less_is_worse_and_one_that_explains_more_is_not() -> None:
    """One of them takes the doubtful contact for none."""
    strict = Beside(model_of(misfit_per_mm=2000.0))
    strict.send(*[RESTING] * 150, *[TOUCHING] * 60)
    report = strict.send(*[DOUBTFUL] * 40)
    assert (report.candidate.unexplained, report.model.unexplained) == (38, 0)
    assert report.differing == 38
    assert report.is_worse
    assert "(unexplained instead of contact: 38)" in report.verdict
    assert "It is worse: it leaves 38 of 250 samples unexplained, the model 0" in report.verdict
    lax = Beside(model_of(misfit_per_mm=100.0))
    lax.send(*[RESTING] * 150, *[DOUBTFUL] * 60)
    report = lax.send(*[ODD] * 40)
    assert (report.candidate.unexplained, report.model.unexplained) == (38, 38)
    assert (report.candidate.mean_misfit, report.model.mean_misfit) == (3.5484, 35.4839)
    assert report.is_worse is False
    assert report.verdict.endswith(
        "Nothing speaks against it; for it: it explains contacts with a mean misfit of 3.5484, the model with 35.4839."
    )


PLAIN: ModelOptions = {"misfit_per_mm": 900.0, "noise_mm": 0.01}
NOISY: ModelOptions = {"misfit_per_mm": 100.0, "noise_mm": 0.03}
"""Three times the noise is a ninth of the misfit, of the same deflections."""


@pytest.mark.promise("docs/how-to/rollout.md", "A smaller misfit counts for nothing if it comes from more noise alone")
@pytest.mark.parametrize(("of_model", "of_candidate"), [(PLAIN, NOISY), (NOISY, PLAIN)])
def test_a_model_that_takes_its_sensors_for_noisier_is_neither_worse_nor_better(
    of_model: ModelOptions, of_candidate: ModelOptions
) -> None:
    beside = Beside(model_of("other", **of_candidate), surface_of(**of_model))
    report = beside.send(*[RESTING] * 150, *[[0.5, 0.25, 0.253]] * 60)
    assert report.model.mean_misfit == pytest.approx(0.003 * of_model["misfit_per_mm"], rel=1e-3)
    assert report.candidate.mean_misfit == pytest.approx(0.003 * of_candidate["misfit_per_mm"], rel=1e-3)
    assert report.is_worse is False
    assert report.verdict.endswith("It explains the samples as well as the model.")


def test_a_candidate_that_takes_noise_for_more_than_noise_is_worse() -> None:
    """Of three channels, noise leaves less than 3."""
    beside = Beside(model_of("other", **PLAIN), surface_of(**NOISY))
    report = beside.send(*[RESTING] * 150, *[[0.5, 0.25, 0.254]] * 60)
    assert report.verdict.endswith("It is worse: it explains contacts with a mean misfit of 3.6, the model with 0.4.")


def test_a_candidate_that_sees_no_contact_at_all_is_worse() -> None:
    beside = Beside(model_of(misfit_per_mm=2000.0))
    report = beside.send(*[RESTING] * 151, *[DOUBTFUL] * 49)
    assert (report.samples, report.contacts, report.is_worse) == (200, 0, None)
    report = beside.send(DOUBTFUL)
    assert (report.contacts, report.figures, report.is_worse) == (0, {}, True)
    assert report.verdict.endswith("It is worse: it leaves 48 of 201 samples unexplained, the model 0.")


def test_a_candidate_that_cannot_decide_is_worse() -> None:
    """Where the deflections add up to 2, its position is not a number. What cannot be decided is not compared."""
    beside = Beside(model_of("spoiled"), surface_of(spoiled="force_n", outputs=POSITION_OUTPUTS))
    beside.send(*[RESTING] * 150, *[TOUCHING] * 60)
    report = beside.send(*[[1.0, 1.0, 0.0]] * 5)
    assert (report.samples, report.model.undecided, report.candidate.undecided) == (210, 0, 5)
    assert report.verdict.endswith("It is worse: it cannot decide 5 of 215 samples, the model 0.")


def test_a_candidate_of_other_channels_begins_with_nothing_known() -> None:
    """What a contact of three channels stands on, two cannot compare with a beam that moves."""
    beside = Beside(model_of("other", channels=2))
    beside.surface.shadow = None
    beside.send(TOUCHING)
    beside.surface.shadow = beside.shadow
    beside.send_moving([0.001, 0.0, 0.0])
    assert beside.shadow.error is None


def test_a_state_that_depends_on_what_was_before_is_not_compared() -> None:
    beside = Beside(model_of("other"))
    report = beside.send(BETWEEN, BETWEEN)
    assert (report.samples, report.differing) == (0, 0)


def test_a_candidate_begins_with_what_is_known() -> None:
    beside = Beside(model_of("other"))
    beside.surface.shadow = None
    beside.send(TOUCHING)
    beside.surface.shadow = beside.shadow
    report = beside.send(BETWEEN)
    assert [(one.model, one.candidate, one.samples) for one in report.states] == [("contact", "contact", 1)]


@pytest.mark.promise("docs/how-to/rollout.md", "Nothing that happens in a candidate changes an answer")
def test_a_candidate_whose_graph_fails_ends_the_comparison_and_nothing_else(caplog: pytest.LogCaptureFixture) -> None:
    beside, alone = Beside(failing()), surface_of()
    large: Row = [1.0, 0.25, 0.125]
    for number, row in enumerate([RESTING, TOUCHING, large, TOUCHING, RESTING], 1):
        now_s = NOW_S + number / 200
        beside.send(row)
        alone.receive(parsed(row, sequence=number), now_s)
        assert encode(beside.surface.view(now_s)) == encode(alone.view(now_s))
    assert "the comparison has ended: " in str(beside.shadow.error)
    assert beside.shadow.comparison.samples == 2
    assert [one.levelname for one in caplog.records] == ["ERROR"]


@pytest.mark.promise("docs/how-to/rollout.md", "work of more than 5 ms on a sample, or of a quarter of the time")
@pytest.mark.parametrize(("apart_ms", "limit_ms"), [(40, 5), (20, 5), (8, 2)])
def test_a_candidate_that_works_too_long_ends_the_comparison(apart_ms: int, limit_ms: int) -> None:
    beside, now_s = Beside(model_of("other")), [0.0]
    beside.apart_ms = apart_ms

    def work() -> float:
        now_s[0] += took_s  # between the two looks of each sample
        return now_s[0]

    beside.shadow = beside.surface.shadow = Shadow(model_of("other"), "press-7", SurfaceSection(), work)
    took_s = limit_ms / 1e3 * 0.99
    beside.send(*[RESTING] * SLOW_SAMPLES * 2)
    assert beside.shadow.error is None
    took_s = limit_ms / 1e3 * 1.01
    beside.send(*[RESTING] * (SLOW_SAMPLES - 1))
    assert beside.shadow.error is None
    beside.send(RESTING)
    assert beside.shadow.error == (
        f"the comparison has ended: it works {limit_ms} ms on a sample, {apart_ms} ms apart, which would delay answers"
    )


def test_the_answer_is_given_before_the_candidate_works() -> None:
    beside = Beside(model_of("other"))
    told = list[int]()
    with beside.surface.moves.told(lambda _surface: told.append(beside.shadow.comparison.samples)):
        beside.send(RESTING, TOUCHING)
    assert told == [0]
    assert beside.shadow.comparison.samples == 2


def test_a_new_model_ends_the_comparison() -> None:
    beside = Beside(model_of("other"))
    beside.surface.adopt(model_of("other"))
    assert beside.surface.shadow is None
