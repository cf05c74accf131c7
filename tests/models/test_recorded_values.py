"""What the files of a calibration become: means, deviations and times of loads, and the ends of what is taken.

The model is that of a beam of 400 mm with contacts at 1 to 399 mm and 1 to 20 N, which deflects by 1 mm at most.
"""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest

from beamtouch_models.design.calibration.recordings import (
    Loads,
    UnlabelledContacts,
    may_be_exchanged,
    read_contacts,
    read_loads,
)
from beamtouch_models.design.rows import RecordingError
from beamtouch_models.places import Extent
from beamtouch_models.runtime.metadata import Metadata
from support.surfaces.small_model import PLATE_OUTPUTS, model_of

NOISE_MM = 0.06
BEAM = model_of("bench", channels=3, noise_mm=NOISE_MM).metadata
PLATE = model_of("plate", channels=3, outputs=PLATE_OUTPUTS).metadata
HEAD = "unix_time_s,load,position_mm,force_n,s1_deflection_mm,s1_quality,s2_deflection_mm,s3_deflection_mm"
Row = tuple[object, ...]


def read(path: Path, rows: Sequence[Row], head: str = HEAD, metadata: Metadata = BEAM, *left_out: int) -> Loads:
    path.write_text("\n".join([head, *(",".join(map(str, row)) for row in rows)]) + "\n")
    return read_loads(path, metadata, left_out)


def loads_at(
    places: Sequence[float], force_n: float = 7.0, shown: float = 0.25, samples: int = 5, every_s: float = 40.0
) -> list[Row]:
    """Rows of a load at each place."""
    return [
        (1000.0 + every_s * load, load, place, force_n, shown, "good", 0.125, 0.5)
        for load, place in enumerate(places, start=1)
        for _ in range(samples)
    ]


def test_a_load_is_the_mean_of_its_good_samples_and_known_as_well_as_so_many_readings(tmp_path: Path) -> None:
    rows = loads_at([30.0, 150.0, 260.0, 380.0])
    # The second load has a sample more, and two of the first channel are not good or missing; the last comes first.
    rows[5:10] = [
        (1080.0 + 7.0 * number, 2, 150.0, 11.0, shown, quality, 0.1 * number, 0.5)
        for number, (shown, quality) in enumerate(
            [(0.1, "good"), (0.7, "stuck"), (0.2, "good"), ("", "good"), (0.6, "good"), (0.3, "good"), (0.4, "good")]
        )
    ]
    rows[-5:] = [(*row[:6], "", row[7]) for row in rows[-5:]]
    rows = [*rows[-5:], *rows[:-5]]
    found = read(tmp_path / "loads.csv", rows)
    assert found.number.tolist() == [1, 2, 3, 4]
    assert found.place_mm.tolist() == [[30.0], [150.0], [260.0], [380.0]]
    assert found.force_n.tolist() == [7.0, 11.0, 7.0, 7.0]
    assert found.measured_mm[1] == pytest.approx([(0.1 + 0.2 + 0.6 + 0.3 + 0.4) / 5, 0.3, 0.5])
    assert found.measured_mm[0] == pytest.approx([0.25, 0.125, 0.5])
    assert np.isnan(found.measured_mm[3]).tolist() == [False, True, False]
    assert found.deviation_mm[1] == pytest.approx(NOISE_MM / np.sqrt([5, 7, 7]))
    assert found.deviation_mm[0] == pytest.approx(NOISE_MM / np.sqrt([5, 5, 5]))
    assert np.isfinite(found.deviation_mm).all()
    assert found.lines.tolist() == [[7, 11], [12, 18], [19, 23], [2, 6]]
    # 1040, 1101, 1120 and 1160 s
    assert found.minutes == pytest.approx([0.0, 61 / 60, 80 / 60, 2.0])
    assert (found.errors.placing_mm, found.errors.force, found.errors.residual_mm) == (1.0, 0.01, 0.0)
    assert [found.in_words(index) for index in (0, 3)] == ["load 1 (lines 7 to 11)", "load 4 (lines 2 to 6)"]
    kept = found.without(0, 2)
    assert kept.number.tolist() == [2, 4]
    assert (kept.place_mm[:, 0].tolist(), kept.lines.tolist()) == ([150.0, 380.0], [[12, 18], [2, 6]])
    single = Loads(**{**vars(found), "lines": np.array([[4, 4]] * 4)})
    assert single.in_words(2) == "load 3 (line 4)"


