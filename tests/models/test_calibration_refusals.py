"""When a calibration is refused, and what it then says: the limits of each check from both sides."""

from dataclasses import replace

import numpy as np
import pytest

from beamtouch_models.design.calibration import calibrate, self_calibrate
from beamtouch_models.design.calibration.doubts import _bend_in_words, common_in_words
from beamtouch_models.design.calibration.fit import Fit, fit
from beamtouch_models.design.calibration.mistaken import MistakenLoad
from beamtouch_models.design.calibration.nominal_surface import NominalSurface
from beamtouch_models.design.calibration.session import COMMON, SHIFT, WEIGHT, bend_of
from beamtouch_models.design.calibration.unlabelled import ContactFit, RemainingUncertainty
from beamtouch_models.errors import NotGoodEnoughError
from models.nominal_beam import NOISE_MM, loads_on, nominal_of
from support.surfaces.small_model import model_of

METADATA = model_of("bench", channels=4).metadata
PERFECT = np.zeros(16)


@pytest.fixture(scope="module")
def nominal() -> NominalSurface:
    return nominal_of()


def contact_fit(nominal: NominalSurface, **fields: object) -> ContactFit:
    """Return a fit to a hundred contacts from 1 to 399 mm that are single ones, with some fields changed."""
    plain = ContactFit(
        nominal,
        ("gain", "offset"),
        PERFECT,
        np.zeros((16, 16)),
        PERFECT,
        size=0.5,
        left_error=0.001,
        position_mm=np.linspace(1.0, 399.0, 101),
        single=np.ones(101),
        misfit=np.full(101, 2.0),
        penalty=3.0,
    )
    return replace(plain, **fields)  # type: ignore[arg-type]


def refusal(check: object, *given: object) -> str:
    with pytest.raises(NotGoodEnoughError) as refused:
        check(*given)  # type: ignore[operator]
    return str(refused.value)


def test_twelve_contacts_are_enough_and_channels_beyond_a_contact(nominal: NominalSurface) -> None:
    self_calibrate._check_contacts(nominal, 12)
    assert refusal(self_calibrate._check_contacts, nominal, 11) == (
        "nothing was written: 11 contacts are too few; it takes 12, and 200 are better"
    )
    few = replace(nominal, prior=nominal.prior.without(1, 2), sensor_mm=nominal.sensor_mm[[0, 3]])
    assert refusal(self_calibrate._check_contacts, few, 99).startswith(
        "nothing was written: 2 channels fit a contact of any place and force, so that unlabelled contacts tell "
        "nothing; it takes 3. "
    )
    self_calibrate._check_contacts(replace(nominal, prior=nominal.prior.without(1)), 12)


def test_a_third_of_the_contacts_may_be_several_and_a_stated_part_unexplained(nominal: NominalSurface) -> None:
    third = np.where(np.arange(102) < 34, 0.0, 1.0)
    self_calibrate._check_single(contact_fit(nominal, single=third * (1 + 1e-12), left_error=0.02), 0.02)
    more = np.where(np.arange(100) < 34, 0.0, 1.0)
    assert refusal(self_calibrate._check_single, contact_fit(nominal, single=more), 0.02).startswith(
        "nothing was written: the contacts do not fit this model's surface: at best, 34% of them are no single contacts"
    )
    said = refusal(self_calibrate._check_single, contact_fit(nominal, left_error=0.0201), 0.02)
    assert "at best, 2.0% of the deflections remain unexplained. Check" in said


def test_contacts_lie_over_two_fifths_of_the_range(nominal: NominalSurface) -> None:
    """The middle eight tenths of them, of those that are single; the range has 398 mm, and two fifths are 159.2 mm."""
    positions = np.array([0.0, *np.linspace(0.0, 199.2, 101), 250.0]) + 20
    single = np.array([0.2, *[1.0] * 101, 0.5])
    self_calibrate._check_spread(contact_fit(nominal, position_mm=positions, single=single))
    narrow = 20 + 0.99 * (positions - 20)
    assert refusal(self_calibrate._check_spread, contact_fit(nominal, position_mm=narrow, single=single)) == (
        "nothing was written: most contacts lie between 39.72 and 197.5 mm, which determines no fit. Touch the whole "
        "beam, or calibrate with known loads"
    )


def test_a_beam_with_fixed_ends_is_told_if_that_makes_the_contacts_more_likely(nominal: NominalSurface) -> None:
    plain = contact_fit(nominal)
    assert plain.cost == pytest.approx(2 * 101 + 3)
    vector = np.where(np.arange(16) == 10, 2.0, 0.0) + np.where(np.arange(16) == 11, 0.5, 0.0)
    covariance = np.diag(np.where(np.arange(16) == 10, 0.09, 0.0) + np.where(np.arange(16) == 11, 0.25, 0.0))
    fixed = contact_fit(nominal, vector=vector, covariance=covariance)
    self_calibrate._check_beam(plain, replace(fixed, penalty=3.0 - 9.9))
    assert (
        "as if its ends were fixed by 0.20 +- 0.03 (left) and 0.05 +- 0.05 (right), where 0 is as in the scene"
    ) in refusal(self_calibrate._check_beam, plain, replace(fixed, penalty=3.0 - 10.1))


