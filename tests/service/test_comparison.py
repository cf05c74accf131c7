"""Two models beside each other: the sums over decisions that are given, and the bounds of what is said of them."""

from typing import NamedTuple

import numpy as np
import pytest

from beamtouch_common.outline import Span
from beamtouch_models.runtime import LOG_ODDS, MISFIT, Evidence, State, Weighed
from beamtouch_service.samples import Quality, Sample
from beamtouch_service.surfaces.comparison import Comparison, ComparisonReport
from beamtouch_service.surfaces.contact import Figures
from beamtouch_service.surfaces.estimate import Estimate
from beamtouch_service.surfaces.follower import Decision

CLEAR, CONTACT, UNEXPLAINED = State.CLEAR, State.CONTACT, State.UNEXPLAINED
CHANNELS = 3
NOON_US = 1_763_726_400_000_000
"""2025-11-21T12:00:00Z."""


class Seen(NamedTuple):
    """What a model sees in a sample; figures only of a contact."""

    state: State | None
    position: tuple[float, float, float] = (100.0, 99.0, 101.0)
    force: tuple[float, float, float] | None = None
    misfit: float = 1.0
    whitening_per_mm: float = 100.0
    """Of each of the channels."""
    is_certain: bool = True


def decide(seen: Seen, at_us: int) -> Decision:
    whitening = np.eye(CHANNELS) * seen.whitening_per_mm
    answer = {LOG_ODDS: 20.0, MISFIT: seen.misfit}
    evidence = Evidence(np.zeros(CHANNELS), whitening, answer, CHANNELS, 99.0, False, 20.0, whitening, True)
    sample = Sample(
        sequence=1, acquired_unix_us=at_us, deflection_mm=[0.0] * CHANNELS, quality=[Quality.GOOD] * CHANNELS
    )
    one = np.zeros((1, CHANNELS))
    weighed = Weighed(one, np.eye(CHANNELS)[None], one, np.ones((1, CHANNELS), bool))
    force = seen.force and Span(*seen.force)
    figures = Figures({"position": Span(*seen.position)}, force) if seen.state is CONTACT else None
    estimate = Estimate(sample, {}, evidence, weighed, 0, None)
    return Decision(estimate, seen.state, seen.state or CLEAR, seen.is_certain, figures=figures)


def add(comparison: Comparison, model: Seen, candidate: Seen, samples: int = 1, passed_s: float = 0.0) -> None:
    decided, other = decide(model, NOON_US), decide(candidate, NOON_US)
    for _ in range(samples):
        comparison.add(decided, other, passed_s)


def compare(*pairs: tuple[Seen, Seen, int]) -> ComparisonReport:
    """Return what is said after so many samples of each of these pairs, of the model and the candidate."""
    comparison = Comparison()
    for model, candidate, samples in pairs:
        add(comparison, model, candidate, samples)
    return comparison.report()


RESTS = (Seen(CLEAR), Seen(CLEAR), 150)
FAR = Seen(CONTACT, (50.0, 49.0, 53.0), (4.0, 3.0, 6.0)), Seen(CONTACT, (52.0, 51.0, 52.5), (4.0, 3.5, 4.5))
CONTACTS = (
    (Seen(CONTACT, (100.0, 99.0, 102.0), (8.0, 7.0, 9.0)), Seen(CONTACT, (101.5, 99.5, 103.5), (7.5, 7.0, 8.0))),
    (Seen(CONTACT, (200.0, 198.0, 203.0), (8.0, 7.0, 9.0)), Seen(CONTACT, (199.25, 198.25, 205.25), (9.25, 9.0, 9.5))),
    (Seen(CONTACT, (300.0, 299.0, 300.5), (6.0, 5.0, 7.0)), Seen(CONTACT, (302.0, 300.25, 303.0), (6.5, 6.0, 7.0))),
    FAR,
)


def test_figures_differ_by_their_means_over_the_contacts_of_both() -> None:
    """By 1.5, -0.75, 2 and 2 mm, and by -0.5, 1.25, 0.5 and 0 N."""
    report = compare(*[(model, candidate, 1) for model, candidate in CONTACTS], (Seen(CONTACT), Seen(CLEAR), 1))
    position, force = report.figures["position_mm"], report.figures["force_n"]
    assert report.contacts == 4
    assert (position.mean, position.mean_size, position.largest) == (1.1875, 1.5625, 2.0)
    assert (position.model_width, position.candidate_width) == (3.375, 3.8125)
    assert (position.model_outside, position.candidate_outside) == (2, 1)
    assert (force.mean, force.mean_size, force.largest) == (0.3125, 0.5625, 1.25)
    assert (force.model_width, force.candidate_width) == (2.25, 0.875)
    assert (force.model_outside, force.candidate_outside) == (1, 1)
    assert report.verdict.startswith(
        "The state differs in 1 of 5 samples (clear instead of contact: 1). In 4 contacts of both, the position "
        "differs by 1.5625 mm on average, 2 mm at most and the force differs by 0.5625 N on average, 1.25 N at most. "
        "Its intervals are 13 % wider for the position and 61 % narrower for the force. "
    )