def test_four_samples_are_too_few_for_a_channel_and_a_load_may_be_left_out(tmp_path: Path) -> None:
    rows = loads_at([30.0, 150.0, 260.0, 380.0, 390.0])
    four = [*rows[:3], (*rows[3][:4], "", *rows[3][5:]), *rows[4:]]
    found = read(tmp_path / "loads.csv", four)
    assert np.isnan(found.measured_mm).tolist() == [[True, False, False], *[[False] * 3] * 4]
    left = read(tmp_path / "loads.csv", rows, HEAD, BEAM, 2)
    assert left.number.tolist() == [1, 3, 4, 5]
    with pytest.raises(RecordingError, match=r"loads\.csv: no load 9 to leave out; the loads are 1, 2, 3, 4, 5$"):
        read(tmp_path / "loads.csv", rows, HEAD, BEAM, 2, 9)


@pytest.mark.parametrize(
    ("every_s", "last_min"), [(28_799.0, 1439.95), (28_801.0, 0.0), (-28_799.0, 0.0), (float("nan"), 0.0)]
)
def test_a_recording_of_more_than_a_day_has_no_times(tmp_path: Path, every_s: float, last_min: float) -> None:
    found = read(tmp_path / "loads.csv", loads_at([30.0, 150.0, 260.0, 380.0], every_s=every_s))
    assert found.minutes[-1] == pytest.approx(last_min)
    assert found.minutes[0] == pytest.approx(1439.95 if every_s < 0 else 0.0)


def test_without_a_column_of_times_there_are_none(tmp_path: Path) -> None:
    rows = [row[1:] for row in loads_at([30.0, 150.0, 260.0, 380.0])]
    assert read(tmp_path / "loads.csv", rows, HEAD.removeprefix("unix_time_s,")).minutes.tolist() == [0.0] * 4


def test_a_load_has_one_place_and_one_force_and_a_file_all_its_columns(tmp_path: Path) -> None:
    rows, path = loads_at([30.0, 150.0, 260.0, 380.0]), tmp_path / "loads.csv"
    rows[7] = (*rows[7][:3], 8.5, *rows[7][4:])
    with pytest.raises(RecordingError, match=r"load 2 has a force_n of 7 in line 7 and of 8.5 in line 9; give each"):
        read(path, rows)
    with pytest.raises(
        RecordingError, match="column force_n is missing; this model needs the columns load, position_mm"
    ):
        read(path, rows, HEAD.replace("force_n", "force").replace("s3_deflection_mm", "s3"))


SPREAD = [1.0, 60.0, 110.0, 161.0]
"""Four places over 0.402 of the range."""


@pytest.mark.parametrize(
    ("rows", "said"),
    [
        (loads_at(SPREAD), ""),
        (loads_at([1.0, 60.0, 110.0, 159.0]), "4 different positions over 40% of the range cannot determine a fit; "),
        (loads_at([399.0, 250.0, 1.0]), "3 different positions over 100% of the range cannot determine a fit; record"),
        (loads_at([399.0, 250.0, 1.0, 1.0]), "at least 4, preferably 10, spread over the whole beam"),
        (loads_at([399.0, 250.0, 120.0, 1.0]), ""),
        (loads_at([399.5, 250.0, 120.0, 1.0]), "load 1 at 399.5 mm is not within 1..399 mm"),
        (loads_at([399.0, 250.0, 120.0, 0.5]), "load 4 at 0.5 mm is not within 1..399 mm"),
        (loads_at(SPREAD, force_n=0.001), ""),
        (
            loads_at(SPREAD, force_n=0.00099),
            "load 1 (lines 2 to 6) has a force of 0.00099 N, but the model is for 1..20 N; correct it, or use "
            "--leave-out 1",
        ),
        (loads_at(SPREAD, force_n=20_000.0), ""),
        (loads_at(SPREAD, force_n=20_001.0), "a force of 20001 N"),
        (loads_at(SPREAD, force_n=0.0), "a force of 0 N"),
        (loads_at(SPREAD, shown=100.0), ""),
        (loads_at(SPREAD, shown=-100.0), ""),
        (
            loads_at(SPREAD, shown=-100.5),
            "s1 states -100.5 mm in line 2, but this surface deflects by 1 mm at most; check the unit and the",
        ),
        (loads_at(SPREAD, samples=4), "no load has 5 good samples of a channel; each load needs 5 rows or more"),
        (
            [*loads_at(SPREAD), *[(*row[:1], 5, *row[2:]) for row in loads_at([200.0], samples=4)]],
            "load 5 (lines 22 to 25) has fewer than 5 good samples of each channel; record it again, or use "
            "--leave-out 5",
        ),
        ([(*row[:6], "", row[7]) for row in loads_at(SPREAD)], "s2 has no good samples; check it and record again"),
    ],
)
def test_loads_are_taken_up_to_the_ends_of_what_a_fit_can_use(tmp_path: Path, rows: list[Row], said: str) -> None:
    path = tmp_path / "loads.csv"
    if not said:
        assert len(read(path, rows).number) == 4
        return
    with pytest.raises(RecordingError) as refused:
        read(path, rows)
    assert str(refused.value).startswith(f"{path}: ")
    assert said in str(refused.value)


