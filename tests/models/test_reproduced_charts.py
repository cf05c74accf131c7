"""The charts of the reproduction: what each curve shows, and what belongs together has one colour."""

import json
from collections import defaultdict

import numpy as np
import pytest

from beamtouch_models.design.charts import Series
from beamtouch_models.lab.reproduction.figure_8 import COUNTS, DRAWS, LIMIT_DRAWS, NETWORKS, NOISES_PERCENT, figure_8
from beamtouch_models.lab.reproduction.figures import (
    PRINTED_PITCH_MM,
    figure_2,
    figure_3,
    figure_4,
    figure_7,
    misprints,
)
from beamtouch_models.lab.reproduction.paper import (
    LOADS_MM,
    Figure,
    Row,
    deflection_mm,
    dimensionless,
    equal_pitch_mm,
    rounded,
    rows_of,
)
from beamtouch_models.lab.reproduction.reproduce import Reproduction


def curves(figure: Figure) -> dict[str, Series]:
    return {series.label: series for series in figure.chart.series}


def together(figure: Figure) -> list[list[str]]:
    """Return the curves that have one colour, in the order of the colours."""
    groups = defaultdict[int, list[str]](list)
    for series in figure.chart.series:
        groups[series.colour].append(series.label)
    return [groups[colour] for colour in sorted(groups)]


def test_figure_2_is_the_stated_line_and_levels_off_beyond() -> None:
    figure = figure_2()
    output, line = figure.chart.series
    assert (output.style, line.style, output.colour == line.colour) == ("line", "dashed", False)
    gap, percent = np.array(output.x), np.array(output.y)
    assert (gap[0], gap[-1], len(gap)) == (0.0, 5.0, 501)
    # 10 to 90 % of the scale over the range from 1 to 4 mm.
    inside = (gap >= 1) & (gap <= 4)
    assert percent[inside] == pytest.approx(10 + 80 * (gap[inside] - 1) / 3, abs=0.002)
    assert list(line.x) == [0.5, 4.5]
    assert list(line.y) == pytest.approx([10 - 40 / 3, 90 + 40 / 3], abs=0.002)
    assert figure.numbers["straight_mm"] == pytest.approx([1, 4], abs=0.06)
    assert 0 < figure.numbers["departure_percent"] < 0.002
    assert [row.verdict for row in figure.rows] == ["agrees"]


def test_figure_3_has_four_components_and_what_they_mean() -> None:
    figure = figure_3()
    assert list(curves(figure)) == [f"component {number}" for number in (1, 2, 3, 4)]
    assert len(together(figure)) == 4
    numbers, matrix = figure.numbers, dimensionless(equal_pitch_mm(8))
    vectors = np.linalg.eigh(matrix.T @ matrix)[1][:, ::-1]
    shown = matrix @ vectors
    spans = np.ptp(shown, axis=0)
    assert numbers["spans_over_first"] == pytest.approx(spans / spans[0], rel=1e-4)
    for number, series in enumerate(figure.chart.series):
        assert list(series.x) == LOADS_MM.tolist()
        assert np.abs(series.y) == pytest.approx(np.abs(shown[:, number]), rel=1e-4, abs=1e-9)
    # Two loads whose first two components are nearest to each other; neighbours, as it happens.
    apart = float(np.linalg.norm(np.diff(shown[:, :2], axis=0), axis=1).min())
    assert numbers["apart"] == pytest.approx(apart, rel=1e-4)
    assert numbers["apart_percent"] == pytest.approx(100 * 48 * apart, rel=1e-4)
    assert numbers["size_correlation"] == pytest.approx(
        np.corrcoef(np.abs(shown[:, 0]), np.linalg.norm(matrix, axis=1))[0, 1], abs=1e-6
    )
    assert numbers["even_part"] < 1e-9
    assert [row.verdict for row in figure.rows if row.paper] == ["agrees"] * 3


