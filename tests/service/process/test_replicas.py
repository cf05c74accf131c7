"""Services that share surfaces, behind HAProxy and with one PostgreSQL: one is killed, the database stops."""

import os
import signal
from collections.abc import Iterator
from contextlib import closing
from http.client import HTTPConnection
from pathlib import Path

import httpx2
import pytest

from service.bench import BuildModel, kind
from service.event_story import RESTING, TOUCHING
from service.postgres import PASSWORD, Postgres, rows
from service.process.conftest import StartService
from support.network.plain_http import TIMEOUT_S
from support.running.waiting import wait_until

from .replica_plant import CONTACT, SURFACES, Plant

WHOLE = ("/contact", "/stream", "/surfaces", "/health/ready")


@pytest.fixture
def config(tmp_path: Path, build_model: BuildModel, token_file: Path, events_url: str) -> Path:
    path = tmp_path / "service.toml"
    model = build_model()
    surfaces = "".join(f"[surfaces.{name}]\nmodel = '{model}'\nstale_ms = 60000\n" for name in SURFACES)
    server = f"[server]\nreplica = true\nwrite_token_file = '{token_file}'\n"
    path.write_text(f"{server}[events]\nurl = '{events_url}'\n{surfaces}")
    return path


@pytest.fixture
def plant(start_service: StartService, config: Path) -> Iterator[Plant]:
    plant = Plant(config.parent, [start_service("--config", config) for _ in range(2)])
    plant.balancer.start()
    yield plant
    plant.balancer.stop()


@pytest.mark.promise(
    "deploy/README.md",
    "When a service dies, the others get its surfaces",
    "What it could answer only for a part of the plant it refuses with 421 `wrong-replica`",
    "`/contact`, `/stream`, `/surfaces` and `/health/ready`. The member `surfaces` has all names.",
    "so they work too.",
)
@pytest.mark.promise("docs/reference/problems.md", "the service is a replica, and the question is about all surfaces.")
def test_another_service_takes_over_the_surfaces_of_a_dead_one(plant: Plant) -> None:
    for name in SURFACES:
        plant.deliver(name, *CONTACT)
    first, second = (plant.having(service) for service in plant.services)
    assert first | second == set(SURFACES)
    assert not first & second
    assert first
    assert second
    require_one_service_in_whatever_form_an_address_comes(plant)
    require_questions_about_all_surfaces_answered_for_all_or_refused(plant)

    plant.services[0].stop(signal.SIGKILL)
    for name in second:
        assert plant.get(f"/surfaces/{name}/contact").json()["sequence"] == 4
    for name in SURFACES:
        plant.deliver(name, *CONTACT)
        assert plant.get(f"/contact?surface={name}").json()["sequence"] == 8
    assert plant.having(plant.services[1]) == set(SURFACES)
    whole = sorted((name, "touch", "lift", 2) for name in SURFACES * 2)

    def recorded() -> list[tuple[object, ...]]:
        found = plant.events(2 * len(SURFACES))
        return sorted((one["surface"], one["begin"], one["end"], one["samples"]) for one in found)

    wait_until(lambda: recorded() == whole)


def require_one_service_in_whatever_form_an_address_comes(plant: Plant) -> None:
    host = plant.balancer.url.removeprefix("http://")
    for name in SURFACES:
        path = f"/surfaces/{name}/contact"
        # As to a proxy. HTTP/2 has the address of the server in each request, too.
        for target in (path, f"{plant.balancer.url}{path}", path.replace("-", "%2D"), f"{path}?a=b/c"):
            with closing(HTTPConnection(host, timeout=TIMEOUT_S)) as connection:
                connection.request("GET", target)
                assert (target, connection.getresponse().status) == (target, 200)


