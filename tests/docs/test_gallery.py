"""The gallery: every script makes the plot of its page, and the notebook runs.

Two scripts place sensors and measure them, which takes the longest: they are of the soak.
"""

import re
import runpy
import sys
from pathlib import Path
from xml.etree import ElementTree as ET

import matplotlib.pyplot as plt
import pytest
from nbformat import NotebookNode, reads

from support.pages.pasted import ROOT

pytestmark = pytest.mark.long
GALLERY = ROOT / "docs" / "gallery"
PLACING = ("noise_and_sensors.py", "why_these_positions.py")
SCRIPTS = [
    pytest.param(path.name, marks=pytest.mark.soak if path.name in PLACING else ())
    for path in sorted(GALLERY.glob("*.py"))
]


@pytest.fixture(autouse=True)
def svg(monkeypatch: pytest.MonkeyPatch) -> None:
    """Plots go to files, in this process: matplotlib takes longer to import than the scripts to run."""
    plt.switch_backend("svg")
    monkeypatch.setattr(plt, "show", lambda: None)
    plt.close("all")


@pytest.mark.parametrize("name", SCRIPTS)
def test_a_script_makes_the_plot_of_its_page(name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "argv", [name, str(tmp_path / "plot.svg")])

    runpy.run_path(str(GALLERY / name), run_name="__main__")

    plot = ET.fromstring((tmp_path / "plot.svg").read_text())  # noqa: S314  # our own file
    shown = ET.fromstring((GALLERY / name).with_suffix(".svg").read_text())  # noqa: S314  # likewise
    assert len(list(plot.iter())) > 50
    assert abs(len(list(plot.iter())) - len(list(shown.iter()))) < 0.2 * len(list(shown.iter()))
    assert (GALLERY / name).read_text().strip() in (GALLERY / "index.md").read_text()


def test_the_notebook_shows_that_more_sensors_have_less_error(capsys: pytest.CaptureFixture[str]) -> None:
    notebook: NotebookNode = reads((GALLERY / "how_many_sensors.ipynb").read_text(), as_version=4)  # type: ignore[no-untyped-call]  # nbformat's
    cells = [cell for cell in notebook.cells if cell.cell_type == "code"]
    assert not any(cell.outputs for cell in cells)

    names: dict[str, object] = {"__name__": "__main__"}
    for cell in cells:
        exec(cell.source, names)  # noqa: S102  # our own file, which has no magics

    errors = [float(number) for number in re.findall(r"([\d.]+) \+- [\d.]+ mm", capsys.readouterr().out)]
    assert len(errors) == 4
    assert errors == sorted(errors, reverse=True)
    assert plt.gcf().axes[0].lines
