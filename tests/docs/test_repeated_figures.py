"""Figures that a page repeats from the measured ones are those."""

import math
import re

import pytest

from support.pages.pasted import ROOT

DOCS = ROOT / "docs"
NOTICED = {
    "two contacts at the quarters of the beam": ["two contacts at the quarters"],
    "two contacts, half of the range apart": ["two contacts 0.5 of the range apart"],
    "two contacts, a twentieth of the range apart": ["two contacts 0.05 of the range apart"],
    "a load spread over a tenth; a half of the beam": [
        "load spread over 10 % of the beam",
        "load spread over 50 % of the beam",
    ],
    "a pull of a quarter of the smallest force": ["pull of 0.25 times the smallest force"],
    "a wedge under a sensor": ["one channel wedged, contact"],
    "a sensor that stands still during a contact": ["one channel stuck at rest"],
    "gains 1 %; 3 % off": ["gains 1 % off", "gains 3 % off"],
    "zeros 1; 3; 10 noises off": ["zeros 1 noises off", "zeros 3 noises off", "zeros 10 noises off"],
    "sensors 1 mm beside their positions": ["positions 1 mm off"],
}
"""Rows of `what-it-can-know.md`, with the cases of the challenge that they stand for."""


def rows_of(text: str) -> dict[str, list[str]]:
    """Return the rows of all tables in a text, by their first cell; bold counts for nothing."""
    lines = [line.replace("**", "").strip("|").split("|") for line in text.splitlines() if line.startswith("|")]
    return {cells[0].strip(): [cell.strip() for cell in cells[1:]] for cells in lines}


def figures_in(cell: str) -> list[float]:
    return [float(number) for number in re.findall(r"[\d.]+", cell)]


def test_what_it_can_know_repeats_the_faults_of_the_challenge() -> None:
    faults = rows_of((DOCS / "challenge.md").read_text().split("## Faults and other worlds")[1].split("\n## ")[0])
    rows = rows_of((DOCS / "explanation" / "what-it-can-know.md").read_text())

    for row, cases in NOTICED.items():
        noticed, power = zip(*(figures_in(faults[case][0]) for case in cases), strict=True)
        assert figures_in(rows[row][0]) == pytest.approx(noticed, abs=0.5), row
        assert figures_in(rows[row][1]) == pytest.approx(power, abs=0.5), row


def test_the_page_on_the_paper_repeats_how_many_statements_differ() -> None:
    (measured,) = re.findall(r"of (\d+) statements, \d+ agree, (\d+) differ", joined("figures.md"))

    assert re.findall(r"Of (\d+) statements, (\d+) differ", joined("explanation/paper.md")) == [measured]


def joined(page: str) -> str:
    """Return the words of a page with a space between two."""
    return " ".join((DOCS / page).read_text().split())


def test_what_to_buy_follows_from_what_a_service_takes() -> None:
    text = joined("figures.md").split("## Surfaces per core")[1].split(" ## ")[0]
    four_us, one_us = numbers(r"batch of 4 samples takes (\d+) us of the service, a batch of one (\d+)", text)
    least_mb, most_mb = numbers(r"Memory is (\d+) MB with one surface, .* and (\d+) MB with 500", text)
    resting, percent = numbers(r"(\d+) surfaces at rest, .*? take (\d+) % of a core", text)
    (daemon,) = numbers(r"of the service and ([\d.]+) % of the daemon", text)
    page = (DOCS.parent / "deploy" / "README.md").read_text()
    line = " ".join(page.split())
    (planned,) = numbers(r"plans for (\d+) % of a core", line)
    shares = {
        "rests nearly always, any rate": percent / resting,
        "1 kHz, always moving": 1000 / 4 * four_us / 1e4,
        "200 Hz, always moving": 200 * one_us / 1e4,
        "50 Hz, always moving": 50 * one_us / 1e4,
    }

    cells = {row: [int(cell) for cell in rows_of(page)[row]] for row in shares}
    carried = {row: math.floor(planned / share) for row, share in shares.items()}
    assert cells == {row: [one, *(math.ceil(all_ / one) for all_ in (100, 1000, 5000))] for row, one in carried.items()}
    assert f"plan a core for {planned / daemon:.0f} surfaces at rest" in line
    each_mb = (most_mb - least_mb) / 499
    assert f"plan {least_mb:.0f} MB, and {each_mb:.1f} MB for each surface" in line
    thousands_gb = [(least_mb + each_mb * number) / 1000 for number in (1000, 5000)]
    assert "({:.1f} GB with 1000, {:.1f} GB with 5000)".format(*thousands_gb) in line


def numbers(pattern: str, text: str) -> list[float]:
    """Return the numbers in the only place of a text that a pattern with groups fits."""
    (match,) = re.finditer(pattern, text)
    return [float(number) for number in match.groups()]


def test_the_guide_repeats_the_figures_of_a_calibration_from_contacts() -> None:
    measured = rows_of((DOCS / "figures.md").read_text())["and positions 1 mm"]
    before, after, best, _ratio, held_before, held_after = measured
    guide = (DOCS / "how-to" / "calibrate-without-loads.md").read_text()
    (sentence,) = re.findall(r"falls from ([\d.]+) to ([\d.]+) % of\s+the length, where ([\d.]+) %", guide)
    (held,) = re.findall(r"Intervals held (\d+) % before and (\d+) % after", guide)

    assert [float(one) for one in sentence] == pytest.approx([float(before), float(after), float(best)], abs=0.05)
    assert [float(one) for one in held] == pytest.approx(
        [100 * float(held_before), 100 * float(held_after.split(",")[0])], abs=0.5
    )
