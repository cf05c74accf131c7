"""Samples weighed by their covariance: in the model's order, by the sender's noise, and what no channel can have."""

import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from beamtouch_models import runtime
from service.bench import Bench, batch_of, surface_with
from service.event_story import BETWEEN, RESTING, TOUCHING
from support.surfaces.deflections import deflections_of

READINGS = 4


class Line:
    """A surface of the model of the bench, and a load in the middle of its beam."""

    def __init__(self, model: runtime.ModelFile) -> None:
        self.model = model
        self.channels = model.channels
        self.noise_mm = model.metadata.noise.reading_mm
        (shape,) = deflections_of(model, [model.metadata.length_mm / 2], [1.0])
        self.load_mm: list[float | None] = (25 * self.noise_mm * shape / shape.max()).tolist()

    def contact(self, *samples: dict[str, Any], **batch: object) -> dict[str, Any]:
        """Return the contact that a new service finds in samples; each has the load unless it states others."""
        bench = Bench(surface_with(self.model, "bench"))
        channels = batch.get("channels", self.channels)
        assert isinstance(channels, list)
        plain = {"deflection_mm": self.load_mm, "quality": ["good"] * len(channels)}
        numbered = [
            plain | {"sequence": number, "acquired_unix_us": number} | sample
            for number, sample in enumerate(samples, start=1)
        ]
        body = {"boot_id": "boot-0001", "channels": channels, "newest_age_ms": 0.0, "samples": numbered}
        answer = bench.post(body | batch, path="/surfaces/bench/samples")
        assert answer.status_code == 200, answer.text
        contact: dict[str, Any] = bench.get("/contact").json()
        return contact

    def figures(self, *samples: dict[str, Any], **batch: object) -> dict[str, Any]:
        """Return position, force and misfit, with their intervals."""
        contact = self.contact(*samples, **batch)
        assert contact["state"] == "contact"
        return {name: value for name, value in contact.items() if name.startswith(("position", "force", "misfit"))}


def triangle(covariance_mm2: np.ndarray[Any, Any]) -> list[float]:
    """Return the lower triangle of a covariance by rows."""
    values: list[float] = covariance_mm2[np.tril_indices(len(covariance_mm2))].tolist()
    return values


def stated(covariance_mm2: np.ndarray[Any, Any]) -> dict[str, Any]:
    return {"readings": READINGS, "covariance_mm2": triangle(covariance_mm2)}


def width_mm(figures: dict[str, Any]) -> float:
    return float(figures["position_high_mm"] - figures["position_low_mm"])


@pytest.fixture(scope="module")
def line(bench_model: Path) -> Line:
    return Line(runtime.load(bench_model))


@pytest.mark.promise(
    "docs/reference/contact.md",
    "Other samples are `clear` with `unsteady` until one of them shows the state.",
)
def test_a_contact_that_is_held_on_a_weak_sample_says_so(bench: Bench) -> None:
    bench.send(RESTING, TOUCHING)
    assert bench.contact()["notes"] == []
    bench.send(BETWEEN, sequence=3)
    held = bench.contact()
    assert (held["state"], held["notes"], held["sequence"]) == ("contact", ["unsteady"], 3)
    bench.send(RESTING, sequence=4)
    assert (bench.contact()["state"], bench.contact()["notes"]) == ("clear", [])
    # After a gap nothing is known of the samples before.
    bench.send(TOUCHING, sequence=5)
    bench.send(BETWEEN, sequence=7)
    assert (bench.contact()["state"], bench.contact()["notes"]) == ("clear", ["unsteady"])


@pytest.mark.promise("docs/reference/samples.md", "A sender that states neither is taken to send settled samples.")
def test_a_sample_without_readings_is_a_settled_one(line: Line) -> None:
    settled_mm = line.model.metadata.noise.sample_mm
    readings = round((line.noise_mm / settled_mm) ** 2)
    assert readings > 1
    noise_mm = [settled_mm * readings**0.5] * len(line.channels)
    assert line.figures({}) == line.figures({"readings": readings}, noise_mm=noise_mm)


def test_readings_divide_the_noise_that_the_sender_states(line: Line) -> None:
    noise_mm = (line.noise_mm * np.linspace(0.9, 1.2, len(line.channels))).tolist()
    divided = line.figures({"readings": READINGS}, noise_mm=noise_mm)
    assert divided == line.figures(stated(np.diag(np.square(noise_mm)) / READINGS), noise_mm=noise_mm)
    assert width_mm(line.figures({"readings": 1}, noise_mm=noise_mm)) > 1.5 * width_mm(divided)


