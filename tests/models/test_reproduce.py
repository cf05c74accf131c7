"""The reproduced figures: numbers against the paper, and against independent calculations."""

import json
from argparse import Namespace
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from beamtouch_models.accuracy.limit import MeanError
from beamtouch_models.arrays import Floats
from beamtouch_models.commands import reproduce as command
from beamtouch_models.estimators.paper_network import PaperNetwork
from beamtouch_models.reproduction import figure_8 as eighth
from beamtouch_models.reproduction import search
from beamtouch_models.reproduction.components import figure_2, figure_3, figure_4, figure_7, noise_errors
from beamtouch_models.reproduction.figure_8 import (
    MEASURED_PERCENT,
    NOISES_PERCENT,
    Layout,
    Performance,
    figure_8,
    performances,
)
from beamtouch_models.reproduction.finding import Figure, Row
from beamtouch_models.reproduction.paper import LOADS_MM, dimensionless, equal_pitch_mm
from beamtouch_models.reproduction.printed import equation_1, printed_rows
from beamtouch_models.reproduction.reproduce import Reproduction, reproduce
from beamtouch_models.reproduction.search import EXPECTED_MM, figures_5_and_6
from in_process import Command
from tags import Tags


@pytest.fixture
def quick(monkeypatch: pytest.MonkeyPatch) -> partial[Reproduction]:
    """The whole reproduction, with little of everything that takes time."""
    monkeypatch.setattr(eighth, "DRAWS", 400)
    monkeypatch.setattr(eighth, "LIMIT_DRAWS", 200)
    monkeypatch.setattr(search, "OTHER_SEEDS", 2)
    return partial(reproduce, networks=1, max_epochs=10)


def row_of(figure: Figure | tuple[Row, ...], start: str) -> Row:
    rows = figure.rows if isinstance(figure, Figure) else figure
    (row,) = (row for row in rows if row.quantity.startswith(start))
    return row


def eigenvalues(sensor_mm: Floats) -> Floats:
    """Eigenvalues of eq. 2, descending, from eq. 1 with a Macaulay bracket and numpy's symmetric solver."""
    x, a = sensor_mm[None, :] / 400, LOADS_MM[:, None] / 400
    matrix = -((2 - a) * (a - 1) * a * x + (1 - a) * x**3 - np.maximum(x - a, 0) ** 3) / 6
    found: Floats = np.linalg.eigvalsh(matrix.T @ matrix / 399)[::-1]
    return found


def test_figure_2_is_straight_from_1_to_4_mm() -> None:
    figure = figure_2()
    assert figure.rows[0].verdict == "agrees"
    gap, output = np.array(figure.results["gap_mm"]), np.array(figure.results["output_percent"])
    stated = (gap >= 1) & (gap <= 4)
    assert np.ptp(np.diff(output[stated])) < 0.01
    assert output[0] - output[1] > -1
    assert figure.results["largest_departure_percent"] < 0.01


def test_figure_3_has_four_visible_components() -> None:
    figure = figure_3()
    assert figure.results["discernible"] == 4
    assert figure.results["eigenvalues_over_first"][1] == pytest.approx(0.0039, abs=5e-5)
    expected = eigenvalues(equal_pitch_mm(8))
    assert figure.results["eigenvalues"] == pytest.approx(expected, rel=1e-5)
    assert figure.results["eigenvalues_over_first"][:4] == pytest.approx([1 / k**8 for k in (1, 2, 3, 4)], rel=2e-3)
    assert {row.verdict for row in figure.rows} == {"agrees", "not stated"}


@pytest.mark.parametrize("noise", [2.0, 10.0])
def test_figure_4_is_the_mean_of_a_half_normal_distribution_over_the_size_of_each_component(noise: float) -> None:
    percent, factor, exponent = noise_errors(noise, 0)
    _, vectors = np.linalg.eigh(dimensionless(equal_pitch_mm(8)).T @ dimensionless(equal_pitch_mm(8)))
    sizes = np.abs(dimensionless(equal_pitch_mm(8)) @ vectors[:, ::-1]).mean(axis=0)
    assert percent[:4] == pytest.approx((noise / 48 * np.sqrt(2 / np.pi) / sizes)[:4], rel=0.02)
    assert exponent == pytest.approx(4, abs=0.05)
    assert factor == pytest.approx(percent[0], rel=0.05)
    assert [row.verdict for row in figure_4(0).rows] == ["agrees", "agrees", "not stated"]


@pytest.mark.parametrize("seed", range(6))
def test_figures_5_and_6_merge_eight_sensors_into_the_papers_four_places(
    monkeypatch: pytest.MonkeyPatch, seed: int
) -> None:
    monkeypatch.setattr(search, "OTHER_SEEDS", 1)
    fifth, sixth = (figure.results for figure in figures_5_and_6(seed))
    places, product = np.array(fifth["positions_mm"]), np.array(sixth["log_eigenvalue_product"])
    assert np.array_equal(places[0], [44, 89, 133, 178, 222, 267, 311, 356])
    assert places[-1] == pytest.approx(EXPECTED_MM, abs=1)
    assert 10 <= fifth["iterations"] <= 40
    assert (np.diff(product) >= 0).all()
    assert product[-1] == pytest.approx(np.log(eigenvalues(places[-1])[:4]).sum(), abs=1e-5)
    assert product[-1] == pytest.approx(-52.676, abs=1e-3)


def test_figures_5_and_6_agree_with_the_paper() -> None:
    fifth, sixth = figures_5_and_6(0)
    assert {row.verdict for row in (*fifth.rows, *sixth.rows)} == {"agrees", "not stated"}
    assert len(fifth.chart.series) == 8


