"""Rests before contacts in the health of the sensors: one that says little counts for little."""

from dataclasses import replace

import numpy as np
import pytest

from beamtouch_models.runtime import BestSample, Health, ModelFile
from models.drawn_contacts import SuccessiveContacts

CONTACTS = 40


@pytest.fixture(scope="module")
def contacts(bench: ModelFile) -> list[BestSample]:
    return SuccessiveContacts(bench).contacts(CONTACTS)


def widths(bench: ModelFile, samples: list[BestSample]) -> tuple[list[float], list[float]]:
    """Return the widths of the intervals of all gains, and of all zeros that were seen."""
    health = Health(bench.metadata)
    health.add(samples)
    each = health.channels()
    return [one.gain.high - one.gain.low for one in each], [one.zero.high - one.zero.low for one in each if one.zero]


def uncertain(samples: list[BestSample], times: float) -> list[BestSample]:
    """Return the same contacts after rests of which less is known."""
    return [replace(one, rest_deviation_mm=[times * error for error in one.rest_deviation_mm or ()]) for one in samples]


@pytest.mark.promise(
    "docs/reference/sensor-health.md",
    "one long after its rest counts the less, by the drift that the scene states.",
)
def test_gains_are_as_uncertain_as_the_rests_before_the_contacts(bench: ModelFile, contacts: list[BestSample]) -> None:
    (exact, _), (usual, _), (vague, _) = (widths(bench, uncertain(contacts, times)) for times in (0.01, 1.0, 100.0))
    assert np.all(np.array(exact) <= np.array(usual))
    assert np.all(np.array(vague) > 1.5 * np.array(usual))


def test_zeros_are_as_uncertain_as_the_rests_before_the_contacts(bench: ModelFile, contacts: list[BestSample]) -> None:
    (_, usual), (_, vague) = (widths(bench, uncertain(contacts, times)) for times in (1.0, 100.0))
    assert len(usual) == len(vague) == len(bench.channels)
    assert np.all(np.array(vague) > 2 * np.array(usual))


def test_a_rest_that_was_not_seen_is_as_uncertain_as_the_floor_of_the_model(
    bench: ModelFile, contacts: list[BestSample]
) -> None:
    unseen = [replace(one, rest_mm=None, rest_deviation_mm=None) for one in contacts]
    offset = [0.0] * len(bench.channels)
    at_floor = [replace(one, rest_mm=offset, rest_deviation_mm=bench.metadata.floor.zero_mm) for one in contacts]
    (gains, zeros), (as_floor, _) = widths(bench, unseen), widths(bench, at_floor)
    assert zeros == []
    assert gains == pytest.approx(as_floor)


def test_very_many_exact_rests_do_not_make_zeros_steadier_than_the_beam(bench: ModelFile) -> None:
    """The floor says how far a zero moves from contact to contact."""
    _, found = widths(bench, uncertain(SuccessiveContacts(bench).contacts(CONTACTS), 1e-6))
    assert min(found) > 1e-2 * min(bench.metadata.floor.zero_mm)
