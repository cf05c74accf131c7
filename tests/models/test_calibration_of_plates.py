"""Calibration of a plate with known loads: springs, places of sensors, gains; loads and channels that are wrong."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from beamtouch_models.design.calibration.calibrate import checked_fit
from beamtouch_models.design.calibration.doubts import common_in_words
from beamtouch_models.design.calibration.fit import fit
from beamtouch_models.design.calibration.nominal_surface import NominalSurface
from beamtouch_models.design.calibration.recordings import EXCHANGED, Loads, read_loads
from beamtouch_models.design.calibration.session import Session
from beamtouch_models.design.calibration.swapped import OTHER_CORNER, swapped
from beamtouch_models.design.rows import RecordingError
from beamtouch_models.design.sweeps import silent
from beamtouch_models.lab.rig.surface import Imperfections
from beamtouch_models.runtime import ModelFile, load
from support.programs.in_process import Command
from support.surfaces.real_surfaces import random_imperfections, recorded, true_prior

pytestmark = pytest.mark.long


@pytest.fixture(scope="module")
def model(plate_model: Path) -> ModelFile:
    return load(plate_model)


@pytest.fixture(scope="module")
def real(model: ModelFile) -> Imperfections:
    return random_imperfections(model.metadata, np.random.default_rng([1, 7]))


@pytest.fixture(scope="module")
def loads(model: ModelFile, real: Imperfections) -> Loads:
    """Sixteen loads on a grid, heavy and light in turn, placed by hand."""
    rng = np.random.default_rng(5)
    plain = recorded(model.metadata, real, rng, count=4, hand_mm=0.3)
    lighter = np.where(np.arange(16) % 3, 1.0, 0.5)
    return replace(plain, force_n=plain.force_n * lighter, measured_mm=plain.measured_mm * lighter[:, None])


@pytest.mark.soak
@pytest.mark.promise(
    "docs/how-to/plates.md",
    "fits gains, the places of the sensors along both axes, each spring, a curved characteristic and offsets",
)
def test_sixteen_loads_tell_a_plate_with_the_errors_that_the_fit_states(
    model: ModelFile, real: Imperfections, loads: Loads
) -> None:
    checked = checked_fit(model, loads, silent)
    assert checked.before_mm.mean() > 1.5
    assert checked.after_mm.mean() < 0.8  # loads are placed to 0.3 mm along each axis, and 0.5 N of 11 are unknown
    assert not checked.sure

    places, fitted = model.metadata.extent.grid(49), checked.fit
    truth = true_prior(model.metadata, real).influence_at(places)
    influence = fitted.nominal.prior_with(fitted.departures).influence_at(places)
    plain = fitted.nominal.prior.influence_at(places)
    assert np.abs(influence - truth).mean() < 0.25 * np.abs(plain - truth).mean()

    errors, found = fitted.nominal.standard_errors(fitted.vector, fitted.spread), fitted.departures
    assert set(errors) == {"rigidity", "gain", "x", "y", "curve", "springs", "offset"}
    assert found.spring_stiffness is not None
    assert found.across_offset_mm is not None
    for kind, said, true in (
        ("springs", found.spring_stiffness, real.spring_stiffness),
        ("x", found.position_offset_mm, real.x_offset_mm),
        ("y", found.across_offset_mm, real.y_offset_mm),
    ):
        assert np.all(np.abs(np.array(said) - np.array(true)) < 3.5 * errors[kind]), kind


@pytest.mark.promise(
    "docs/how-to/plates.md",
    "A load that contradicts the others",
)
@pytest.mark.soak
def test_a_mistyped_load_on_a_plate_is_named(model: ModelFile, loads: Loads) -> None:
    place_mm = loads.place_mm.copy()
    place_mm[6, 1] += 40
    with pytest.raises(RecordingError, match=r"load 7 \(lines 1202 to 1401\) says \(.*\) mm and .* N, but the other"):
        checked_fit(model, replace(loads, place_mm=place_mm), silent)


@pytest.mark.promise(
    "docs/how-to/plates.md",
    "a pan that was not weighed",
)
def test_a_pan_and_a_shift_of_all_loads_are_said_with_their_sizes(model: ModelFile, loads: Loads) -> None:
    nominal = NominalSurface.of(model.metadata)
    wrong = replace(loads, force_n=loads.force_n - 1.0, place_mm=loads.place_mm - np.array([6.0, -4.0]))
    found = fit(nominal, wrong, (*Session(nominal, wrong).usual_kinds, "weight", "shift"))
    told = common_in_words(found, ("weight", "shift"))
    assert found.session.weight_n(found.vector) == pytest.approx(1.0, abs=0.2)
    assert found.session.shift_mm(found.vector) == pytest.approx([6.0, -4.0], abs=1.0)
    assert "mm farther right and" in told["places"]
    assert "mm farther down than stated, as if x_mm and y_mm were not measured from the lower left" in told["places"]


@pytest.mark.promise(
    "docs/how-to/plates.md",
    "swapped cables, and places that are measured from another corner are named as for a beam.",
)
@pytest.mark.soak
def test_another_corner_and_swapped_cables_are_named(model: ModelFile, loads: Loads) -> None:
    nominal, names = NominalSurface.of(model.metadata), list(model.channels)
    other = replace(loads, place_mm=np.array([400.0, 0.0]) + np.array([-1.0, 1.0]) * loads.place_mm)
    assert swapped(nominal, other, names) == OTHER_CORNER
    crossed = replace(loads, measured_mm=loads.measured_mm[:, [1, 0, 2, 3]])
    inside = loads[np.all(loads.place_mm <= 290, axis=1)]
    exchanged = replace(inside, place_mm=inside.place_mm[:, ::-1])
    assert swapped(nominal, exchanged, names) == EXCHANGED
    assert "s1 and s2 seem to be swapped" in (swapped(nominal, crossed, names) or "")
    assert swapped(nominal, loads, names) is None


def test_a_file_of_a_beam_and_places_off_the_range_are_refused(model: ModelFile, tmp_path: Path) -> None:
    path = tmp_path / "loads.csv"
    columns = ",".join(f"{name}_deflection_mm" for name in model.channels)
    path.write_text(f"load,position_mm,force_n,{columns}\n1,100,10,0.1,0.1,0.1,0.1\n")
    with pytest.raises(RecordingError, match="column x_mm is missing; this model needs the columns load, x_mm, y_mm,"):
        read_loads(path, model.metadata)
    rows = [f"{number},{x},100,10,0.1,0.1,0.1,0.1" for number, x in enumerate((5, 100, 200, 300)) for _ in range(6)]
    path.write_text("\n".join([f"load,x_mm,y_mm,force_n,{columns}", *rows, ""]))
    with pytest.raises(RecordingError, match=r"load 0 at \(5, 100\) mm is not within 10..390 by 10..290 mm"):
        read_loads(path, model.metadata)
    exchanged = [
        f"{number},{x},{y},10,0.1,0.1,0.1,0.1" for number, x, y in ((1, 100, 350), (2, 30, 30)) for _ in range(6)
    ]
    path.write_text("\n".join([f"load,x_mm,y_mm,force_n,{columns}", *exchanged, ""]))
    with pytest.raises(
        RecordingError, match=r"load 1 at .* 10..290 mm; the columns x_mm and y_mm seem to be exchanged"
    ):
        read_loads(path, model.metadata)
    path.write_text("\n".join([f"load,x_mm,y_mm,force_n,{columns}", *rows[6:], *rows[-6:], ""]).replace("\n3,", "\n4,"))
    with pytest.raises(RecordingError, match="different places over 0% of the range cannot determine a fit"):
        read_loads(path, model.metadata)


@pytest.mark.promise(
    "docs/how-to/plates.md",
    "`calibrate --events` refuses a plate.",
)
def test_contacts_of_unknown_places_are_for_one_axis(
    design_sensors_here: Command, plate_model: Path, tmp_path: Path
) -> None:
    events = tmp_path / "contacts.csv"
    events.write_text("event\n")
    done = design_sensors_here("calibrate", plate_model, "--events", events, "-o", tmp_path / "new.onnx")
    assert done.returncode == 2
    assert (
        "contacts of unknown place and force do not tell the springs of a plate from gains; record known" in done.stderr
    )
