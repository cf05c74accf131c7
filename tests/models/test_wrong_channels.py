"""Which wirings are looked for, how many contacts show one, and how many samples agree on a wrong channel."""

import numpy as np
import pytest

from beamtouch_models.arrays import Floats
from beamtouch_models.runtime import ModelFile, Suspects, Weighed, Wirings
from beamtouch_models.runtime.decision.wrong_channels import LeftOut, Wiring, wirings
from support.surfaces.deflections import deflections_of
from support.surfaces.small_model import model_of

NAMES = ["a", "b", "c", "d"]


def test_the_wirings_are_two_swapped_one_inverted_and_all_reversed() -> None:
    right = [1.0] * 4
    assert wirings(NAMES)[:2] == [
        Wiring([1, 0, 2, 3], right, "a and b seem to be swapped"),
        Wiring([2, 1, 0, 3], right, "a and c seem to be swapped"),
    ]
    assert wirings(NAMES)[-2:] == [
        Wiring([0, 1, 2, 3], [1.0, 1.0, 1.0, -1.0], "d seems to be inverted"),
        Wiring([3, 2, 1, 0], right, "the channels seem to be in reverse order"),
    ]
    assert len(wirings(NAMES)) == 6 + 4 + 1
    assert len(wirings(NAMES[:3])) == 3 + 3  # the reverse order is a swap
    assert [one.is_reversed for one in wirings(NAMES)] == [False] * 10 + [True]
    assert not any(one.is_reversed for one in wirings(NAMES[:3]))


def test_a_wiring_is_put_right_in_all_that_is_known_of_a_sample() -> None:
    valid = np.array([[True, True, False]])
    one = Weighed(np.array([[1.0, 2.0, 0.0]]), np.arange(9.0).reshape(1, 3, 3), np.array([[0.1, 0.2, 0.3]]), valid)
    right = Wiring([2, 1, 0], [1.0, -1.0, 1.0], "").corrected(one)
    assert right.deflection_mm.tolist() == [[0.0, -2.0, 1.0]]
    assert right.covariance_mm2.tolist() == [[[8.0, -7.0, 6.0], [-5.0, 4.0, -3.0], [2.0, -1.0, 0.0]]]
    assert (right.noise_mm2.tolist(), right.valid.tolist()) == ([[0.3, 0.2, 0.1]], [[False, True, True]])


def named(*explaining: str) -> dict[str, LeftOut]:
    """Return a sample that all channels but these contradict when they are left out."""
    return {name: LeftOut(0.0, explained=name in explaining) for name in NAMES}


def test_a_channel_is_suspected_if_nine_of_ten_of_the_last_forty_samples_name_it_alone() -> None:
    small = model_of()
    suspects = Suspects(small.metadata, small.run)
    for _ in range(36):
        assert suspects.suspect is None
        suspects.add(named("c"))
    assert suspects.suspect == "c"
    for other in (("a",), ("c", "d"), (), ()):
        suspects.add(named(*other))
        assert suspects.suspect == "c"
    suspects.add(named())  # the first of the forty counts no longer
    assert suspects.suspect is None
    for _ in range(40):
        suspects.add(named())
    assert suspects.suspect is None


class Wired:
    """The contacts of the bench, as they are measured through swapped cables of its first two sensors."""

    def __init__(self, model: ModelFile) -> None:
        self._model, self.wirings = model, Wirings(model.metadata, model.run)

    def press(self, *places_mm: float, order: tuple[int, ...] = (1, 0, 2, 3)) -> str | None:
        """Add a settled sample of each contact; return the finding then."""
        for place_mm in places_mm:
            deflection_mm: Floats = deflections_of(self._model, [place_mm], [8.0])[:, list(order)]
            noise_mm2 = np.full(deflection_mm.shape, self._model.metadata.noise.sample_mm**2)
            covariance_mm2 = noise_mm2[:, :, None] * np.eye(len(order))
            self.wirings.add(Weighed(deflection_mm, covariance_mm2, noise_mm2, np.ones((1, len(order)), bool)))
        return self.wirings.finding


@pytest.fixture
def wired(bench: ModelFile) -> Wired:
    return Wired(bench)


SWAPPED = "s1 and s2 seem to be swapped"


def test_three_contacts_at_different_places_show_a_wiring(wired: Wired) -> None:
    assert wired.press(100.0, 101.0, 102.0, 150.0) is None
    assert wired.press(200.0) == SWAPPED
    # A contact that is right shows that it holds no longer.
    assert wired.press(150.0, order=(0, 1, 2, 3)) is None
    assert wired.press(100.0, 150.0) is None
    assert wired.press(200.0) == SWAPPED


def test_places_are_different_from_a_tenth_of_the_range_on(wired: Wired) -> None:
    low_mm, high_mm = 5.0, 395.0  # of the bench
    apart_mm = 0.1 * (high_mm - low_mm)
    assert wired.press(100.0, 100.0 + 0.8 * apart_mm, 100.0 + 1.6 * apart_mm) is None
    assert wired.press(100.0 + 2.8 * apart_mm) == SWAPPED


def test_with_two_channels_no_wiring_is_looked_for() -> None:
    two = model_of(channels=2, min_channels=1)
    found = Wirings(two.metadata, two.run)
    noise_mm2 = np.full((1, 2), 1e-4)
    found.add(Weighed(np.array([[0.0, 1.0]]), noise_mm2[:, :, None] * np.eye(2), noise_mm2, np.ones((1, 2), bool)))
    assert found.finding is None