def test_figure_4_has_points_with_their_fit_in_one_colour_and_both_axes_are_logarithmic() -> None:
    figure = figure_4(0)
    weak, weak_fit, strong, strong_fit = figure.chart.series
    assert (weak.colour, strong.colour) == (weak_fit.colour, strong_fit.colour)
    assert weak.colour != strong.colour
    assert [series.style for series in figure.chart.series] == ["points", "line", "points", "line"]
    assert (figure.chart.log_x, figure.chart.log_y) == (True, True)
    for points, fit, factor, exponent, noise in zip(
        (weak, strong), (weak_fit, strong_fit), figure.numbers["A"], figure.numbers["B"], (2, 10), strict=True
    ):
        assert list(points.x) == list(fit.x) == list(range(1, 9))
        assert list(fit.y) == pytest.approx([factor * number**exponent for number in range(1, 9)], rel=1e-5)
        assert fit.label == f"{noise} % noise: y = {factor:.2f} x^{exponent:.2f}"
        # A least-squares line through logarithms leaves residues that neither the constant nor the slope explains.
        rest = np.log(points.y) - np.log(fit.y)
        assert rest.sum() == pytest.approx(0, abs=1e-4)
        assert rest @ np.log(range(1, 9)) == pytest.approx(0, abs=1e-4)
    first, second = (np.array(percent) for percent in figure.numbers["error_percent"])
    assert list(weak.y) == pytest.approx(first)
    assert figure.numbers["times"] == pytest.approx([(second / first).min(), (second / first).max()], rel=1e-5)
    assert figure.numbers["times"] == pytest.approx([5, 5], rel=0.05)
    assert figure.numbers["larger"] == [int((first < 100).sum()), int((second < 100).sum())]
    assert figure.numbers["four_up_to_percent"] == pytest.approx(200 / first[3], rel=1e-5)


def test_figure_7_has_both_layouts_of_a_component_in_one_colour_over_its_peak() -> None:
    figure = figure_7(np.array([68.0, 156.0, 244.0, 332.0]))
    assert together(figure) == [[f"component {n}, equal pitch", f"component {n}, optimised"] for n in (1, 2, 3, 4)]
    for number in (1, 2, 3, 4):
        equal, best = (curves(figure)[f"component {number}, {how}"] for how in ("equal pitch", "optimised"))
        assert (equal.style, best.style) == ("dashed", "line")
        assert np.abs(equal.y).max() == pytest.approx(1, rel=1e-6)
        change = figure.numbers["change_percent"][number - 1]
        assert np.abs(best.y).max() == pytest.approx(1 + change / 100, rel=1e-5)
        assert np.dot(equal.y, best.y) > 0  # not mirrored
    from_eight = figure.numbers["from_eight_percent"]
    peaks = [np.abs(shown_by(places)).max(axis=0) for places in (equal_pitch_mm(8), np.array([68.0, 156, 244, 332]))]
    assert from_eight == pytest.approx(100 * (peaks[1] / peaks[0] - 1), rel=1e-4)


@pytest.mark.parametrize(
    ("places", "verdicts"),
    [
        ([80.0, 160.0, 240.0, 320.0], "differs differs differs differs"),  # at equal pitch itself, nothing changes
        ([20.0, 50.0, 350.0, 380.0], None),
        ([150.0, 180.0, 220.0, 250.0], None),
        ([60.0, 150.0, 250.0, 340.0], None),
        ([75.0, 158.0, 242.0, 325.0], None),
    ],
)
def test_figure_7_agrees_where_peaks_change_as_the_paper_says(places: list[float], verdicts: str | None) -> None:
    figure = figure_7(np.array(places))
    equal, best = (np.abs(shown_by(np.array(one))).max(axis=0) for one in (equal_pitch_mm(4), places))
    first, second, third, fourth = 100 * (best / equal - 1)
    agree = (first < -10, -10 < second < 0, -10 < third < 0, fourth > 0)
    expected = verdicts or " ".join("agrees" if one else "differs" for one in agree)
    assert " ".join(row.verdict for row in figure.rows) == expected
    assert figure.numbers["change_percent"] == pytest.approx([first, second, third, fourth], abs=1e-3)
    assert figure.numbers["positions_mm"] == {"equal": [80.0, 160.0, 240.0, 320.0], "optimised": places}


def shown_by(places: np.ndarray) -> np.ndarray:
    """Return the four leading components of a layout by numpy's symmetric solver."""
    matrix = dimensionless(places)
    shown: np.ndarray = matrix @ np.linalg.eigh(matrix.T @ matrix)[1][:, ::-1][:, :4]
    return shown


RIG = np.array([4.67, 3.28, 4.0, 3.2, 3.5, 3.18, 3.13, 3.16])
"""Errors that the paper measured with two and five sensors, and some between."""


def eighth(rig: np.ndarray = RIG, **changed: object) -> Figure:
    """Return figure 8 of errors that grow evenly with the noise up to those of the rig, from a fifth of them."""
    noises = np.array(NOISES_PERCENT)
    measured: dict[str, object] = {
        "error_at_noise_percent": rig[:, None] * (0.2 + 0.4 * noises), "theoretical_percent": 0.2 * rig,
        "rig_percent": rig, "rig_spread_percent": np.full(8, 0.1), "limit_percent": np.linspace(3, 1, 8),
        "limit_standard_error": np.full(8, 0.01), "noise_trained_percent": np.full(8, 2.0), "networks": 24,
        "reached": 24, "epochs": [700, 900],
    }  # fmt: skip
    return figure_8(measured | changed)


