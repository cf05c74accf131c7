"""What a sample says under a model: whether it moves and is settled, what zeros add, and what a force is beyond."""

from math import inf, nextafter

import numpy as np
import pytest

from beamtouch_models.runtime import Evidence, ModelFile, Weighed, evidence, is_unchecked
from beamtouch_models.runtime.decision.evidence import is_overload
from beamtouch_models.runtime.departures import Calibration, Departures
from support.surfaces.small_model import PLATE_OUTPUTS, model_of

NOISE_MM2 = 1e-4
"""Variance of the noise that the small model was made for."""


@pytest.fixture(scope="module")
def small() -> ModelFile:
    return model_of()


def sample(
    variance_mm2: float, noise_mm2: float = NOISE_MM2, *, valid: tuple[bool, ...] = (True,) * 3, mm: float = 0.25
) -> Weighed:
    """Return a sample of three channels of this variance and noise."""
    working = np.array([valid])
    return Weighed(np.where(working, mm, 0.0), np.eye(3)[None] * variance_mm2, np.full((1, 3), noise_mm2), working)


def said(model: ModelFile, *samples: Weighed) -> list[Evidence]:
    return evidence(model.metadata, model.run, Weighed.stacked(samples))


def test_a_sample_moves_if_it_scatters_by_half_more_than_its_noise(small: ModelFile) -> None:
    found = said(small, sample(1.5, 1.0), sample(nextafter(1.5, inf), 1.0), sample(1.0, 1.0))
    assert [one.moves for one in found] == [False, True, False]


def test_the_noise_that_the_model_was_made_for_is_no_motion(small: ModelFile) -> None:
    few = NOISE_MM2 / 10
    assert [one.moves for one in said(small, sample(1.49 * NOISE_MM2, few), sample(1.51 * NOISE_MM2, few))] == [
        *(False, True)
    ]


def test_a_channel_that_is_missing_says_nothing_of_motion(small: ModelFile) -> None:
    """Its covariance is 0; of the others, both what scatters and what is noise count."""
    assert said(small, sample(1.6, 1.0, valid=(True, True, False)))[0].moves
    one = sample(1.5, 1.0, valid=(True, True, False))
    (found,) = said(small, one)
    assert (found.moves, found.channels) == (False, 2)
    covariance_mm2 = one.covariance_mm2.copy()
    covariance_mm2[0, 2, 2] = 100.0
    (found,) = said(small, Weighed(one.deflection_mm, covariance_mm2, one.noise_mm2, one.valid))
    assert not found.moves


def test_what_zeros_may_have_walked_since_the_last_rest_is_no_motion(small: ModelFile) -> None:
    zero_mm2 = np.array([[1.0, 0.5]])
    walked = sample(1.5, 1.0).with_zeros(zero_mm2)
    assert np.array_equal(walked.covariance_mm2[0], 1.0 + 2.0 * np.eye(3))
    assert np.array_equal(walked.still_mm2[0], 1.0 + 1.5 * np.eye(3))
    moving = sample(2.3, 1.0).with_zeros(zero_mm2)
    assert [one.moves for one in said(small, walked, moving)] == [False, True]
    assert sample(1.5).with_zeros(None).zero_mm2 is None
    assert np.array_equal(sample(1.5, 0.25).still_mm2[0], 0.25 * np.eye(3))


def test_a_sample_is_settled_if_its_noise_is_about_that_of_the_model(small: ModelFile) -> None:
    most = 1.6 * small.metadata.noise.sample_mm**2
    found = said(small, sample(1.0, most), sample(1.0, nextafter(most, inf)), sample(1.0, 0.0))
    assert [one.is_settled for one in found] == [True, False, True]
    one = sample(1.0, most)
    noise_mm2 = one.noise_mm2.copy()
    noise_mm2[0, 1] *= 2  # of one channel
    assert not said(small, Weighed(one.deflection_mm, one.covariance_mm2, noise_mm2, one.valid))[0].is_settled


def test_the_evidence_under_the_noise_alone_is_that_of_a_still_sample(small: ModelFile) -> None:
    still, moving = said(small, sample(1.0, 1.0), sample(4.0, 1.0))
    assert np.array_equal(moving.still_whitening_per_mm, still.whitening_per_mm)
    assert not np.array_equal(moving.whitening_per_mm, still.whitening_per_mm)
    assert np.array_equal(still.still_whitening_per_mm, still.whitening_per_mm)
    assert still.rest_misfit == pytest.approx(3 * 0.25**2, rel=1e-3)
    assert moving.rest_misfit == pytest.approx(3 * 0.25**2 / 4, rel=1e-3)
    shown, could = moving.shows(moving.deflection_mm), moving.could_show(moving.deflection_mm)
    assert (shown, could) == pytest.approx((moving.rest_misfit, still.rest_misfit))
    assert still.seen_mm == (0.25, 0.25, 0.25)
    (lost,) = said(small, sample(1.0, 1.0, valid=(True, False, True)))
    assert lost.seen_mm == (0.25, None, 0.25)