@pytest.mark.promise("docs/reference/samples.md", "The service adds it to the covariance. Null: no further.")
def test_what_zeros_may_have_drifted_is_added_to_the_covariance(line: Line) -> None:
    """All channels together, and each by itself."""
    size, noise_mm = len(line.channels), [line.noise_mm] * len(line.channels)
    common_mm, own_mm = line.noise_mm, line.noise_mm / 2
    drifted_mm2 = np.full((size, size), common_mm**2) + np.eye(size) * own_mm**2
    plain = {"readings": READINGS}
    found = line.figures(plain | {"zero_mm": [common_mm, own_mm]}, noise_mm=noise_mm)
    assert found == line.figures(stated(np.eye(size) * line.noise_mm**2 / READINGS + drifted_mm2), noise_mm=noise_mm)
    assert width_mm(found) > 1.2 * width_mm(line.figures(plain, noise_mm=noise_mm))
    assert line.figures(plain | {"zero_mm": None}, noise_mm=noise_mm) == line.figures(plain, noise_mm=noise_mm)


def test_a_covariance_is_taken_in_the_order_of_the_model(line: Line) -> None:
    size = len(line.channels)
    root = np.random.default_rng(1).normal(0, line.noise_mm / 2, (size, size))
    covariance_mm2 = root @ root.T + np.eye(size) * line.noise_mm**2 / READINGS
    noise_mm = [line.noise_mm] * size
    order: Sequence[int] = [size - 1, *range(size - 1)]
    mixed_mm2 = np.eye(size + 1)
    places = [0, *range(2, size + 1)]  # another channel is between them
    mixed_mm2[np.ix_(places, places)] = covariance_mm2[np.ix_(order, order)]
    channels = [line.channels[place] for place in order]
    deflection_mm = [line.load_mm[place] for place in order]
    mixed = line.figures(
        stated(mixed_mm2) | {"deflection_mm": [deflection_mm[0], 9.0, *deflection_mm[1:]]},
        channels=[channels[0], "other", *channels[1:]],
        noise_mm=[line.noise_mm] * (size + 1),
    )
    assert mixed == line.figures(stated(covariance_mm2), noise_mm=noise_mm)
    assert mixed != line.figures(stated(covariance_mm2[::-1, ::-1]), noise_mm=noise_mm)


@pytest.mark.promise(
    "docs/reference/contact.md",
    "The daemon states another noise than the model was made for. The larger one counts.",
)
@pytest.mark.parametrize(("ratio", "counts"), [(0.5, 1.0), (2.0, 2.0), (0.85, 0.85), (1.2, 1.2)])
def test_of_two_contradicting_noises_the_larger_counts(line: Line, ratio: float, counts: float) -> None:
    size = len(line.channels)
    noise_mm, white_mm2 = [ratio * line.noise_mm] * size, np.eye(size) * line.noise_mm**2 / READINGS
    more_mm2 = np.diag(np.linspace(1, 2, size)) * line.noise_mm**2
    # The samples of a sender whose noise is that of the model are taken as they are.
    taken = [
        line.figures(stated(counts**2 * white_mm2 + more), noise_mm=[line.noise_mm] * size) for more in (0, more_mm2)
    ]
    assert line.figures({"readings": READINGS}, noise_mm=noise_mm) == taken[0]
    assert line.figures(stated(ratio**2 * white_mm2 + more_mm2), noise_mm=noise_mm) == taken[1]


@pytest.mark.parametrize(("ratio", "notes"), [(0.5, ["noise"]), (1.0, []), (1.2, []), (2.0, ["noise"])])
def test_a_contact_says_that_the_noise_contradicts_its_model(line: Line, ratio: float, notes: list[str]) -> None:
    rest = {"deflection_mm": [0.0] * len(line.channels), "readings": 1}
    # Of more noise than the model was made for, several samples show rest.
    contact = line.contact(*[rest] * 6, noise_mm=[ratio * line.noise_mm] * len(line.channels))
    assert contact["notes"] == notes


def test_a_larger_covariance_widens_the_interval_and_is_unsteady(line: Line) -> None:
    size = len(line.channels)
    settled, noise_mm = {"readings": 20}, [line.noise_mm] * size
    large = {"covariance_mm2": triangle(np.eye(size) * (100 * line.noise_mm) ** 2 / 16)}
    sure = line.contact(settled, settled, noise_mm=noise_mm)
    unsure = line.contact(settled, settled | large, noise_mm=noise_mm)
    assert sure["state"] == unsure["state"] == "contact"
    assert width_mm(unsure) > 5 * width_mm(sure)
    assert unsure["notes"] == [*sure["notes"], "unsteady"]


@pytest.mark.promise(
    "docs/reference/samples.md",
    "A deflection far beyond the largest one of the model counts as out of range.",
)
@pytest.mark.parametrize("huge_mm", [1e3, -1e3, 1e38, -1e300])
def test_a_deflection_that_no_load_makes_is_out_of_range(bench: Bench, huge_mm: float) -> None:
    # The largest deflection of the model is 1 mm.
    bench.send([0.5, 0.25, huge_mm])
    assert (bench.contact()["state"], bench.contact()["degraded_channels"]) == ("contact", ["s3"])
    bench.send([huge_mm] * 3, sequence=2)
    problem = bench.get("/contact").json()
    assert (problem["type"], problem["bad_channels"]["s1"]) == (
        "urn:beamtouch:problem:too-few-channels",
        "out-of-range",
    )