PLATE_HEAD = "load,x_mm,y_mm,force_n,s1_deflection_mm,s2_deflection_mm,s3_deflection_mm"


def on_plate(places: Sequence[tuple[float, float]]) -> list[Row]:
    return [(load, *place, 7.0, 0.1, 0.2, 0.3) for load, place in enumerate(places, start=1) for _ in range(5)]


def test_loads_on_a_plate_are_spread_along_both_of_its_axes(tmp_path: Path) -> None:
    path, places = tmp_path / "loads.csv", [(10.0, 20.0), (200.0, 200.0), (390.0, 50.0), (120.0, 150.0)]
    assert read(path, on_plate(places), PLATE_HEAD, PLATE).place_mm.tolist() == [list(place) for place in places]
    with pytest.raises(RecordingError, match=r"4 different places over 30% of the range .* preferably 12, .* plate$"):
        read(path, on_plate([(x, min(y, 110.0)) for x, y in places]), PLATE_HEAD, PLATE)
    # y goes to 299 mm only; all of them would be on the plate with their axes exchanged.
    exchanged = r"load 3 at \(50, 390\) mm is not within 1..399 by 1..299 mm; the columns x_mm and y_mm seem to be"
    with pytest.raises(RecordingError, match=exchanged):
        read(path, on_plate([(y, x) for x, y in places]), PLATE_HEAD, PLATE)
    with pytest.raises(RecordingError, match=r"is not within 1..399 by 1..299 mm$"):
        read(path, on_plate([*places[:3], (350.0, 320.0)]), PLATE_HEAD, PLATE)
    with pytest.raises(RecordingError, match=r"column y_mm is missing; this model needs the columns load, x_mm, y_mm"):
        read(path, on_plate(places), PLATE_HEAD.replace("y_mm", "z_mm"), PLATE)


@pytest.mark.parametrize(
    ("place", "possible"),
    [((1.0, 399.0), True), ((1.0, 400.0), False), ((0.5, 30.0), False), ((299.0, 1.0), True), ((299.5, 9.0), False)],
)
def test_axes_may_be_exchanged_if_all_would_be_on_the_plate(place: tuple[float, float], possible: bool) -> None:
    plate = Extent(((1.0, 399.0), (1.0, 299.0)))
    assert may_be_exchanged(plate, np.array([[20.0, 30.0], place])) is possible
    assert may_be_exchanged(Extent.of_beam((1.0, 399.0)), np.array([[20.0]])) is False


def contact_rows(metadata: Metadata, cells: str, rests: str = "") -> str:
    ends = [f"{name.name}_{end}" for end in ("mm", "sd_mm") for name in metadata.layout]
    rest = [f"{name.name}_{end}" for end in ("rest_mm", "rest_sd_mm") for name in metadata.layout] if rests else []
    head = ",".join(["event", "time", "model", "characteristic", *ends, *rest])
    return f"{head}\n1,2026-11-22T00:00:00.000Z,{metadata.name}@abc,a1,{cells}{rests}\n"


def contacts_of(path: Path, cells: str, rests: str = "") -> UnlabelledContacts:
    path.write_text(contact_rows(BEAM, cells, rests))
    return read_contacts(path, BEAM)


