"""Which wirings are looked for, how many contacts show one, and how many samples agree on a wrong channel."""

import numpy as np
import pytest
from numpy.typing import NDArray

from beamtouch_models.arrays import Bools, Floats, Floats32
from beamtouch_models.runtime import ModelFile, Suspects, Weighed, Wirings
from beamtouch_models.runtime.decision.wrong_channels import LeftOut, WiringFault, wiring_faults
from support.surfaces.deflections import deflections_of
from support.surfaces.small_model import model_of

NAMES = ["a", "b", "c", "d"]


def test_the_wirings_are_two_swapped_one_inverted_and_all_reversed() -> None:
    right = [1.0] * 4
    assert wiring_faults(NAMES)[:2] == [
        WiringFault([1, 0, 2, 3], right, "a and b seem to be swapped"),
        WiringFault([2, 1, 0, 3], right, "a and c seem to be swapped"),
    ]
    assert wiring_faults(NAMES)[-2:] == [
        WiringFault([0, 1, 2, 3], [1.0, 1.0, 1.0, -1.0], "d seems to be inverted"),
        WiringFault([3, 2, 1, 0], right, "the channels seem to be in reverse order"),
    ]
    assert len(wiring_faults(NAMES)) == 6 + 4 + 1
    assert len(wiring_faults(NAMES[:3])) == 3 + 3  # the reverse order is a swap
    assert [one.is_reversed for one in wiring_faults(NAMES)] == [False] * 10 + [True]
    assert not any(one.is_reversed for one in wiring_faults(NAMES[:3]))


def test_a_wiring_is_put_right_in_all_that_is_known_of_a_sample() -> None:
    valid = np.array([[True, True, False]])
    one = Weighed(np.array([[1.0, 2.0, 0.0]]), np.arange(9.0).reshape(1, 3, 3), np.array([[0.1, 0.2, 0.3]]), valid)
    right = WiringFault([2, 1, 0], [1.0, -1.0, 1.0], "").corrected(one)
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


PRESSED = Weighed(np.full((1, 4), 0.5), np.eye(4)[None] * 1e-4, np.full((1, 4), 1e-4), np.ones((1, 4), bool))
"""A settled sample of a contact, of four channels."""
ODD, EXPLAINED = 300.0, 30.0
"""Misfits: far beyond the limit, and at it."""


class Told:
    """Contacts of a graph that answers as it is told."""

    def __init__(self, channels: int = 4) -> None:
        model = model_of(channels=channels)
        self.names = [channel.name for channel in model.metadata.layout]
        self.found = Wirings(model.metadata, self.run)
        self.weights: NDArray[np.floating] = np.zeros(0)

    def run(self, _: NDArray[np.floating], whitening_per_mm: NDArray[np.floating]) -> dict[str, Floats32]:
        self.weights = whitening_per_mm
        # What moves is run once more, as if it were still.
        misfits = np.resize(np.array(self._misfits, np.float32), len(whitening_per_mm))
        places = np.full(len(misfits), self._place_mm, np.float32)
        return {"misfit": misfits, "position_mm": places, "contact_log_odds": places}

    def press(self, place_mm: float, asis: float = ODD, **by_wiring: float) -> str | None:
        """Add a contact with this misfit as it is, and these by the first words of a wiring; else it is odd."""
        told = [by_wiring.get(wiring.text.split()[0], ODD) for wiring in wiring_faults(self.names)]
        self._misfits, self._place_mm = [asis, *told], place_mm
        count = len(self.names)
        self.found.add(PRESSED if count == 4 else Weighed(*_first(count)))
        return self.found.finding


def _first(count: int) -> tuple[Floats, Floats, Floats, Bools]:
    one = PRESSED
    return (
        one.deflection_mm[:, :count],
        one.covariance_mm2[:, :count, :count],
        one.noise_mm2[:, :count],
        one.valid[:, :count],
    )


INVERTED = "s4 seems to be inverted"


@pytest.mark.parametrize(("asis", "finding"), [(270.0, INVERTED), (269.0, None)])
def test_a_wiring_that_is_put_right_makes_errors_a_third_at_most(asis: float, finding: str | None) -> None:
    """And misfits a ninth."""
    told = Told()
    for place_mm in (100.0, 200.0, 300.0):
        assert told.found.finding is None
        told.press(place_mm, asis, s4=EXPLAINED)
    assert told.found.finding == finding


def test_a_contact_that_is_explained_as_it_is_shows_no_wiring() -> None:
    told = Told()
    assert [told.press(place_mm, EXPLAINED, s4=0.0) for place_mm in (100.0, 200.0, 300.0)] == [None] * 3


def test_a_contact_that_a_wiring_does_not_explain_speaks_against_it() -> None:
    told = Told()
    found = [told.press(100.0, s4=1.0), told.press(200.0, s4=1.0), told.press(250.0), told.press(300.0, s4=1.0)]
    assert found == [None] * 4
    assert told.press(200.0, s4=1.0) is None
    assert told.press(100.0, s4=1.0) == INVERTED
    # Something else that is odd says nothing of a wiring that was found; a contact that is right does.
    assert told.press(150.0) == INVERTED
    assert told.press(150.0, 1.0, s4=1.0) == INVERTED
    assert told.press(150.0, 1.0) is None


def test_of_three_channels_a_wiring_must_explain_five_contacts() -> None:
    for channels, contacts in ((4, 3), (3, 5)):
        told = Told(channels)
        last = told.names[-1]
        found = [told.press(50.0 * number, **{last: 1.0}) for number in range(1, contacts + 1)]
        assert found == [*[None] * (contacts - 1), f"{last} seems to be inverted"]


def test_wirings_are_found_on_a_surface_whose_gains_are_off_by_3_percent() -> None:
    told = Told()
    told.press(100.0)
    # Noise, gain, and the floor of the model: 0.3 % and 2 um.
    variance_mm2 = 1 / told.weights[0, 0, 0] ** 2
    assert variance_mm2 == pytest.approx(1e-4 + 0.015**2 + 0.0015**2 + 0.002**2, rel=1e-3)


def test_a_channel_is_left_out_where_enough_others_check_a_contact() -> None:
    model = model_of(channels=4)
    suspects = Suspects(model.metadata, model.run)
    valid = np.array([[True] * 4, [True, True, False, True]])
    deflection_mm = np.array([[0.5, 0.25, 0.75, 0.125], [0.5, 0.25, 0.0, 0.125]])
    noise_mm2 = np.full((2, 4), 1e-6)
    samples = Weighed(deflection_mm, noise_mm2[:, :, None] * np.eye(4), noise_mm2, valid)
    whole, few = suspects.leave_out(samples)
    assert {name: left.explained for name, left in whole.items()} == {"s1": False, "s2": False, "s3": True, "s4": False}
    assert few == {}
    # At the noise of the model, or that of the samples if it is larger.
    for sample_mm2, coarse_mm2 in ((1e-6, 1e-4), (1e-3, 1e-3)):
        noise_mm2 = np.full((2, 4), sample_mm2)
        coarse = suspects._coarse(Weighed(deflection_mm, noise_mm2[:, :, None] * np.eye(4), noise_mm2, valid))
        assert coarse.noise_mm2 == pytest.approx(np.full((2, 4), coarse_mm2))
        assert coarse.covariance_mm2[0] == pytest.approx(np.eye(4) * coarse_mm2)
