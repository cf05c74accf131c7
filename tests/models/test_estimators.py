"""The estimators by name, through the command that builds them."""

import json
from pathlib import Path

import numpy as np
import pytest

from beamtouch_models import modelfile
from beamtouch_models.estimators.paper_network import paper_graph, trained_as_in_the_paper
from example_scenes import SCENES
from in_process import Command
from posterior_cases import answers_of, prior_of


def test_the_papers_network_as_a_graph(monkeypatch: pytest.MonkeyPatch) -> None:
    # A twentieth of the load positions; the command below trains on all of them.
    monkeypatch.setattr("beamtouch_models.estimators.paper_network.PATTERNS", 21)
    prior = prior_of("paper", 2, 2.0, known=True)
    network = trained_as_in_the_paper(prior, 0)
    position = np.linspace(40, 360, 50)
    deflection = prior.force_n[1] * prior.influence_at(position)
    answers = answers_of(paper_graph(network), prior, deflection)
    assert list(answers) == ["position_mm"]
    assert answers["position_mm"] == pytest.approx(network.estimate_mm(deflection), abs=1e-2)
    # Without noise it knows the position to a percent or so of the length.
    assert np.abs(answers["position_mm"] - position).mean() < 0.03 * prior.length_mm


@pytest.mark.soak
def test_the_papers_network_builds_and_is_evaluated(design_sensors_here: Command, tmp_path: Path) -> None:
    path = tmp_path / "paper.onnx"
    options = ("--estimator", "paper-network", "--criterion", "eigenvalue-product", "--json")
    built = design_sensors_here("build", SCENES / "paper.toml", *options, "-o", path)
    assert json.loads(built.stdout)["outputs"] == ["position_mm"]
    model = modelfile.load(path)
    assert model.metadata.estimator == "paper-network"
    assert model.metadata.min_channels == len(model.metadata.layout)
    assert model.metadata.accuracy.ratio > 1
    done = design_sensors_here("evaluate", path, "--draws", 300, "--json")
    assert done.returncode == 0, done.stderr
    (found,) = json.loads(done.stdout)["evaluations"]
    assert found["span"]["ratio"]["value"] > 1
    assert found["position_coverage"] is found["missed"] is None
