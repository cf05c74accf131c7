"""The trail of a day: twenty changes of all kinds, by three named tokens and by the service, in order and in time."""

import signal
from collections.abc import Callable
from datetime import UTC, datetime, timedelta
from functools import partial
from pathlib import Path
from typing import Any

import httpx2
import pytest

from beamtouch_common.files import digest_of
from service.bench import PATIENT, BuildModel, Row, batch_of
from service.event_story import RESTING, TOUCHING
from service.process.conftest import Service, StartService
from service.record_file import execute
from support.network.plain_http import TIMEOUT_S
from support.running.waiting import wait_until

HALL, SPARE, ANN = "hall-horse-battery-staple", "spare-horse-battery-staple", "ann-horse-battery-staple"
SURFACES = ("press-7", "press-8")
TIDIES_OFTEN = f"{PATIENT}; recorder.TIDY_S = 0.1"
Told = tuple[str, str | None, str, dict[str, Any]]
"""Action, surface, who, and details."""


class Day:
    """A service, and what happens to it: each step is on the trail before the next one."""

    def __init__(self, folder: Path, start: StartService, build: BuildModel) -> None:
        self.folder, self._start, self._build = folder, start, build
        (folder / "writers").write_text(f"hall {HALL}\nspare {SPARE}\n")
        (folder / "admins").write_text(f"ann {ANN}\n")
        self.models = [build(name=f"model-{number}").read_bytes() for number in (1, 2)]
        for surface in SURFACES:
            (folder / f"{surface}.onnx").write_bytes(self.models[0])
        self.service: Service | None = None
        self._sequences = dict.fromkeys(SURFACES, 0)

    def start(self, events: str = "") -> None:
        """Start the service with these further lines of `[events]`, in the place of the one before."""
        if self.service:
            assert self.service.stop(signal.SIGTERM)[0] == 0
        surfaces = [f"[surfaces.{one}]\nmodel = '{one}.onnx'\nstale_ms = 60000\n" for one in SURFACES]
        (self.folder / "service.toml").write_text(
            "[server]\nwrite_token_file = 'writers'\nadmin_token_file = 'admins'\ntrusted_proxies = ['127.0.0.1']\n"
            f"[events]\nfile = 'events.db'\n{events}{''.join(surfaces)}"
        )
        self.service = self._start("--config", "service.toml", code=TIDIES_OFTEN)

    def post(self, path: str, token: str, body: object = None, address: str = "") -> None:
        assert self.service
        headers = {"Authorization": f"Bearer {token}"} | ({"X-Forwarded-For": address} if address else {})
        url = f"{self.service.url}/surfaces/{path}"
        answer = httpx2.post(url, json=body, headers=headers, trust_env=False, timeout=TIMEOUT_S)
        assert answer.is_success, answer.text

    def send(self, surface: str, token: str, characteristic: str, *rows: Row, address: str = "") -> None:
        """Send a daemon's samples with these rest gaps."""
        first, boot = self._sequences[surface] + 1, f"boot-{surface}"
        self._sequences[surface] += len(rows or [RESTING])
        batch = batch_of(*rows or [RESTING], sequence=first, boot_id=boot)
        self.post(f"{surface}/samples", token, batch | {"oldest": first, "characteristic": characteristic}, address)

    def commission(self, *steps: str) -> None:
        """Let ann begin a commissioning, and do these steps with it."""
        assert self.service
        self.post("press-7/commissioning", ANN)
        run = self.service.get("/surfaces/press-7/commissioning").json()["run"]["id"]
        for step in steps:
            self.post(f"press-7/commissioning/{step}?run={run}", ANN)

    def replace_model(self) -> None:
        (self.folder / "press-7.onnx").write_bytes(self.models[1])

    def page(self) -> dict[str, Any]:
        assert self.service
        page: dict[str, Any] = self.service.get("/audit", ANN).json()
        return page

    def has(self, count: int) -> bool:
        """Return whether so many entries are on the trail."""
        return len(self.entries()) >= count

    def entries(self) -> list[dict[str, Any]]:
        """Return the entries of the trail, oldest first."""
        return list(self.page()["entries"][::-1])