GOOD = [2.0, 1.0, 2.0, 0.0, 0.5, 1.0]


@pytest.mark.parametrize(
    ("fields", "reason"),
    [
        ({"covariance_mm2": GOOD, "readings": 4}, ""),
        ({"covariance_mm2": [1e8] * 6, "readings": 1}, ""),
        ({"covariance_mm2": GOOD}, "needs readings"),
        ({"readings": 0}, "greater than or equal to 1"),
        ({"readings": 4, "covariance_mm2": GOOD[:5]}, "must hold 6 values, the lower triangle of 3 channels, not 5"),
        ({"readings": 4, "covariance_mm2": [*GOOD, 1.0]}, "must hold 6 values"),
        ({"readings": 4, "covariance_mm2": [-1.0, 0, 2, 0, 0, 1]}, "negative value on its diagonal"),
        ({"readings": 4, "covariance_mm2": [2.0, 2.1, 2.0, 0, 0, 1]}, "not positive semi-definite"),
        ({"readings": 4, "covariance_mm2": [0.0, 0.1, 2.0, 0, 0, 1]}, "not positive semi-definite"),
        ({"readings": 4, "covariance_mm2": [1.0, 0.9, 1.0, -0.9, 0.9, 1.0]}, "not positive semi-definite"),
        ({"readings": 4, "covariance_mm2": [1.001e8] * 6}, "less than or equal to 100000000"),
        ({"readings": 4, "covariance_mm2": [1e300] * 6}, "less than or equal to 100000000"),
        (
            {"readings": 4, "covariance_mm2": GOOD, "deflection_mm": [None, 0.5, 0.5]}
            | {"quality": ["missing", "good", "good"]},
            "must be 0 for a channel without a deflection",
        ),
    ],
)
def test_what_is_no_covariance_is_refused_with_the_reason(bench: Bench, fields: dict[str, object], reason: str) -> None:
    body = batch_of()
    body["samples"][0] |= fields
    response = bench.post(body)
    assert (response.status_code, reason in response.text) == (422 if reason else 200, True)
    assert bench.get("/contact").is_success is not bool(reason)


def test_a_covariance_that_rounding_makes_unusable_costs_only_its_own_sample(bench: Bench) -> None:
    # An eigenvalue of -2e-4 mm^2 beside one of 3e6 passes for rounding, and is more than the floor makes up for.
    large, above = 1e6, 1e6 * (1 + 2e-10)
    unusable = {"readings": 1, "covariance_mm2": [large, above, large, above, above, large]}
    body = batch_of(RESTING, TOUCHING, TOUCHING)
    body["samples"][1] |= unusable
    bench.send(members=body)
    assert (bench.contact()["state"], bench.contact()["sequence"]) == ("contact", 3)
    body = batch_of(TOUCHING, sequence=4)
    body["samples"][0] |= unusable
    bench.send(members=body)
    problem = bench.get("/contact").json()
    assert problem["type"] == "urn:beamtouch:problem:unusable-estimate"
    assert problem["detail"] == "For the newest sample, covariance_mm2: it must be positive definite."


def answer_to(covariance_mm2: np.ndarray[Any, Any]) -> str:
    """Return what a surface without a model, which takes any channels, says to a sample of this covariance."""
    body = batch_of([0.5] * len(covariance_mm2))
    body["samples"][0] |= stated(covariance_mm2)
    return Bench(surface_with(None)).post(body).text


factors = st.integers(1, 8).flatmap(
    lambda channels: arrays(
        np.float64, st.tuples(st.just(channels), st.integers(1, 8)), elements=st.floats(-1, 1, allow_subnormal=False)
    )
)


@settings(max_examples=25)
@given(factor=factors, scale=st.sampled_from([1e-18, 1e-6, 1.0, 1e6]), digits=st.sampled_from([12, 17]))
@example(factor=np.array([[0.00668995], [0.875]]), scale=1e-18, digits=12)
def test_a_product_of_a_factor_with_itself_is_taken_even_if_rounded(
    factor: np.ndarray[tuple[int, int], np.dtype[np.float64]], scale: float, digits: int
) -> None:
    matrix = scale * factor @ factor.T
    quantum = np.abs(matrix).max() * 10.0**-digits or 1.0
    assert '"accepted":1' in answer_to(np.round(matrix / quantum) * quantum)


@pytest.mark.promise("docs/reference/samples.md", "A matrix that is not positive semi-definite is refused.")
@settings(max_examples=25)
@given(factor=factors, share=st.floats(0.001, 1.0))
def test_a_matrix_with_a_negative_eigenvalue_is_refused(
    factor: np.ndarray[tuple[int, int], np.dtype[np.float64]], share: float
) -> None:
    matrix = factor @ factor.T
    values, vectors = np.linalg.eigh(matrix)
    matrix = matrix - (values[0] + share * (values[-1] + 1)) * np.outer(vectors[:, 0], vectors[:, 0])
    assert re.search("covariance_mm2 (has a negative value on its diagonal|is not positive)", answer_to(matrix))
