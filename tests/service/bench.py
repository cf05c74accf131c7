"""A service in the test's process, its tokens, and batches for it.

This is no conftest: pytest imports one under another name than tests do, so that each would have a class of its own.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any, ClassVar, TypedDict, Unpack

import httpx2
from anyio.from_thread import BlockingPortal
from fastapi.testclient import TestClient

from beamtouch_models.runtime import ModelFile
from beamtouch_service.access import Access
from beamtouch_service.api.app import create_app
from beamtouch_service.callers import TrustedProxies
from beamtouch_service.record import recorder
from beamtouch_service.samples import Batch
from beamtouch_service.sections import EventsSection, SurfaceSection
from beamtouch_service.surfaces.surface import Surface
from support.surfaces.small_model import ModelOptions, model_of

TOKEN = "correct-horse-battery-staple"  # noqa: S105  # of these tests only
READ_TOKEN = "reading-horse-battery-staple"  # noqa: S105
ADMIN_TOKEN = "governing-horse-battery-staple"  # noqa: S105
PATIENT_S = 60.0
PATIENT = f"from beamtouch_service.record import recorder; recorder.LOAD_S = {PATIENT_S}"
"""For services in tests: on a starved machine, a batch would come back before what is on record of its boot is read."""
recorder.LOAD_S = PATIENT_S
START_US = 1_795_218_046_123_456
"""2026-11-20T23:40:46.123Z"""
FIGURES = ("position_mm", "position_low_mm", "position_high_mm", "force_n", "force_low_n", "force_high_n")
BuildModel = Callable[..., Path]
Row = Sequence[float | None]
"""Deflections of a sample."""


class BatchOptions(TypedDict, total=False):
    """What `batch_of` takes beside rows."""

    sequence: int
    age_ms: float
    boot_id: str
    channels: list[str] | None
    quality: list[str] | None
    begin_us: int
    every_us: int


class Bench:
    """One surface `press-7`, or others, behind routes, with a clock that stands still until it is told otherwise."""

    event_loop: ClassVar[BlockingPortal | None] = None
    """Of the requests of all tests: to start one for each takes longer than an answer."""
    started: ClassVar[list[Bench]] = []
    """In the test that runs; their records are closed at its end."""

    def __init__(
        self,
        *surfaces: Surface,
        token: str | None = TOKEN,
        read_token: str | None = None,
        admin_token: str | None = None,
        proxies: Sequence[str] = (),
        access: Access | None = None,
        events: EventsSection | None = None,
    ) -> None:
        self.now_s = 1000.0
        record = recorder.Recorder(events or EventsSection())
        access, trusted = access or Access.of(token, read_token, admin_token), TrustedProxies(proxies)
        self.app = create_app(surfaces, access, clock=lambda: self.now_s, recorder=record, proxies=trusted)
        self.started.append(self)
        self.client = TestClient(self.app, raise_server_exceptions=False)
        self.client.portal = self.event_loop

    def adopt(self, model: ModelFile) -> None:
        """Give its only surface another model."""
        (surface,) = self.app.context.registry
        surface.adopt(model)

    def stop(self) -> None:
        """Stop as a service does: what is not durable yet is written."""
        assert self.event_loop is not None
        self.event_loop.call(self.app.context.recorder.close)

    def pass_second(self) -> None:
        """Do what the record does each second."""

        async def commit() -> None:
            await asyncio.wait([self.app.context.recorder.commit()])

        assert self.event_loop is not None
        self.event_loop.call(commit)

    def get(self, path: str, token: str | None = None) -> httpx2.Response:
        """Ask; for what reads the record, once all that was sent so far is durable."""
        if path.startswith("/events") or "/calibration-data" in path:
            assert self.event_loop is not None
            self.event_loop.call(self.app.context.recorder.flush)
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

    def send(
        self,
        *rows: Row,
        surface: str = "press-7",
        members: dict[str, Any] | None = None,
        **options: Unpack[BatchOptions],
    ) -> dict[str, Any]:
        """Send a batch of `batch_of` with further members, which must be taken; return the receipt."""
        answer = self.post(batch_of(*rows, **options) | (members or {}), f"/surfaces/{surface}/samples")
        assert answer.status_code == 200, answer.text
        receipt: dict[str, Any] = answer.json()
        return receipt

    def contact(self) -> dict[str, Any]:
        """Return the contact, which there must be."""
        answer = self.get("/contact")
        assert answer.status_code == 200, answer.text
        contact: dict[str, Any] = answer.json()
        return contact

    def problem(self, path: str = "/contact") -> str:
        """Return the kind of the problem that there must be."""
        return kind(self.get(path))

    def metrics(self) -> str:
        return self.get("/metrics").text


def surface_of(name: str = "press-7", section: SurfaceSection | None = None, **model: Unpack[ModelOptions]) -> Surface:
    """Return a surface with a model of `model_of`."""
    return surface_with(model_of(**model), name, section)


def surface_with(model: ModelFile | None, name: str = "press-7", section: SurfaceSection | None = None) -> Surface:
    """Return a surface with this model, or without one."""
    return Surface(name, model, section or SurfaceSection())


def batch_of(
    *rows: Row,
    sequence: int = 1,
    age_ms: float = 0.0,
    boot_id: str = "boot-0001",
    channels: list[str] | None = None,
    quality: list[str] | None = None,
    begin_us: int = START_US,
    every_us: int = 5000,
) -> dict[str, Any]:
    """One batch of samples numbered from `sequence` on, one per row of deflections, so far apart."""
    rows = rows or ([0.5, 0.25, 0.125],)
    samples = [
        {
            "sequence": sequence + i,
            "acquired_unix_us": begin_us + i * every_us,
            "deflection_mm": row,
            "quality": quality or ["good"] * len(row),
        }
        for i, row in enumerate(rows)
    ]
    names = channels or [f"s{i + 1}" for i in range(len(rows[0]))]
    return {"boot_id": boot_id, "channels": names, "newest_age_ms": age_ms, "samples": samples}


def parsed(*rows: Row, **options: Unpack[BatchOptions]) -> Batch:
    """Return the same as the service reads it."""
    return Batch.model_validate(batch_of(*rows, **options))


def kind(response: httpx2.Response) -> str:
    """Check that an answer is a whole problem, and return the last part of its type."""
    body = response.json()
    assert response.headers["content-type"] == "application/problem+json"
    assert response.headers["cache-control"] == "no-store"
    assert body["status"] == response.status_code
    assert body["title"]
    assert body["detail"]
    return str(body["type"]).removeprefix("urn:beamtouch:problem:")
