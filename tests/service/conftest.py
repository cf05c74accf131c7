"""Services in the test's process, and files for services."""

from collections.abc import Iterator
from functools import partial
from pathlib import Path

import pytest
from anyio.from_thread import start_blocking_portal

from beamtouch_service.metrics import figures
from service.bench import READ_TOKEN, START_US, TOKEN, Bench, BuildModel, surface_of
from service.recording import Services
from support.network.certificates import make_certificate
from support.surfaces.small_model import write_model


@pytest.fixture
def build_model(tmp_path: Path) -> BuildModel:
    """`write_model` to the folder of the test."""
    return partial(write_model, tmp_path)


@pytest.fixture
def services() -> Services:
    return Services()


@pytest.fixture(scope="session", autouse=True)
def _event_loop() -> Iterator[None]:
    with start_blocking_portal() as Bench.event_loop:
        yield
    Bench.event_loop = None


@pytest.fixture(autouse=True)
def _close_records() -> Iterator[None]:
    yield
    for bench in Bench.started:
        bench.stop()
    Bench.started.clear()


@pytest.fixture(autouse=True)
def _machine_of_the_samples(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let the services of this process have the wall clock of the samples that tests send."""
    monkeypatch.setattr(figures, "time", lambda: START_US / 1e6)


@pytest.fixture
def bench() -> Bench:
    return Bench(surface_of())


@pytest.fixture
def token_file(tmp_path: Path) -> Path:
    path = tmp_path / "token"
    path.write_text(TOKEN + "\n")
    return path


@pytest.fixture
def read_token_file(tmp_path: Path) -> Path:
    path = tmp_path / "read-token"
    path.write_text(READ_TOKEN + "\n")
    return path


@pytest.fixture
def certificate(tmp_path: Path) -> tuple[Path, Path]:
    """A certificate for 127.0.0.1, and its key."""
    return make_certificate(tmp_path)