def test_a_difference_of_less_than_a_millimetre_is_the_largest_of_a_single_contact() -> None:
    model, candidate = Seen(CONTACT, (100.0, 99.0, 102.0)), Seen(CONTACT, (100.25, 99.5, 101.0))
    position = compare((model, candidate, 1)).figures["position_mm"]
    assert (position.mean, position.mean_size, position.largest) == (0.25, 0.25, 0.25)
    assert (position.model_width, position.candidate_width) == (3.0, 1.5)
    assert (position.model_outside, position.candidate_outside) == (0, 0)


def test_the_end_of_an_interval_is_in_it() -> None:
    model, candidate = Seen(CONTACT, (100.0, 99.0, 102.0)), Seen(CONTACT, (102.0, 100.0, 104.0))
    for one, other in ((model, candidate), (candidate, model)):
        position = compare((one, other, 1)).figures["position_mm"]
        assert (position.model_outside, position.candidate_outside) == (0, 0)


@pytest.mark.parametrize(
    ("model_mm", "candidate_mm", "words"),
    [
        (2.0, 2.008, "as wide"),
        (2.0, 1.992, "as wide"),
        (2.0, 2.012, "1 % wider"),
        (2.0, 1.988, "1 % narrower"),
        (2.0, 3.0, "50 % wider"),
        (0.5, 0.25, "50 % narrower"),
        (0.0, 1.0, "not comparable"),
    ],
)
def test_widths_are_compared_in_percent_of_those_of_the_model(model_mm: float, candidate_mm: float, words: str) -> None:
    one, other = (Seen(CONTACT, (0.0, -width / 2, width / 2)) for width in (model_mm, candidate_mm))
    assert f" Its intervals are {words} for the position. " in compare((one, other, 1)).verdict


def test_the_time_runs_from_the_first_sample_that_both_decide_for_certain() -> None:
    comparison = Comparison()
    rest = Seen(CLEAR)
    assert comparison.report().since is None
    for one, other in ((Seen(None), rest), (rest, rest._replace(is_certain=False)), (Seen(None), Seen(None))):
        add(comparison, one, other, passed_s=5.0)
        add(comparison, other, one, passed_s=5.0)
    assert (comparison.report().since, comparison.samples, comparison.undecided) == (None, 0, (3, 3))
    add(comparison, Seen(None), rest)
    add(comparison, rest, rest, passed_s=9.0)
    add(comparison, rest, Seen(CONTACT), passed_s=0.25)
    add(comparison, rest, rest, samples=2, passed_s=0.1234)
    comparison.add(decide(rest, 0), decide(rest, 0), 1.0)
    report = comparison.report()
    assert (report.since, report.compared_s, report.samples) == ("2025-11-21T12:00:00.000Z", 1.497, 5)
    assert (report.model.undecided, report.candidate.undecided) == (4, 3)
    assert [(one.model, one.candidate, one.samples) for one in report.states] == [
        (CLEAR, CLEAR, 4),
        (CLEAR, CONTACT, 1),
    ]
    assert (report.differing, report.contacts, report.model.mean_misfit) == (1, 0, None)
    assert report.verdict.startswith("The state differs in 1 of 5 samples (contact instead of clear: 1). Too few")


def test_differing_states_are_listed_by_how_often_they_came() -> None:
    report = compare((Seen(CONTACT), Seen(CLEAR), 2), (Seen(CLEAR), Seen(UNEXPLAINED), 3), RESTS)
    assert report.differing == 5
    assert report.verdict.startswith(
        "The state differs in 5 of 155 samples (unexplained instead of clear: 3, clear instead of contact: 2). "
    )


@pytest.mark.parametrize(
    ("clear", "contacts", "of_one", "is_enough"),
    [(150, 50, 0, True), (149, 50, 0, False), (151, 49, 0, False), (150, 49, 1, True), (0, 200, 0, True)],
)
def test_two_hundred_samples_of_which_fifty_are_touched_are_enough(
    clear: int, contacts: int, of_one: int, *, is_enough: bool
) -> None:
    touched, rest = Seen(CONTACT), Seen(CLEAR)
    report = compare((rest, rest, clear), (touched, touched, contacts), (rest, touched, of_one))
    assert report.is_worse is (False if is_enough else None)
    words = "It explains the samples as well as the model."
    few = "Too few to judge: that takes 200 samples, 50 of them touched."
    assert report.verdict.endswith(words if is_enough else few)