def uncertainty(open_mm: float, shift_mm: float, floor: float = 0.01) -> RemainingUncertainty:
    """Return that of two places and two channels; with gains known to 0.1 and 0.2, the model states 5 and 10 mm."""
    return RemainingUncertainty(
        np.array([0.6, 0.8]) * open_mm * np.sqrt(2),
        shift_mm,
        np.array([[[30.0, 20.0]], [[60.0, 40.0]]]),
        np.eye(2),
        np.array([0.002, floor]),
        0.0,
    )


def test_contacts_must_tell_more_than_the_model_states_or_than_they_move_places(nominal: NominalSurface) -> None:
    gain, stated_mm = np.array([0.1, 0.2]), np.sqrt((5**2 + 10**2) / 2)
    self_calibrate._check_determined(contact_fit(nominal), uncertainty(0.999 * stated_mm, 1.0), gain)
    self_calibrate._check_determined(contact_fit(nominal), uncertainty(9.0, 9.1), gain)
    assert refusal(self_calibrate._check_determined, contact_fit(nominal), uncertainty(9.0, 8.9), gain) == (
        "nothing was written: 101 contacts determine too little. They move positions by 8.9 mm and leave 9 mm open, "
        "more than the 7.91 mm that the model states; record more, over the whole beam"
    )


def test_a_gain_is_to_be_known_to_five_percent() -> None:
    self_calibrate._check_gains(METADATA, uncertainty(1.0, 1.0, 0.0499), 77)
    assert refusal(self_calibrate._check_gains, METADATA, uncertainty(1.0, 1.0, 0.0623), 77).startswith(
        "nothing was written: 77 contacts leave the gain of s2 known to 6.2 % only, worse than 5 %; record more"
    )


def test_the_error_of_all_forces_is_that_of_the_mean_gain(nominal: NominalSurface) -> None:
    root = np.zeros((16, 16))
    root[1:5, 1:5] = np.random.default_rng(3).normal(size=(4, 4))
    covariance = root @ root.T
    draws = np.random.default_rng(4).multivariate_normal(np.zeros(16), covariance, 20_000)
    assert self_calibrate._force_error(contact_fit(nominal, covariance=covariance)) == pytest.approx(
        0.04 * draws[:, 1:5].mean(axis=1).std(), rel=0.02
    )
    known = nominal_of((9.0, 9.0))
    assert self_calibrate._force_error(contact_fit(known, covariance=covariance)) == 0.0


@pytest.mark.parametrize(
    ("times", "rest", "said"),
    [
        (-1.0, 0.0, "All deflections are -1 times what the model expects: a deflection is positive in the direction"),
        (9.81, 0.0, "All deflections are 9.8 times what the model expects: check the units of deflections and forces"),
        (0.5, 0.049, "All deflections are 0.5 times"),
        (0.5, 0.052, "Check that model, sensors, positions and forces belong together"),
    ],
)
def test_deflections_that_are_all_wrong_by_a_factor_are_told_with_it(times: float, rest: float, said: str) -> None:
    expected_mm, other_mm = np.array([0.2, 0.4, 0.4]), np.array([0.4, -0.4, 0.2])
    assert calibrate._scale_hint(times * expected_mm + rest * other_mm, expected_mm).startswith(said)


def load_of(index: int, *, certain: bool) -> MistakenLoad:
    return MistakenLoad(index, np.array([123.456]), 7.654, certain)


def test_loads_that_contradict_the_others_are_told_with_what_the_others_say(nominal: NominalSurface) -> None:
    loads = loads_on(nominal, PERFECT)
    sentence = "says 150 mm and 8.33333 N, but the other loads place it at 123.5 mm with 7.65 N"
    assert calibrate._contradiction(loads, (load_of(2, certain=True),)) == (
        f"load 3 (line 2) {sentence}; correct it, or use --leave-out 3; nothing was written"
    )
    assert calibrate._contradiction(loads, (load_of(2, certain=False),)).startswith(f"load 3 (line 2) {sentence}; corr")
    two = calibrate._contradiction(loads, (load_of(2, certain=True), load_of(0, certain=True)))
    assert two.endswith("correct it, or use --leave-out 3 --leave-out 1; nothing was written")
    either = calibrate._contradiction(loads, (load_of(2, certain=True), load_of(0, certain=False)))
    assert either.startswith("either load may be wrong: load 3 (line 2) says 150 mm")
    assert either.endswith("; record more loads to find out which; nothing was written")
    on_plate = MistakenLoad(0, np.array([12.0, 34.567]), 1.0, certain=True)
    assert calibrate._to_four_digits(on_plate) == "(12, 34.57)"


