"""A service in the test's process, its tokens, and batches for it."""

from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any, ClassVar

import httpx2
import pytest
from anyio.from_thread import BlockingPortal, start_blocking_portal
from fastapi.testclient import TestClient

from beamtouch_models import modelfile
from beamtouch_service.access import Access
from beamtouch_service.api.app import create_app
from beamtouch_service.events.recorder import Recorder
from beamtouch_service.host import models
from beamtouch_service.host.models import ModelKeeper
from beamtouch_service.samples import Batch
from beamtouch_service.surfaces.surface import Surface
from service.small_model import write_model

TOKEN = "correct-horse-battery-staple"  # noqa: S105  # of these tests only
READ_TOKEN = "reading-horse-battery-staple"  # noqa: S105
BuildModel = Callable[..., Path]


@pytest.fixture
def build_model(tmp_path: Path) -> BuildModel:
    """`write_model` to the folder of the test."""
    return partial(write_model, tmp_path)


@pytest.fixture
def kept(build_model: BuildModel) -> ModelKeeper:
    """The keeper of the model of one surface `press-7`, and of its file."""
    path = build_model()
    return ModelKeeper(Surface("press-7", models.load(path)), path, models.stamp_of(path))


class Bench:
    """One surface `press-7` behind its routes, with a clock that stands still until it is told otherwise."""

    event_loop: ClassVar[BlockingPortal | None] = None
    """Of the requests of all tests: to start one for each takes longer than an answer."""

    def __init__(
        self,
        *surfaces: Surface,
        token: str | Access | None = TOKEN,
        recorder: Recorder | None = None,
    ) -> None:
        self.now_s = 1000.0
        self.app = create_app(
            surfaces,
            token,
            clock=lambda: self.now_s,
            recorder=recorder,
        )
        self.client = TestClient(self.app, raise_server_exceptions=False)
        self.client.portal = self.event_loop

    def get(self, path: str, token: str | None = None) -> httpx2.Response:
        return self.client.get(path, headers={"Authorization": f"Bearer {token}"} if token else {})

    def post(
        self,
        body: dict[str, Any] | bytes | Iterator[bytes],
        path: str = "/surfaces/press-7/samples",
        token: str | None = TOKEN,
    ) -> httpx2.Response:
        headers = {"Authorization": f"Bearer {token}"} if token else {}
        if isinstance(body, dict):
            return self.client.post(path, json=body, headers=headers)
        return self.client.post(path, content=body, headers=headers)


@pytest.fixture(scope="session", autouse=True)
def _event_loop() -> Iterator[None]:
    with start_blocking_portal() as Bench.event_loop:
        yield
    Bench.event_loop = None


@pytest.fixture
def bench(build_model: BuildModel) -> Bench:
    return Bench(Surface("press-7", modelfile.load(build_model())))


@pytest.fixture
def make_bench() -> type[Bench]:
    return Bench


MakeBatch = Callable[..., dict[str, Any]]


def batch_of(
    *rows: list[float | None],
    sequence: int = 1,
    age_ms: float = 0.0,
    boot_id: str = "boot-0001",
    channels: list[str] | None = None,
    quality: list[str] | None = None,
) -> dict[str, Any]:
    """One batch of samples numbered from `sequence` on, one per row of deflections."""
    rows = rows or ([0.5, 0.25, 0.125],)
    samples = [
        {
            "sequence": sequence + i,
            "acquired_unix_us": 1_795_218_046_123_456 + i * 5000,
            "deflection_mm": row,
            "quality": quality or ["good"] * len(row),
        }
        for i, row in enumerate(rows)
    ]
    names = channels or [f"s{i + 1}" for i in range(len(rows[0]))]
    return {"boot_id": boot_id, "channels": names, "newest_age_ms": age_ms, "samples": samples}


@pytest.fixture
def make_batch() -> MakeBatch:
    """`batch_of`, for tests that cannot import it."""
    return batch_of


@pytest.fixture
def parse_batch(make_batch: MakeBatch) -> Callable[..., Batch]:
    def parse(*rows: list[float | None], **options: object) -> Batch:
        return Batch.model_validate(make_batch(*rows, **options))

    return parse


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


def kind(response: httpx2.Response) -> str:
    """Check that an answer is a whole problem, and return the last part of its type."""
    body = response.json()
    assert response.headers["content-type"] == "application/problem+json"
    assert response.headers["cache-control"] == "no-store"
    assert body["status"] == response.status_code
    assert body["title"]
    assert body["detail"]
    return str(body["type"]).removeprefix("urn:beamtouch:problem:")