def require_questions_about_all_surfaces_answered_for_all_or_refused(plant: Plant) -> None:
    for path in WHOLE:
        refusal = plant.get(path)
        assert (refusal.status_code, kind(refusal)) == (421, "wrong-replica")
        assert refusal.json()["surfaces"] == SURFACES
    # Without the balancer, the query form reaches any service.
    assert kind(plant.services[0].get(f"/contact?surface={SURFACES[0]}")) == "wrong-replica"
    metrics = plant.get("/metrics")
    assert (metrics.status_code, metrics.json()["type"]) == (421, "urn:beamtouch:problem:wrong-replica")
    assert plant.services[0].get("/metrics").status_code == 200

    for name in SURFACES:
        assert plant.get(f"/contact?surface={name}").json()["surface"] == name
        assert plant.get(f"/surfaces/{name}").json()["samples"]["accepted"] == 4
    plant.events(len(SURFACES))
    for service in plant.services:
        # What one service recorded, each of them answers.
        assert {event["surface"] for event in service.get("/events").json()["events"]} == set(SURFACES)
    assert "beamtouch" in plant.get("/").text.lower()
    (name, *_) = SURFACES
    with httpx2.stream("GET", f"{plant.balancer.url}/stream?surface={name}", trust_env=False) as stream:
        assert next(line for line in stream.iter_lines() if line.startswith("data: ")).startswith(
            f'data: {{"surface": "{name}"'
        )


@pytest.mark.promise(
    "deploy/README.md",
    "Contacts go on. The daemons keep the samples until the record has them; `GET /events` answers 503.",
)
def test_answers_go_on_while_the_database_is_away_and_its_events_come_later(plant: Plant, postgres: Postgres) -> None:
    name = SURFACES[0]
    plant.deliver(name, *CONTACT)
    assert len(plant.events(1)) == 1
    postgres.stop(signal.SIGQUIT)
    try:
        plant.deliver(name, RESTING, TOUCHING)
        assert plant.get(f"/surfaces/{name}/contact").json()["state"] == "contact"
        refusal = plant.get("/events")
        assert (refusal.status_code, kind(refusal)) == (503, "record-unavailable")
        assert refusal.headers["retry-after"] == "1"
        plant.deliver(name, TOUCHING, RESTING)
        owner = next(service for service in plant.services if name in plant.having(service))
        wait_until(lambda: "beamtouch_record_outages_total 1.0" in owner.get("/metrics").text)
    finally:
        postgres.start()
    wait_until(lambda: plant.get("/events").is_success)
    whole = [("touch", "lift", 2)] * 2
    wait_until(lambda: [(one["begin"], one["end"], one["samples"]) for one in plant.events(2)] == whole)
    wait_until(lambda: f'beamtouch_record_samples_waiting{{surface="{name}"}} 0.0' in owner.get("/metrics").text)
    code, errors = owner.stop(signal.SIGTERM)
    assert code == 0
    assert errors.count("the record of events is away") == 1
    assert PASSWORD not in errors
    assert "Traceback" not in errors


@pytest.mark.promise(
    "deploy/README.md",
    "The same; `GET /events` answers 503 after some seconds.",
)
def test_answers_go_on_while_the_database_is_frozen_and_nothing_is_lost(plant: Plant, config: Path) -> None:
    name, url = SURFACES[0], config.read_text().partition("url = '")[2].partition("'")[0]
    plant.deliver(name, *CONTACT)
    assert len(plant.events(1)) == 1
    backends = rows(url, "SELECT pid FROM pg_stat_activity WHERE application_name = 'beamtouch-service'")
    for (pid,) in backends:
        os.kill(pid, signal.SIGSTOP)
    try:
        for row, state in ((TOUCHING, "contact"), (RESTING, "clear"), (TOUCHING, "contact")):
            plant.deliver(name, row)
            assert plant.get(f"/surfaces/{name}/contact").json()["state"] == state
    finally:
        for (pid,) in backends:
            os.kill(pid, signal.SIGCONT)
    plant.deliver(name, RESTING)
    wait_until(lambda: [event["end"] for event in plant.events(3)] == ["lift"] * 3)