def test_a_contact_has_its_means_deviations_and_the_rest_before_it(tmp_path: Path) -> None:
    found = contacts_of(tmp_path / "one.csv", "0.5,-100,0.25,0.01,100,1e-9", ",0.1,,100,0.2,0.3,")
    assert found.measured_mm.tolist() == [[0.5, -100.0, 0.25]]
    # No mean is steadier than a millionth of the largest deflection.
    assert found.deviation_mm[0] == pytest.approx([0.01, 100.0, 1e-6], rel=1e-12)
    assert found.rest_mm is not None
    assert np.array_equal(found.rest_mm, [[[0.1, np.nan, 100.0], [0.2, 0.3, np.nan]]], equal_nan=True)
    assert len(found) == 1
    unseen = contacts_of(tmp_path / "one.csv", "0.5,0.5,0.25,0.01,0.01,0.01").rest_mm
    assert unseen is not None
    assert np.isnan(unseen).all()


@pytest.mark.parametrize(
    ("cells", "rests", "said"),
    [
        ("0.5,100.5,0.25,0.1,0.1,0.1", "", r"line 2: s2 states 100.5 \+- 0.1 mm, but this surface deflects by 1 mm at"),
        ("0.5,0.5,0.25,0.1,0.1,100.5", "", r"s3 states 0.25 \+- 100.5 mm, but"),
        ("0.5,0.5,0.25,0.1,0,0.1", "", "s2 must have a finite deflection and a positive finite deviation"),
        ("0.5,0.5,0.25,0.1,inf,0.1", "", "s2 must have a finite"),
        ("0.5,inf,0.25,0.1,0.1,0.1", "", "s2 must have a finite"),
        (
            "0.5,0.5,0.25,0.1,0.1,0.1",
            ",0,-100.5,0,0,0,0",
            "the rest before it is larger than any deflection; check the",
        ),
    ],
)
def test_contacts_are_taken_up_to_a_hundred_times_the_largest_deflection(
    tmp_path: Path, cells: str, rests: str, said: str
) -> None:
    with pytest.raises(RecordingError, match=said):
        contacts_of(tmp_path / "one.csv", cells, rests)


def test_contacts_of_another_surface_are_refused_by_their_columns(tmp_path: Path) -> None:
    path = tmp_path / "one.csv"
    head, row = contact_rows(BEAM, "0.5,0.5,0.25,0.1,0.1,0.1").splitlines()
    for text, said in (
        (
            f"{head.replace('s2_sd_mm', 'x').replace('s3_mm', 'y')}\n{row}\n",
            "column s3_mm is missing; fetch the contacts",
        ),
        (
            f"{head},s9_sd_mm,s1_rest_sd_mm,s8_sd_mm\n{row},1,1,1\n",
            "it has a channel s9, which this model has not; fetch the contacts of its surface",
        ),
        (f"{head}\n", "no contacts; fetch them with GET /surfaces/NAME/calibration-data"),
    ):
        path.write_text(text)
        with pytest.raises(RecordingError) as refused:
            read_contacts(path, BEAM)
        assert str(refused.value).startswith(f"{path}: {said}")


def test_noise_zeros_and_what_is_left_add_as_independent_errors_do() -> None:
    contacts = UnlabelledContacts(np.array([[60.0, 0.0], [-60.0, 30.0]]), np.array([[3.0, 3.0], [1.0, 6.0]]))
    noise_mm = contacts.noise_mm(np.array([4.0, 0.0]), 0.2)
    assert noise_mm == pytest.approx(np.array([[13.0, 3.0], [np.sqrt(161), np.sqrt(72)]]))


@pytest.mark.parametrize(("rest_mm", "moved"), [(31.9, []), (32.1, [1]), (-31.9, []), (-32.1, [1])])
def test_a_zero_moved_if_rests_surely_differ_by_more_than_four_drifts(rest_mm: float, moved: list[int]) -> None:
    """Four deviations of 1 and of 2 may be noise, and four drifts of 5 are usual: together 32."""
    rests = np.array([[[0.0, 0.0], [1.0, 1.0]], [[9.0, rest_mm], [2.0, 2.0]], [[99.0, 99.0], [1.0, np.nan]]])
    contacts = UnlabelledContacts(np.ones((3, 2)), np.ones((3, 2)), rest_mm=rests)
    drift_mm = np.array([5.0, 5.0])
    assert contacts.moved_zeros(drift_mm).tolist() == moved
    assert UnlabelledContacts(np.ones((3, 2)), np.ones((3, 2))).moved_zeros(drift_mm).tolist() == []
    unseen = UnlabelledContacts(np.ones((1, 2)), np.ones((1, 2)), rest_mm=np.full((1, 2, 2), np.nan))
    assert unseen.moved_zeros(drift_mm).tolist() == []
