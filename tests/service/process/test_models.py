"""New models for a real process, and the command that says what a model is."""

from __future__ import annotations

import signal
from pathlib import Path
from typing import TYPE_CHECKING

from beamtouch_models.metadata import POSITION_OUTPUTS
from waiting import wait_until

if TYPE_CHECKING:
    from service.conftest import BuildModel
    from service.process.conftest import Service, StartService


def model(service: Service) -> str:
    return str(service.get("/surfaces/press-7").json()["model"])


def start(start_service: StartService, folder: Path, path: Path, *options: str | Path) -> Service:
    (folder / "service.toml").write_text(f'[surfaces.press-7]\nmodel = "{path}"\n')
    return start_service("--config", "service.toml", *options)


def test_a_file_that_is_replaced_is_used_within_seconds_and_a_bad_one_never(
    start_service: StartService, build_model: BuildModel, tmp_path: Path
) -> None:
    path = build_model()
    service = start(start_service, tmp_path, path)
    first, good = model(service), path.read_bytes()

    path.write_bytes(good[:-100])
    wait_until(lambda: service.get("/surfaces/press-7").json()["model_error"] is not None)
    assert model(service) == first
    build_model(outputs=POSITION_OUTPUTS)  # at the same path
    wait_until(lambda: model(service) != first)
    assert service.get("/surfaces/press-7").json()["model_error"] is None
    path.write_bytes(good)
    wait_until(lambda: model(service) == first)
    _, errors = service.stop(signal.SIGTERM)
    assert errors.count("the new model cannot be used, the old one stays in use") == 1
    assert errors.count("instead of") == 2
