"""Contacts of unknown place and force that are refused: too few, of another beam, or not of single contacts."""

import dataclasses
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from beamtouch_models import modelfile
from beamtouch_models.calibration.contacts import UnlabelledContacts
from beamtouch_models.calibration.left_open import HeldOut
from beamtouch_models.calibration.refusals import check_held_out
from beamtouch_models.calibration.self_calibrate import self_fit
from beamtouch_models.calibration.theory import FIXITY
from beamtouch_models.errors import NotGoodEnoughError
from beamtouch_models.modelfile import ModelFile
from beamtouch_models.progress import silent
from in_process import Command
from unlabelled_contacts import OFF, Kind, drawn, fitted, missed_mm, surface, write_contacts

pytestmark = pytest.mark.long


@pytest.mark.parametrize("kind", [Kind(fixity=(0.1, 0.1)), dataclasses.replace(OFF, fixity=(0.1, 0.1))])
def test_fixed_ends_are_refused_with_the_reason(bench: ModelFile, kind: Kind) -> None:
    for seed in range(2):
        with pytest.raises(NotGoodEnoughError, match=r"the beam itself is not as modelled.* ends were fixed by 0\.\d"):
            fitted(bench, kind, seed)


def test_a_fixity_is_told_with_its_error(bench: ModelFile) -> None:
    with pytest.raises(NotGoodEnoughError) as refused:
        fitted(bench, Kind(gain=0.0, fixity=(0.2, 0.0)), 0)
    left = float(str(refused.value).split("fixed by ")[1].split(" +- ")[0])
    assert left == pytest.approx(0.2, abs=FIXITY)


def test_20_contacts_are_better_than_none_or_refused(bench: ModelFile) -> None:
    accepted = 0
    for seed in range(6):
        try:
            one, real = fitted(bench, Kind(), seed, 20)
        except NotGoodEnoughError:
            continue
        accepted += 1
        theory = one.fit.theory
        before, after = (missed_mm(theory, vector, bench.metadata, real) for vector in (one.fit.start, one.fit.vector))
        assert after < before, seed
    assert accepted >= 3


def test_contacts_at_one_place_are_refused(bench: ModelFile) -> None:
    with pytest.raises(NotGoodEnoughError, match="determines no fit"):
        fitted(bench, Kind(places_mm=(150.0,)), 1)


def test_swapped_channels_are_refused(bench: ModelFile) -> None:
    real = surface(bench.metadata, OFF, np.random.default_rng(1))
    contacts = drawn(bench.metadata, real, OFF, np.random.default_rng(2), 100)
    swapped = dataclasses.replace(contacts, measured_mm=contacts.measured_mm[:, [1, 0, 2, 3]])
    with pytest.raises(NotGoodEnoughError, match="do not fit this model's surface"):
        self_fit(bench, swapped, silent)


def test_contacts_that_determine_less_than_the_model_states_are_refused(bench: ModelFile) -> None:
    with pytest.raises(NotGoodEnoughError, match=r"12 contacts determine too little.* record more, over the whole"):
        fitted(bench, Kind(gain=0.0), 0, 12)


@pytest.mark.parametrize(
    ("found", "reason"),
    [
        (HeldOut(before=9.0, after=2.0, expected=1.0, beyond=1.2), r"not as modelled.* 1\.2 times the largest"),
        (HeldOut(before=1.2, after=1.6, expected=1.0, beyond=0.5), r"would be worse.* 1\.6, by the given model 1\.2"),
    ],
)
def test_left_out_contacts_that_contradict_a_fit_refuse_it(found: HeldOut, reason: str) -> None:
    with pytest.raises(NotGoodEnoughError, match=reason):
        check_held_out(found)


def test_left_out_contacts_by_chance_a_little_worse_refuse_nothing() -> None:
    check_held_out(HeldOut(before=1.2, after=1.4, expected=1.0, beyond=0.9))


def test_two_channels_are_too_few(built_model: Callable[[str], Path]) -> None:
    model = modelfile.load(built_model("bench"))
    layout = model.metadata.layout[:2]
    two = dataclasses.replace(model, metadata=model.metadata.model_copy(update={"layout": layout}))
    with pytest.raises(NotGoodEnoughError, match=r"2 channels fit a contact of any place and force.* it takes 3"):
        self_fit(two, UnlabelledContacts(np.ones((50, 2)), np.ones((50, 2))), silent)


def test_a_refusal_writes_nothing(
    design_sensors_here: Command, bench_model: Path, bench: ModelFile, tmp_path: Path
) -> None:
    real = surface(bench.metadata, OFF, np.random.default_rng(1))
    contacts = drawn(bench.metadata, real, OFF, np.random.default_rng(2), 11)
    path, output = write_contacts(tmp_path / "contacts.csv", bench, contacts), tmp_path / "new.onnx"
    done = design_sensors_here("calibrate", bench_model, "--events", path, "-o", output, "--json")
    assert (done.returncode, done.stdout) == (1, "")
    assert "11 contacts are too few" in done.stderr
    assert not output.exists()


@pytest.mark.parametrize("given", [[], ["loads.csv", "--events", "contacts.csv"]])
def test_loads_or_contacts_but_not_both(design_sensors_here: Command, bench_model: Path, given: list[str]) -> None:
    done = design_sensors_here("calibrate", bench_model, *given, "-o", "new.onnx")
    assert (done.returncode, done.stdout) == (2, "")
    assert "READINGS.csv" in done.stderr