def verdict(figure: Figure, start: str) -> str:
    (row,) = (row for row in figure.rows if row.quantity.startswith(start))
    return row.verdict


def test_figure_8_has_the_curves_of_each_layout_and_the_papers_points() -> None:
    shown = curves(eighth())
    assert (COUNTS, NETWORKS, DRAWS, LIMIT_DRAWS) == ((2, 3, 4, 5), 3, 40_000, 8_192)
    for place, layout in enumerate(("equal pitch", "optimised")):
        rig, limit = shown[f"rig, 2 % noise: {layout}"], shown[f"limit at that noise: {layout}"]
        theory, paper = shown[f"theory: {layout}"], shown[f"measured by the paper: {layout}"]
        assert list(rig.x) == list(limit.x) == list(theory.x) == [2, 3, 4, 5]
        assert list(rig.y) == pytest.approx(RIG[place::2])
        assert list(limit.y) == pytest.approx(np.linspace(3, 1, 8)[place::2])
        assert list(theory.y) == pytest.approx(0.2 * RIG[place::2])
        assert (list(paper.x), list(paper.y)) == ([2, 5], [RIG[place], RIG[6 + place]])
        assert rig.colour == limit.colour == paper.colour != theory.colour
        assert [one.style for one in (rig, limit, theory, paper)] == ["line", "dashed", "line", "points"]
    assert len(together(eighth())) == 4
    chart = eighth().chart
    assert (chart.y_from_zero, chart.whole_x) == (True, True)
    assert chart.x_range is not None
    assert chart.x_range[0] < COUNTS[0]
    assert chart.x_range[1] > COUNTS[-1]


def test_figure_8_says_what_optimising_saves_and_which_noise_fits() -> None:
    numbers = eighth().numbers
    assert numbers["saved_percent"] == pytest.approx(100 * (1 - RIG[1::2] / RIG[::2]), rel=1e-5)
    limits = np.linspace(3, 1, 8)
    assert numbers["limit_saved_percent"] == pytest.approx(100 * (1 - limits[1::2] / limits[::2]), rel=1e-5)
    assert numbers["fitting_noise_percent"] == 2.0
    assert numbers["fitting_percent"] == pytest.approx([4.67, 3.28, 3.13, 3.16])
    doubled = eighth(1.9 * RIG).numbers
    assert doubled["fitting_noise_percent"] == 0.8  # 1.9 (0.2 + 0.4 noise) is nearest to 1 there
    # The noise whose worst of the four values is nearest: two are nearly twice as large here, two as in the paper.
    uneven = eighth(RIG * np.array([1, 1, 1, 1, 1, 1, 1.9, 1.9])).numbers
    assert uneven["fitting_noise_percent"] == 1.25


@pytest.mark.parametrize(
    ("row", "agreeing", "differing"),
    [
        ("sec. 2: networks trained", {"reached": 24}, {"reached": 23}),
        (
            "abstract: two sensors, inputs",
            {"theoretical_percent": [4.9, 4.9, *[5.5] * 6]},
            {"theoretical_percent": [1, 5.1] * 4},
        ),
        ("abstract: two sensors, sim", {"rig": [4.9, 4.9, *[5.5] * 6]}, {"rig": [4.5, 5.0, *RIG[2:]]}),
        ("fig. 8: errors by number", {"rig": [4, 3, 4, 3, 3, 2, 3, 2]}, {"rig": [4, 3, 4, 3, 3, 2, 3, 2.1]}),
        ("fig. 8: benefit of", {"rig": [4, 3, 4, 3, 4, 3, 4, 3.1]}, {"rig": [4, 3, 4, 3, 4, 3, 4, 2.9]}),
        ("fig. 8: error that", {"rig": [4, 3.3, *RIG[2:]]}, {"rig": [4, 3.5, *RIG[2:]]}),
        ("fig. 8: 2 sensors, equal", {"rig": [5.3, *RIG[1:]]}, {"rig": [5.4, *RIG[1:]]}),
        ("fig. 8: 5 sensors, opt", {"rig": [*RIG[:7], 2.7]}, {"rig": [*RIG[:7], 2.6]}),
    ],
)
def test_a_statement_agrees_up_to_its_tolerance(
    row: str, agreeing: dict[str, object], differing: dict[str, object]
) -> None:
    for changed, expected in ((agreeing, "agrees"), (differing, "differs")):
        rig, others = np.array(changed.get("rig", RIG)), {name: one for name, one in changed.items() if name != "rig"}
        figure = eighth(rig, **{name: np.array(one) if name != "reached" else one for name, one in others.items()})
        assert verdict(figure, row) == expected