def test_figure_7_states_its_differences() -> None:
    figure = figure_7(np.array([68.0, 156.0, 244.0, 332.0]))
    assert figure.results["peak_optimised_over_equal"] == pytest.approx([0.9565, 0.9632, 1.0314, 1.0892], abs=1e-3)
    assert [row.verdict for row in figure.rows] == ["differs", "agrees", "differs", "agrees"]
    assert all(row.why for row in figure.rows if row.verdict == "differs")


def test_the_accuracy_limit_of_two_sensors(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(eighth, "LIMIT_DRAWS", 6000)
    placed = {Layout(2, "equal"): equal_pitch_mm(2), Layout(2, "optimised"): np.array([122.0, 278.0])}
    found = performances(placed, 1, networks=1, max_epochs=10)
    for layout, percent in zip(placed, (4.50, 4.12), strict=True):
        best = found[layout].limit
        assert abs(best.percent - percent) < 4 * best.standard_error
        assert best.standard_error < 0.25
        assert found[layout].rig > best.percent


def performance(layout: Layout, low: float, high: float) -> Performance:
    network = PaperNetwork(np.ones(2), 400.0, np.zeros((3, 10)), np.zeros(11), 0.0009, 700, "reached")
    errors = np.interp(NOISES_PERCENT, [0, 2], [low, high])[None, :]
    return Performance(layout, np.array([1.0, 2.0]), (network,), errors, MeanError(3.0, 0.1))


def test_figure_8_agrees_for_equal_numbers() -> None:
    rig = {2: (4.67, 3.28), 3: (4.0, 3.2), 4: (3.5, 3.18), 5: (3.13, 3.16)}
    found = {
        (layout := Layout(count, kind)): performance(layout, 1.0, rig[count][kind == "optimised"])
        for count in (2, 3, 4, 5)
        for kind in eighth.KINDS
    }
    figure = figure_8(found)
    assert {row.verdict for row in figure.rows} == {"agrees", "not stated"}
    assert "2 % of the largest deflection" in row_of(figure, "fig. 8: noise of the paper's rig").ours


def test_figure_8_differs_for_other_numbers_and_states_the_noise_that_fits() -> None:
    found = {
        (layout := Layout(count, kind)): performance(layout, 0.0, 12.0)
        for count in (2, 3, 4, 5)
        for kind in eighth.KINDS
    }
    figure = figure_8(found)
    row = row_of(figure, "fig. 8: 2 sensors, equal")
    assert row.verdict == "differs"
    assert f"{2 * 4.67 / 12:.2f} % noise" in row.why
    assert row_of(figure, "fig. 8: benefit of optimising").verdict == "differs"
    assert row_of(figure, "fig. 8: error that optimising saves").verdict == "differs"
    assert "the limit at 2 % is above it" not in row_of(figure, "fig. 8: 5 sensors, equal").why
    assert len(MEASURED_PERCENT) == 4


def test_misprints_of_the_paper() -> None:
    first, fourth, pitch = printed_rows()
    assert {row.verdict for row in (first, fourth, pitch)} == {"differs"}
    assert "overflows with 24 sensors" in fourth.ours
    x, a = np.linspace(0, 1, 41)[None, :], np.linspace(0, 1, 41)[:, None]
    literal, bracket = (-equation_1(x, a, macaulay=macaulay) for macaulay in (False, True))
    assert np.abs(literal - bracket).max() * 48 == pytest.approx(8, rel=1e-12)
    assert bracket.max() == pytest.approx(1 / 48, rel=1e-12)
    assert pitch.ours == "133, 100, 80, 67"


def test_the_same_seed_gives_the_same_files(quick: partial[Reproduction]) -> None:
    first, second = (quick(2, lambda _doing, _done: None).files() for _ in range(2))
    assert first == second
    assert [name for name in first if name.endswith(".svg")] == [
        "figure-2-sensor.svg",
        "figure-3-components.svg",
        "figure-4-noise.svg",
        "figure-5-positions.svg",
        "figure-6-performance.svg",
        "figure-7-components-optimised.svg",
        "figure-8-errors.svg",
    ]
    for name, text in first.items():
        if name.endswith(".svg"):
            tags = Tags(text)
            assert tags.of("svg")[0]["role"] == "img"
            assert tags.of("polyline")
            assert "nan" not in text.lower()
        assert "http" not in text.replace("http://www.w3.org/2000/svg", "")


@pytest.mark.parametrize("as_json", [False, True])
def test_the_command_writes_the_folder_and_prints_the_table(
    quick: partial[Reproduction],
    as_json: bool,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.setattr("beamtouch_models.reproduction.reproduce.reproduce", quick)
    folder = tmp_path / "new" / "paper"
    command.run(Namespace(output=folder, seed=3, json=as_json))
    results = json.loads((folder / "results.json").read_text())
    assert sorted(results["figures"]) == list("2345678")
    table = (folder / "table.md").read_text()
    assert table.count("\n| ") == len(results["rows"]) + 1
    assert all(row["why"] for row in results["rows"] if row["verdict"] == "differs")
    out = capsys.readouterr().out
    if as_json:
        printed = json.loads(out)
        assert printed["rows"] == results["rows"]
        assert len(printed["files"]) == 9
    else:
        assert "not stated in the paper" in out
        assert "(seed 3)" in out


def test_an_output_folder_that_is_a_file_is_refused(design_sensors_here: Command, tmp_path: Path) -> None:
    (tmp_path / "taken").write_text("")
    done = design_sensors_here("reproduce", "-o", tmp_path / "taken")
    assert (done.returncode, done.stderr.count("\n")) == (2, 1)
    assert "is a file; give a folder" in done.stderr
