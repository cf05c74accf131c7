"""The trail of a running service: what it notes by itself, and the users that a real HAProxy in front of it names."""

import os
import re
import signal
import subprocess
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import httpx2
import pytest

from beamtouch_common.files import digest_of
from service.bench import ADMIN_TOKEN, READ_TOKEN, TOKEN, BuildModel, batch_of
from service.process.conftest import Service, StartService
from support.network.free_ports import free_port
from support.network.plain_http import TIMEOUT_S
from support.running.debian_parts import require
from support.running.waiting import wait_until

PAGE = Path(__file__).parents[3] / "docs" / "how-to" / "proxy.md"
TOKENS = "admin_token_file = 'admin-token'\ntrusted_proxies = ['127.0.0.1']\n"
RECORD = "[events]\nfile = 'events.db'\n"


def entries(service: Service, query: str = "") -> list[dict[str, Any]]:
    """Return the entries of the trail, oldest first."""
    page = service.get(f"/audit{query}", ADMIN_TOKEN).json()
    assert query or page["chain"]["holds"]
    found: list[dict[str, Any]] = page["entries"][::-1]
    return found


@pytest.fixture(autouse=True)
def _admin_token(tmp_path: Path) -> None:
    (tmp_path / "admin-token").write_text(f"ann {ADMIN_TOKEN}\n")


def test_a_start_another_configuration_and_another_model_are_on_the_trail(
    start_press: StartService, build_model: BuildModel, tmp_path: Path
) -> None:
    def start(server: str = TOKENS) -> Service:
        return start_press(server=server, sections=RECORD)

    service, config = start(), tmp_path / "service.toml"
    wait_until(lambda: len(entries(service)) == 2)
    first, model = entries(service)
    assert (first["action"], first["by"]) == ("start", "service")
    assert first["details"]["config_sha256"] == digest_of(config)
    assert first["details"]["tokens"] == {"write": ["write"], "read": [], "admin": ["ann"]}
    assert first["details"]["options"] == {"port": 0}
    assert service.stop(signal.SIGTERM)[0] == 0

    # The same again says nothing; another configuration does.
    service = start()
    wait_until(lambda: service.get("/health/live").is_success)
    assert [one["number"] for one in entries(service)] == [1, 2]
    service.stop(signal.SIGTERM)
    service = start(f"{TOKENS}max_streams = 3\n")
    wait_until(lambda: len(entries(service)) == 3)
    assert entries(service)[2]["details"]["config_sha256"] == digest_of(config)

    # A new model file, in the place of the old one.
    service.post(batch_of())
    path = Path(re.findall(r"model = '(.*)'", config.read_text())[0])
    path.write_bytes(build_model(name="other").read_bytes())
    wait_until(lambda: len(entries(service, "?action=model")) == 2)
    assert [one["details"]["model"] for one in entries(service, "?action=model")] == [
        model["details"]["model"],
        service.get("/surfaces/press-7").json()["model"],
    ]


@pytest.fixture
def front(start_press: StartService, tmp_path: Path) -> Iterator[tuple[Service, str]]:
    """A service, and the address of HAProxy in front of it, with users as the page has them."""
    service, port = start_press(server=TOKENS, read=READ_TOKEN, sections=RECORD), free_port()
    users, rules = re.findall(r"```haproxy\n((?:userlist|    # Only).*?)```", PAGE.read_text(), re.DOTALL)
    text = (
        f"defaults\n    mode http\n    timeout client 20s\n    timeout server 20s\n    timeout connect 5s\n"
        f"    option forwardfor\n{users}\nfrontend front\n    bind 127.0.0.1:{port}\n{rules}"
        f"    default_backend service\nbackend service\n    server one 127.0.0.1:{service.port}\n"
    )
    path = tmp_path / "haproxy.cfg"
    path.write_text(text)
    environment = os.environ | {"READ_TOKEN": READ_TOKEN, "ADMIN_TOKEN": ADMIN_TOKEN}
    process = subprocess.Popen([require("haproxy", "haproxy"), "-f", path], env=environment)
    url = f"http://127.0.0.1:{port}"
    try:
        wait_until(lambda: _answers(url))
        yield service, url
    finally:
        process.kill()
        process.wait(60)


def _answers(url: str) -> bool:
    try:
        return httpx2.get(f"{url}/health/live", trust_env=False).status_code in (200, 401)
    except httpx2.TransportError:
        return False


def ask(url: str, method: str, path: str, user: str | None = None, **headers: str) -> httpx2.Response:
    login = (user, "correct-horse") if user else None
    return httpx2.request(method, url + path, auth=login, headers=headers, trust_env=False, timeout=TIMEOUT_S)


def test_users_of_a_proxy_are_on_the_trail_and_nobody_else_can_take_their_names(front: tuple[Service, str]) -> None:
    service, url = front
    forged = {"X-Forwarded-User": "ann", "X-Forwarded-For": "10.9.0.7"}
    assert service.post(batch_of([0.0, 0.0, 0.0])).is_success
    assert ask(url, "GET", "/contact").status_code == 401
    assert ask(url, "GET", "/contact", "eve").status_code == 401
    assert ask(url, "GET", "/contact", "ben", **forged).status_code == 200
    begin = "/surfaces/press-7/commissioning"
    assert ask(url, "POST", begin, "ben", **forged).status_code == 403
    assert ask(url, "POST", begin, "ann").status_code == 200
    # A program with a token of its own, which says that it is somebody.
    answer = httpx2.post(
        f"{url}/surfaces/press-7/samples",
        json=batch_of(sequence=2),
        headers={"Authorization": f"Bearer {TOKEN}"} | forged,
        trust_env=False,
    )
    assert answer.is_success
    wait_until(lambda: len(entries(service, "?action=commissioning")) == 1)
    (begun,) = entries(service, "?action=commissioning")
    assert (begun["by"], begun["token"], begun["address"]) == ("ann", "ann", "127.0.0.1")
    assert {(one["by"], one["token"]) for one in entries(service, "?action=token")} == {
        ("write", "write"),
        ("ann", "ann"),
    }
