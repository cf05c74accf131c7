"""The gallery: every script makes a plot, and the notebook runs."""

import os
import subprocess
import sys
from pathlib import Path
from xml.etree import ElementTree as ET

import pytest
from nbclient import NotebookClient
from nbformat import NotebookNode, reads

from pasted import ROOT

pytestmark = pytest.mark.long
GALLERY = ROOT / "docs" / "gallery"
SCRIPTS = sorted(path.name for path in GALLERY.glob("*.py"))


@pytest.mark.parametrize("name", SCRIPTS)
def test_a_script_makes_the_plot_of_its_page(name: str, tmp_path: Path) -> None:
    environment = os.environ | {"MPLBACKEND": "svg", "MPLCONFIGDIR": str(tmp_path)}
    command: list[str | Path] = [sys.executable, "-W", "error", GALLERY / name, tmp_path / "plot.svg"]

    done = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=200, check=False)

    assert done.returncode == 0, done.stderr
    plot = ET.fromstring((tmp_path / "plot.svg").read_text())  # noqa: S314  # our own file
    shown = ET.fromstring((GALLERY / name).with_suffix(".svg").read_text())  # noqa: S314  # likewise
    assert len(list(plot.iter())) > 50
    assert abs(len(list(plot.iter())) - len(list(shown.iter()))) < 0.2 * len(list(shown.iter()))
    assert (GALLERY / name).read_text().strip() in (GALLERY / "index.md").read_text()


def test_there_are_scripts_enough() -> None:
    assert len(SCRIPTS) == 5


def test_the_notebook_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("MPLCONFIGDIR", "IPYTHONDIR", "JUPYTER_RUNTIME_DIR", "JUPYTER_CONFIG_DIR"):
        monkeypatch.setenv(name, str(tmp_path))
    content = (GALLERY / "how_many_sensors.ipynb").read_text()
    notebook: NotebookNode = reads(content, as_version=4)  # type: ignore[no-untyped-call]  # nbformat's
    assert not any(cell.get("outputs") for cell in notebook.cells)

    NotebookClient(notebook, timeout=200, resources={"metadata": {"path": str(tmp_path)}}).execute()

    outputs = [output for cell in notebook.cells for output in cell.get("outputs", [])]
    assert any("image/png" in output.get("data", {}) for output in outputs)
    (printed,) = [output.text for output in outputs if output.output_type == "stream"]
    errors = [float(line.rpartition("]")[2].split()[0]) for line in printed.splitlines()]
    assert len(errors) == 4
    assert errors == sorted(errors, reverse=True)
