"""The small network in the real service: built and evaluated by the command, then asked over loopback."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING

import numpy as np
import pytest

from beamtouch_models import cli, modelfile
from beamtouch_models.surface import prior_of_model
from beamtouch_service import cli as service_cli
from example_scenes import SCENES

if TYPE_CHECKING:
    from pathlib import Path

    from service.conftest import MakeBatch
    from service.process.conftest import StartService


def test_a_small_network_is_built_evaluated_checked_and_served(
    start_service: StartService,
    make_batch: MakeBatch,
    token_file: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    path = tmp_path / "press-7.onnx"
    scene = tmp_path / "press-7.toml"
    scene.write_text((SCENES / "bench.toml").read_text())
    assert cli.main(["build", str(scene), "--estimator", "small-network", "-o", str(path), "--json"]) == 0
    built = json.loads(capsys.readouterr().out)
    assert (built["estimator"], built["lacks"]) == ("small-network", [])
    assert cli.main(["evaluate", str(path), "--draws", "512", "--json"]) == 0
    (found,) = json.loads(capsys.readouterr().out)["evaluations"]
    assert found["span"]["ratio"]["value"] < 1.1
    assert found["position_coverage"]["value"] > 0.93
    assert found["force_coverage"]["value"] > 0.93
    assert service_cli.main(["check", str(path)]) == 0
    assert "lacks" not in capsys.readouterr().out

    model = modelfile.load(path)
    load = 8.0 * prior_of_model(model.metadata).influence_at(np.array([130.0]))[0]
    service = start_service("--model", path, "--write-token-file", token_file, "--stale-ms", "60000")

    def contact(sequence: int, row: list[float | None]) -> dict[str, float | str | None]:
        quality = ["good" if value is not None else "missing" for value in row]
        batch = make_batch(row, sequence=sequence, channels=model.channels, quality=quality)
        response = service.post(batch)
        assert response.status_code == 200, response.text
        answer: dict[str, float | str | None] = service.get("/contact").json()
        return answer

    assert contact(1, [0.0] * 4)["state"] == "clear"
    for sequence, row in ((2, load.tolist()), (3, [*load[:2].tolist(), None, load[3]])):
        said = contact(sequence, row)
        assert said["state"] == "contact"
        figures = [said[f"{name}_mm"] for name in ("position_low", "position", "position_high")]
        low, middle, high = (float(figure) for figure in figures if figure is not None)
        assert low < 130 < high
        assert middle == pytest.approx(130, abs=4)
        assert said["force_n"] == pytest.approx(8, rel=0.1)
    assert contact(4, [0.0] * 4)["state"] == "clear"


def test_check_says_what_the_papers_network_lacks(paper_network: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = paper_network / "paper.onnx"
    lacks = "position_low_mm, position_high_mm, contact_log_odds, misfit"
    assert service_cli.main(["check", str(path)]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert line.endswith(f"build a model with another estimator (paper-network lacks {lacks})")
    assert cli.main(["inspect", str(path)]) == 0
    assert f"lacks    {lacks}: `design-sensors evaluate` can use it, the service cannot" in capsys.readouterr().out
