"""New models for a real process, and the command that says what a model is."""

from __future__ import annotations

import json
import signal
from pathlib import Path
from typing import TYPE_CHECKING

from beamtouch_models import cli as design_sensors
from beamtouch_models.metadata import POSITION_OUTPUTS
from beamtouch_service import cli

if TYPE_CHECKING:
    import pytest

    from service.conftest import BuildModel, MakeBatch
    from service.process.conftest import Service, StartService, Wait


def model(service: Service) -> str:
    return str(service.get("/surfaces/press-7").json()["model"])


def start(start_service: StartService, folder: Path, path: Path, *options: str | Path) -> Service:
    (folder / "service.toml").write_text(f'[surfaces.press-7]\nmodel = "{path}"\n')
    return start_service("--config", "service.toml", *options)


def test_a_file_that_is_replaced_is_used_within_seconds_and_a_bad_one_never(
    start_service: StartService, build_model: BuildModel, tmp_path: Path, wait_for: Wait
) -> None:
    path = build_model()
    service = start(start_service, tmp_path, path)
    first, good = model(service), path.read_bytes()

    path.write_bytes(good[:-100])
    wait_for(lambda: service.get("/surfaces/press-7").json()["model_error"] is not None)
    assert model(service) == first
    build_model(outputs=POSITION_OUTPUTS)  # at the same path
    wait_for(lambda: model(service) != first)
    assert service.get("/surfaces/press-7").json()["model_error"] is None
    path.write_bytes(good)
    wait_for(lambda: model(service) == first)
    _, errors = service.stop(signal.SIGTERM)
    assert errors.count("the new model cannot be used, the old one stays in use") == 1
    assert errors.count("instead of") == 2


def test_a_model_of_another_beam_is_noticed_at_a_start_and_refused_while_running(
    start_service: StartService,
    build_model: BuildModel,
    tmp_path: Path,
    token_file: Path,
    make_batch: MakeBatch,
    wait_for: Wait,
) -> None:
    path, writing = build_model(), ("--write-token-file", token_file)
    good, batch = path.read_bytes(), make_batch() | {"beam": "beam-1"}
    service = start(start_service, tmp_path, path, *writing)
    assert service.post(batch).status_code == 200
    build_model(beam="beam-2")
    wait_for(lambda: service.get("/surfaces/press-7").json()["model_error"] is not None)
    assert (
        "it is of beam beam-2, the samples are of beam beam-1" in service.get("/surfaces/press-7").json()["model_error"]
    )
    service.stop(signal.SIGTERM)

    service = start(start_service, tmp_path, path, *writing)
    assert service.get("/surfaces/press-7").json()["beam"] == "beam-2"
    assert service.post(batch).json()["type"] == "urn:beamtouch:problem:other-beam"
    assert service.get("/contact").json()["type"] == "urn:beamtouch:problem:other-beam"
    path.write_bytes(good)
    wait_for(lambda: service.get("/surfaces/press-7").json()["beam"] == "beam-1")
    assert service.post(batch).status_code == 200
    assert service.get("/contact").json()["state"] == "contact"


def test_a_file_that_is_too_large_is_refused_unread(
    start_service: StartService, build_model: BuildModel, tmp_path: Path, wait_for: Wait
) -> None:
    path = build_model()
    service = start(start_service, tmp_path, path)

    def most_memory_kb() -> int:
        status = Path(f"/proc/{service.process.pid}/status").read_text()
        return int(next(line.split()[1] for line in status.splitlines() if line.startswith("VmHWM")))

    first, before_kb = model(service), most_memory_kb()
    with path.open("r+b") as file:
        file.truncate(2_000_000_000)
    wait_for(lambda: service.get("/surfaces/press-7").json()["model_error"] is not None)
    assert "it is larger than 4 MiB" in service.get("/surfaces/press-7").json()["model_error"]
    assert model(service) == first
    assert most_memory_kb() - before_kb < 50_000
    _, errors = service.stop(signal.SIGTERM)
    assert errors.count("larger than 4 MiB") == 1


def test_check_says_what_a_model_is(bench_model: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["check", str(bench_model)]) == 0
    text = capsys.readouterr().out
    assert "s1 68, s2 156, s3 244, s4 332 mm" in text
    assert "answers reproduced" in text
    assert design_sensors.main(["inspect", str(bench_model)]) == 0
    assert capsys.readouterr().out == text

    assert cli.main(["check", "--json", str(bench_model)]) == 0
    said = json.loads(capsys.readouterr().out)
    assert len(said["positions_mm"]) == len(said["channels"]) == 4


def test_check_says_in_one_line_what_is_wrong(
    build_model: BuildModel, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "text.onnx").write_text("hello")
    with (tmp_path / "large.onnx").open("wb") as file:
        file.truncate(2_000_000_000)
    for path, complaint in (
        (tmp_path / "large.onnx", "it is larger than 4 MiB"),
        (Path("/dev/zero"), "it is not a regular file"),
        (tmp_path / "nowhere.onnx", "No such file or directory"),
        (tmp_path / "text.onnx", "damaged or not an ONNX file"),
        (build_model(outputs=("position_mm",)), "lacks position_low_mm, position_high_mm, contact_log_odds, misfit)"),
    ):
        assert cli.main(["check", str(path)]) == 2
        out, errors = capsys.readouterr()
        (line,) = errors.splitlines()
        assert (out, complaint in line) == ("", True)