@pytest.mark.parametrize(
    ("of_model", "of_candidate", "is_told"),
    [(0, 3, False), (0, 4, True), (1, 5, True), (40, 44, False), (40, 45, True), (45, 40, True), (4, 0, True)],
)
def test_more_than_three_samples_and_more_than_a_tenth_more_speak_against_a_model(
    of_model: int, of_candidate: int, *, is_told: bool
) -> None:
    """What one of them leaves, or cannot decide, the other one sees as a contact without a difference."""
    contact, lost = Seen(CONTACT), Seen(UNEXPLAINED)
    report = compare(RESTS, (contact, contact, 70), (lost, contact, of_model), (contact, lost, of_candidate))
    whole = 220 + of_model + of_candidate
    words = f"it leaves {of_candidate} of {whole} samples unexplained, the model {of_model}."
    _expect(report, words, of_model, of_candidate, is_told=is_told)

    undecided = Seen(None)
    report = compare(RESTS, (contact, contact, 70), (undecided, contact, of_model), (contact, undecided, of_candidate))
    whole = 220 + max(of_model, of_candidate)
    words = f"it cannot decide {of_candidate} of {whole} samples, the model {of_model}."
    _expect(report, words, of_model, of_candidate, is_told=is_told)


def _expect(report: ComparisonReport, words: str, of_model: int, of_candidate: int, *, is_told: bool) -> None:
    is_worse = is_told and of_candidate > of_model
    assert report.is_worse is is_worse
    begin = "It is worse: " if is_worse else "Nothing speaks against it; for it: "
    assert report.verdict.endswith(f" {begin}{words}" if is_told else "It explains the samples as well as the model.")


@pytest.mark.parametrize(
    ("misfits", "whitening_per_mm", "contacts", "is_told"),
    [
        # As much noise in both: the one of the smaller misfit leaves less.
        ((2.0, 2.4), (100.0, 100.0), 50, True),
        ((2.4, 2.0), (100.0, 100.0), 50, True),
        ((2.0, 2.4), (100.0, 100.0), 49, False),
        ((2.0, 2.19), (100.0, 100.0), 50, False),
        ((2.0, 2.21), (100.0, 100.0), 50, True),
        # 1.44 times the weight of each channel, and as much left: neither is beyond noise, 3.3 for three channels.
        ((2.0, 2.88), (100.0, 120.0), 50, False),
        ((2.28, 3.29), (100.0, 120.0), 50, False),
        ((2.3, 3.31), (100.0, 120.0), 50, True),
        ((3.31, 2.3), (120.0, 100.0), 50, True),
        # More misfit of what is less.
        ((2.0, 2.4), (100.0, 130.0), 50, False),
        ((2.4, 2.0), (130.0, 100.0), 50, False),
    ],
)
def test_a_misfit_counts_if_more_is_left_or_if_it_is_beyond_noise(
    misfits: tuple[float, float], whitening_per_mm: tuple[float, float], contacts: int, *, is_told: bool
) -> None:
    model, candidate = (
        Seen(CONTACT, misfit=misfit, whitening_per_mm=whitening)
        for misfit, whitening in zip(misfits, whitening_per_mm, strict=True)
    )
    touched = (Seen(CLEAR), Seen(CONTACT), 1)
    report = compare(RESTS, (model, candidate, contacts), touched)
    assert (report.model.mean_misfit, report.candidate.mean_misfit) == misfits
    words = f"it explains contacts with a mean misfit of {misfits[1]:g}, the model with {misfits[0]:g}."
    is_worse = is_told and misfits[1] > misfits[0]
    assert report.is_worse is is_worse
    begin = "It is worse: " if is_worse else "Nothing speaks against it; for it: "
    assert report.verdict.endswith(f" {begin}{words}" if is_told else "It explains the samples as well as the model.")


def test_what_speaks_against_a_candidate_and_what_for_it_are_both_said() -> None:
    model, candidate = Seen(CONTACT, misfit=3.5), Seen(CONTACT, misfit=2.0)
    undecided, lost = Seen(None), Seen(UNEXPLAINED)
    report = compare(RESTS, (model, candidate, 60), (model, undecided, 7), (model, lost, 9))
    assert report.is_worse
    assert report.verdict.endswith(
        "It is worse: it leaves 9 of 219 samples unexplained, the model 0, and cannot decide 7 of 226 samples, the "
        "model 0; for it: it explains contacts with a mean misfit of 2, the model with 3.5."
    )
    report = compare(RESTS, (model, candidate, 60), (undecided, candidate, 7))
    assert report.verdict.endswith(
        "Nothing speaks against it; for it: it cannot decide 0 of 217 samples, the model 7, and explains contacts with "
        "a mean misfit of 2, the model with 3.5."
    )