@pytest.mark.soak
@pytest.mark.promise("docs/reference/trail.md", "The record also says who changed what and when.")
def test_twenty_changes_by_three_tokens_and_the_service_are_told_in_order(
    start_service: StartService, build_model: BuildModel, tmp_path: Path
) -> None:
    day = Day(tmp_path, start_service, build_model)

    def tare(surface: str, by: str, characteristic: str) -> Told:
        return "tare", surface, by, {"characteristic": characteristic, "tared_at": None}

    def commissioning(step: str) -> Told:
        return "commissioning", "press-7", "ann", {"step": step}

    def model(surface: str) -> Told:
        return (
            "model",
            surface,
            "service",
            {"model": day.service and day.service.get(f"/surfaces/{surface}").json()["model"]},
        )

    def start() -> Told:
        return "start", None, "service", {"config_sha256": digest_of(tmp_path / "service.toml")}

    contact = [RESTING, *[TOUCHING] * 5, RESTING]
    story: list[tuple[Callable[[], None], Callable[[], list[Told]]]] = [
        (day.start, lambda: [start(), model("press-7"), model("press-8")]),
        (
            lambda: day.send("press-7", HALL, "c1", *contact),
            lambda: [("token", None, "hall", {}), tare("press-7", "hall", "c1")],
        ),
        (lambda: day.send("press-7", HALL, "c2"), lambda: [tare("press-7", "hall", "c2")]),
        (
            lambda: day.send("press-8", SPARE, "d1"),
            lambda: [("token", None, "spare", {}), tare("press-8", "spare", "d1")],
        ),
        (
            lambda: day.commission("abandon"),
            lambda: [("token", None, "ann", {}), commissioning("begun"), commissioning("abandoned")],
        ),
        (day.replace_model, lambda: [model("press-7")]),
        (lambda: day.send("press-8", SPARE, "d2"), lambda: [tare("press-8", "spare", "d2")]),
        (
            lambda: day.start("keep_days = 1e-6\n"),
            lambda: [start(), ("deletion", None, "service", {"too_old": 1, "beyond_max_mb": 0})],
        ),
        (lambda: day.send("press-7", HALL, "c3"), lambda: [tare("press-7", "hall", "c3")]),
        (
            lambda: day.send("press-8", HALL, "d3", address="10.9.0.7"),
            lambda: [("token", None, "hall", {}), tare("press-8", "hall", "d3")],
        ),
        (
            lambda: day.commission("abandon"),
            lambda: [commissioning("begun"), commissioning("abandoned")],
        ),
    ]
    expected, spans = list[Told](), list[tuple[datetime, datetime]]()
    for act, tell in story:
        began = datetime.now(UTC)
        act()
        count = len(expected) + len(tell())
        wait_until(partial(day.has, count))
        expected += tell()
        spans += [(began - timedelta(milliseconds=1), datetime.now(UTC))] * (count - len(spans))

    page, entries = day.page(), day.entries()
    assert len(entries) == len(expected) == 20
    assert [one["number"] for one in entries] == list(range(1, 21))
    for entry, (action, surface, by, details), (earliest, latest) in zip(entries, expected, spans, strict=True):
        assert (entry["action"], entry["surface"], entry["by"]) == (action, surface, by), entry
        assert entry["details"].items() >= details.items(), entry
        assert entry["token"] == (None if by == "service" else by)
        assert earliest <= datetime.fromisoformat(entry["at"]) <= latest, entry
    assert [one["address"] for one in entries if one["action"] == "token"] == ["127.0.0.1"] * 3 + ["10.9.0.7"]
    assert (page["chain"]["holds"], page["chain"]["entries"]) == (True, 20)

    execute(tmp_path / "events.db", "UPDATE trail SET by = 'hall' WHERE number = 13")
    chain = day.page()["chain"]
    assert (chain["holds"], chain["breaks_at"], chain["entries"]) == (False, 13, 12)
