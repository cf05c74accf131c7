"""Results of commands in their rarer forms: without noise, without points, and with contacts that are left out."""

import re
from pathlib import Path

import numpy as np
import pytest

from beamtouch_models.modelfile import ModelFile
from example_scenes import PAPER
from in_process import Command
from unlabelled_contacts import Kind, drawn, surface, write_contacts


@pytest.mark.usefixtures("short_work")
def test_an_evaluation_without_noise_has_no_limit_and_says_so(design_sensors_here: Command, bench_model: Path) -> None:
    done = design_sensors_here("evaluate", bench_model, "--noise", 0, "--draws", 200)
    assert (done.returncode, done.stderr) == (0, "")
    assert re.search(r"without noise\s+the limit is 0, so there is no ratio", done.stdout)
    assert re.search(r"limit, mean\s+-", done.stdout)
    assert "Cramer-Rao" not in done.stdout


@pytest.mark.usefixtures("short_work")
def test_a_trade_without_any_point_gives_the_reason(design_sensors_here: Command, tmp_path: Path) -> None:
    scene = tmp_path / "narrow.toml"
    scene.write_text(PAPER.replace("count = 2", "count = [3, 4]\nmin_distance_mm = 250"))
    done = design_sensors_here("trade", scene, "-o", tmp_path / "out", "--draws", 100)
    assert (done.returncode, done.stdout, done.stderr.count("\n")) == (2, "", 1)
    assert "min_distance_mm" in done.stderr
    assert not list(tmp_path.rglob("*.onnx"))


def test_contacts_that_are_left_out_are_counted(
    design_sensors_here: Command, bench_model: Path, bench: ModelFile, tmp_path: Path
) -> None:
    rng = np.random.default_rng(1)
    # Too few to be used, so that it is quick.
    contacts = drawn(bench.metadata, surface(bench.metadata, Kind(), rng), Kind(), rng, 9)
    path = write_contacts(tmp_path / "contacts.csv", bench, contacts)
    head, *rows = path.read_text().splitlines()
    path.write_text("\n".join([head, *(row.replace(",a1,", ",a0,") for row in rows[:4]), *rows[4:]]))
    done = design_sensors_here("calibrate", bench_model, "--events", path, "-o", tmp_path / "new.onnx")
    assert (done.returncode, done.stdout) == (1, "")
    assert "4 contacts with an older characteristic are left out; the newest 5 are used" in done.stderr
