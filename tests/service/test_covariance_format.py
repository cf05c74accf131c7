"""The covariance of a sample: what the service takes, and what it refuses with a reason."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from pydantic import ValidationError

from beamtouch_service.samples import Batch, Sample, triangle_rows

if TYPE_CHECKING:
    from service.conftest import Bench, MakeBatch


def sample(triangle: list[float], channels: int) -> Sample:
    return Sample.model_validate(
        {
            "sequence": 1,
            "acquired_unix_us": 0,
            "deflection_mm": [0.5] * channels,
            "quality": ["good"] * channels,
            "readings": 4,
            "covariance_mm2": triangle,
        }
    )


def with_first(batch: dict[str, Any], **fields: object) -> dict[str, Any]:
    return {**batch, "samples": [{**batch["samples"][0], **fields}]}


GOOD = [2.0, 1.0, 2.0, 0.0, 0.5, 1.0]


def test_a_batch_may_state_what_the_sender_knows_or_nothing_of_it(bench: Bench, make_batch: MakeBatch) -> None:
    older = make_batch()
    newer = with_first(make_batch(sequence=2), readings=4, covariance_mm2=GOOD)
    assert bench.post(older).status_code == 200
    assert bench.post({**newer, "noise_mm": [0.01, 0.02, 0.03], "characteristic": "4f2c91d0aa17"}).status_code == 200
    assert bench.get("/surfaces/press-7").json()["samples"]["accepted"] == 2


@pytest.mark.parametrize(
    ("fields", "reason"),
    [
        ({"covariance_mm2": GOOD}, "needs readings"),
        ({"readings": 0}, "greater than or equal to 1"),
        ({"readings": 4, "covariance_mm2": GOOD[:5]}, "must hold 6 values, the lower triangle of 3 channels, not 5"),
        ({"readings": 4, "covariance_mm2": [*GOOD, 1.0]}, "must hold 6 values"),
        ({"readings": 4, "covariance_mm2": [-1.0, 0, 2, 0, 0, 1]}, "negative value on its diagonal"),
        ({"readings": 4, "covariance_mm2": [2.0, 2.1, 2.0, 0, 0, 1]}, "not positive semi-definite"),
        ({"readings": 4, "covariance_mm2": [0.0, 0.1, 2.0, 0, 0, 1]}, "not positive semi-definite"),
        ({"readings": 4, "covariance_mm2": [1.0, 0.9, 1.0, -0.9, 0.9, 1.0]}, "not positive semi-definite"),
    ],
)
def test_what_is_no_covariance_is_refused_with_the_reason(
    bench: Bench, make_batch: MakeBatch, fields: dict[str, object], reason: str
) -> None:
    response = bench.post(with_first(make_batch(), **fields))
    assert response.status_code == 422
    assert reason in response.text
    assert bench.get("/surfaces/press-7").json()["samples"]["accepted"] == 0


@pytest.mark.parametrize("value", ["1e999", "NaN", "-Infinity"])
def test_a_value_that_is_not_finite_is_refused(value: str) -> None:
    text = '{"sequence": 1, "acquired_unix_us": 0, "deflection_mm": [1], "quality": ["good"], "readings": 1, '
    with pytest.raises(ValidationError):
        Sample.model_validate_json(text + f'"covariance_mm2": [{value}]}}')


def test_a_missing_channel_has_no_covariance() -> None:
    missing = {"deflection_mm": [None, 0.5], "quality": ["missing", "good"], "readings": 2}
    fields = {"sequence": 1, "acquired_unix_us": 0, **missing}
    assert Sample.model_validate({**fields, "covariance_mm2": [0.0, 0.0, 1.0]}).covariance_mm2 == [0.0, 0.0, 1.0]
    with pytest.raises(ValidationError, match="must be 0 for a channel without a deflection"):
        Sample.model_validate({**fields, "covariance_mm2": [0.1, 0.0, 1.0]})


@pytest.mark.parametrize("noise_mm", [[0.1], [0.1, 0.0, 0.1], [0.1, math.inf, 0.1]])
def test_a_batch_states_a_positive_noise_per_channel(make_batch: MakeBatch, noise_mm: list[float]) -> None:
    with pytest.raises(ValidationError, match="noise_mm"):
        Batch.model_validate({**make_batch(), "noise_mm": noise_mm})


factors = st.integers(1, 8).flatmap(
    lambda channels: arrays(
        np.float64, st.tuples(st.just(channels), st.integers(1, 8)), elements=st.floats(-1, 1, allow_subnormal=False)
    )
)


@given(factor=factors, scale=st.sampled_from([1e-18, 1e-6, 1.0, 1e6]), digits=st.sampled_from([12, 17]))
@example(factor=np.array([[0.00668995], [0.875]]), scale=1e-18, digits=12)
def test_a_product_of_a_factor_with_itself_is_taken_even_if_rounded(
    factor: np.ndarray[tuple[int, int], np.dtype[np.float64]], scale: float, digits: int
) -> None:
    matrix = scale * factor @ factor.T
    quantum = np.abs(matrix).max() * 10.0**-digits or 1.0
    rounded = np.round(matrix / quantum) * quantum
    channels = len(matrix)
    taken = sample(rounded[np.tril_indices(channels)].tolist(), channels).covariance_mm2
    assert taken is not None
    assert [len(row) for row in triangle_rows(taken)] == list(range(1, channels + 1))


@given(factor=factors, share=st.floats(0.001, 1.0))
def test_a_matrix_with_a_negative_eigenvalue_is_refused(
    factor: np.ndarray[tuple[int, int], np.dtype[np.float64]], share: float
) -> None:
    matrix = factor @ factor.T
    values, vectors = np.linalg.eigh(matrix)
    matrix = matrix - (values[0] + share * (values[-1] + 1)) * np.outer(vectors[:, 0], vectors[:, 0])
    with pytest.raises(ValidationError, match=r"covariance_mm2 (has a negative value|is not positive)"):
        sample(matrix[np.tril_indices(len(matrix))].tolist(), len(matrix))