def test_a_fit_that_is_worse_is_told_with_its_largest_error(nominal: NominalSurface) -> None:
    loads = loads_on(nominal, PERFECT)
    after = np.array([1.0, 2.0, 9.876, 1.0, 0.0, 0.0, 0.124])
    assert calibrate._worse(loads, np.full(7, 1.5), after) == (
        "nothing was written: a model fitted to these loads would be worse. A fit locates left-out loads to 2 mm, the "
        "given model to 1.5 mm. The largest error is that of load 3 (line 2), 9.88 mm. Keep the model, or check the "
        "loads and record more over the whole beam"
    )


def test_the_limit_of_these_loads_is_that_of_their_noise(nominal: NominalSurface) -> None:
    """The errors of places are normal, by the change of the readings beside that with an unknown force."""
    loads, curve = loads_on(nominal, PERFECT), nominal.curve(PERFECT)
    along, by_force = curve.moved_mm(loads.place_mm, loads.force_n)
    across = (along**2).sum(axis=1) - (along * by_force).sum(axis=1) ** 2 / (by_force**2).sum(axis=1)
    expected = np.mean(np.sqrt(2 / np.pi) * NOISE_MM / 20 / np.sqrt(across))
    steady = nominal.prior.at_noise(NOISE_MM / 20)
    assert calibrate.limit_mm(steady, loads, 3, 100) == pytest.approx(expected, rel=0.1)


def found_with(nominal: NominalSurface, weight_n: float, shift_mm: float) -> Fit:
    loads = loads_on(nominal, PERFECT)
    plain = fit(nominal, loads, (*nominal.kinds, *COMMON), rounds=1)
    vector, covariance = plain.vector.copy(), np.zeros_like(plain.covariance)
    for kind, value, error in ((WEIGHT, weight_n / 1.1, 0.1), (SHIFT, shift_mm / 8, 0.05)):
        place = plain.session.kinds[kind].start
        vector[place], covariance[place, place] = value, error**2
    return replace(plain, vector=vector, covariance=covariance)


def test_what_all_loads_share_is_told_with_its_side_and_its_error(nominal: NominalSurface) -> None:
    more, less = found_with(nominal, 0.33, 2.4), found_with(nominal, -0.33, -2.4)
    assert common_in_words(more, (WEIGHT,)) == {
        "forces": (
            "each load presses with 0.33 +- 0.11 N more than stated, as with a hanger or a pan that was not weighed; "
            "the fit allows for it"
        ),
        "places": (
            "perhaps each load stands 2.4 +- 0.4 mm farther right than stated, as if position_mm were not measured "
            "from the left end of the beam; the fit allows for it"
        ),
    }
    told = common_in_words(less, COMMON)
    assert told["forces"].startswith(
        "each load presses with 0.33 +- 0.11 N less than stated, as if the pan had lain on the beam"
    )
    assert told["places"].startswith("each load stands 2.4 +- 0.4 mm farther left than stated")
    assert common_in_words(replace(more, kinds=("gain",)), ()) == {}


NAMES = ["s1", "s2", "s3", "s4"]


def bent(nominal: NominalSurface, share: float, least_mm: float, is_in_volts: bool = False) -> str:
    """Return what is told of a bend of the third channel that takes `least_mm` off its largest deflection."""
    loads = loads_on(nominal, PERFECT)
    loads = replace(loads, force_n=loads.force_n * share, measured_mm=loads.measured_mm * share)
    plain = fit(replace(nominal, unit="V") if is_in_volts else nominal, loads, ("gain", bend_of(2)), rounds=1)
    vector = np.zeros(plain.session.size)
    vector[plain.session.kinds[bend_of(2)].start] = 1.0
    largest_mm = np.nanmax(plain.session.bends_mm(vector)[:, 2])
    return _bend_in_words(replace(plain, vector=vector * least_mm / largest_mm), bend_of(2), NAMES)


def test_a_channel_that_bends_is_told_if_that_does_harm(nominal: NominalSurface) -> None:
    """From 3 % of what it shows on, and from two noises on, which are 4 um."""
    shown_mm = float(np.nanmax(loads_on(nominal, PERFECT).measured_mm[:, 2]))
    assert bent(nominal, 1.0, 0.0299 * shown_mm) == bent(nominal, 1.0, -0.0299 * shown_mm) == ""
    assert bent(nominal, 1.0, 0.0301 * shown_mm) == (
        "s3 does not fit, as if its characteristic were another: where it shows 1.18 mm, the loads say 1.15 mm. Check "
        "its table, or measure one with feeler gauges, and record the loads again"
    )
    assert "shows 1.18 mm, the loads say 1.42 mm" in bent(nominal, 1.0, -0.2 * shown_mm)
    assert "1.18 V, the loads say 1.15 V. Check its table, or measure one, and" in bent(
        nominal, 1.0, 0.0301 * shown_mm, True
    )
    assert bent(nominal, 0.01, 0.00399) == ""
    assert bent(nominal, 0.01, 0.00401) != ""