def test_misprints_have_the_deflection_of_the_beam_beside_them() -> None:
    first, fourth, pitches = misprints()
    # 48 / 6 of the cube of 398 of 400 mm: the term that applies only beyond the load, as far before it as can be.
    assert first.ours.startswith("wrong by 7.9 times the largest deflection as printed, by ")
    assert first.ours.endswith(("e-15 with a Macaulay bracket", "e-16 with a Macaulay bracket"))
    assert {row.verdict for row in (first, fourth, pitches)} == {"differs"}
    # Rounded, of two sensors to five; the paper has them from five to two.
    ours = [round(400 / (count + 1)) for count in (2, 3, 4, 5)]
    assert list(PRINTED_PITCH_MM) == ours[::-1]
    assert (pitches.paper, pitches.ours) == (", ".join(map(str, ours[::-1])), ", ".join(map(str, ours)))


def test_the_papers_weight_bends_its_beam_by_the_handbooks_formula() -> None:
    """F l^3 / (48 E I) under a load in the middle; 10 N, 400 mm, 25 x 3 mm of 210 GPa."""
    rigidity_n_mm2 = 210e3 * 25 * 3**3 / 12
    assert deflection_mm([200.0], [200.0])[0, 0] == pytest.approx(10 * 400**3 / (48 * rigidity_n_mm2))
    assert dimensionless([200.0])[199, 0] == pytest.approx(1 / 48)
    assert (LOADS_MM[0], LOADS_MM[-1], len(LOADS_MM)) == (1.0, 399.0, 399)
    assert equal_pitch_mm(3).tolist() == [100.0, 200.0, 300.0]


def test_a_verdict_has_its_reason_only_where_it_differs() -> None:
    numbers = {"straight_mm": [1.0, 4.0], "departure_percent": 0.001}
    for holds, text in ((True, "agrees"), (False, "differs: the rig's sensor is not linear over that range")):
        (row,) = rows_of("2", numbers, {"linear": holds})
        assert row.verdict_text == text
        assert row.cells == (row.quantity, "1 to 4 mm", row.ours, text)
    alone = Row("quantity", "", "ours", "not stated", "a reason")
    assert alone.cells == ("quantity", "-", "ours", "not stated in the paper; a reason")
    assert Row("quantity", "", "ours", "not stated").verdict_text == "not stated in the paper"


def test_numbers_for_json_have_seven_digits() -> None:
    given = {"a": np.array([1.23456789, 2.0]), "b": (1.000000049, "text", 12345678), "c": {"d": np.float64(1e-9 / 3)}}
    assert rounded(given) == {"a": [1.234568, 2.0], "b": [1.0, "text", 12345678], "c": {"d": 3.333333e-10}}


def test_the_table_of_a_reproduction_counts_its_verdicts_and_shows_each_figure() -> None:
    figure = figure_2()
    row = Row("eq. | 1", "", "3", "differs", "a reason")
    found = Reproduction(7, (figure,), [row, Row("eq. 2", "5", "5", "agrees"), Row("eq. 3", "", "5", "not stated")])
    assert found.summary() == "2 agrees, 1 differs, 1 not stated"
    assert [one.quantity for one in found.rows] == [figure.rows[0].quantity, "eq. | 1", "eq. 2", "eq. 3"]
    files = found.files()
    assert sorted(files) == ["figure-2-sensor.svg", "results.json", "table.md"]
    page = files["table.md"].splitlines()
    assert "Seed 7. Rows: 2 agrees, 1 differs, 1 not stated. All numbers are in `results.json`." in page
    assert page[6:8] == ["| statement | paper | here | verdict |", "|---|---|---|---|"]
    assert page[9:12] == [
        r"| eq. \| 1 | - | 3 | differs: a reason |",
        "| eq. 2 | 5 | 5 | agrees |",
        "| eq. 3 | - | 5 | not stated in the paper |",
    ]
    assert page[12:] == ["", "![Figure 2](figure-2-sensor.svg)", "", f"Figure 2. {figure.chart.says}."]
    results = json.loads(files["results.json"])
    assert (results["seed"], list(results["figures"]), len(results["rows"])) == (7, ["2"], 4)
    assert results["figures"]["2"]["curves"][1]["x"] == [0.5, 4.5]