def test_a_calibrated_beam_rests_where_its_calibration_says(small: ModelFile) -> None:
    departures = Departures(position_offset_mm=[0.0] * 3, gain=[1.0] * 3, offset_mm=[0.25, 0.125, 0.0])
    calibration = Calibration(departures=departures, fitted=["offset"], loads=9, residual_mm=0.0)
    metadata = small.metadata.model_copy(update={"calibration": calibration})
    (one,) = evidence(metadata, small.run, sample(1.0, 1.0, valid=(True, True, False)))
    assert one.deflection_mm.tolist() == [0.0, 0.125, 0.0]
    assert one.rest_misfit == pytest.approx(0.125**2, rel=1e-3)


def test_what_is_not_known_of_a_deflection_counts_for_the_least_that_it_may_be(small: ModelFile) -> None:
    (one,) = said(small, sample(1.0, 1.0))
    unknown = np.array([0.25, np.nan, 0.25])
    assert one.shows(unknown) == pytest.approx(2 * 0.25**2, rel=1e-3)
    assert one.shows(np.full(3, np.nan)) == 0.0
    # What moves all zeros together is known from the channels that are there: a variance of 7 along both.
    (one,) = said(small, sample(1.0, 1.0).with_zeros(np.array([[3.0, 0.0]])))
    assert one.shows(unknown) == pytest.approx(2 * 0.25**2 / 7, rel=1e-3)


def test_parts_of_samples_keep_what_is_known_of_them() -> None:
    two = Weighed.stacked(
        [sample(1.0).with_zeros(np.array([[1.0, 2.0]])), sample(2.0).with_zeros(np.array([[3.0, 4.0]]))]
    )
    second = two.part(np.array([1]))
    assert second.zero_mm2 is not None
    assert second.zero_mm2.tolist() == [[3.0, 4.0]]
    assert second.covariance_mm2[0, 0].tolist() == [9.0, 3.0, 3.0]
    assert sample(1.0).part(np.array([0])).zero_mm2 is None
    without = sample(1.0).without(np.array([1]))
    assert (without.valid.tolist(), without.deflection_mm.tolist()) == ([[True, False, True]], [[0.25, 0.0, 0.25]])
    assert (without.is_whole, sample(1.0).is_whole) == (False, True)
    noisier = sample(1.0).noisier(np.array([[1.0, 2.0, 3.0]]))
    assert np.array_equal(noisier.covariance_mm2[0], np.diag([2.0, 3.0, 4.0]))
    assert np.array_equal(noisier.noise_mm2, sample(1.0).noise_mm2)


def test_a_force_is_beyond_the_range_if_two_half_widths_of_it_are(small: ModelFile) -> None:
    """The scene states up to 20 N."""
    weights = np.eye(3)

    def is_beyond(**answer: float) -> bool:
        return is_overload(small.metadata, Evidence(np.zeros(3), weights, answer, 3, 0.0, False, 0.0, weights, True))

    assert [is_beyond(force_n=24.0, force_low_n=low_n) for low_n in (22.0, 22.001)] == [False, True]
    assert not is_beyond(force_n=10.0, force_low_n=9.0)
    assert not is_beyond(force_n=45.0, force_low_n=22.0)
    assert not is_beyond(force_n=24.0)
    assert not is_beyond(force_low_n=24.0)


@pytest.mark.promise(
    "docs/reference/contact.md",
    "On a plate, three are as few: they fit any two loads.",
)
def test_a_contact_is_checked_by_three_channels_on_a_plate_by_four() -> None:
    weights = np.eye(3)
    one = Evidence(np.zeros(3), weights, {}, 3, 0.0, False, 0.0, weights, True)
    beam, plate = model_of().metadata, model_of(outputs=PLATE_OUTPUTS, channels=4).metadata
    few = {
        name: [is_unchecked(metadata, one._replace(channels=channels)) for channels in (1, 2, 3, 4)]
        for name, metadata in (("beam", beam), ("plate", plate))
    }
    assert few == {"beam": [True, True, False, False], "plate": [True, True, True, False]}
    assert one.misfit == 0.0  # of a model that does not state it
