"""The page below a path of nginx and of HAProxy, with the lines of the guide, in a real browser."""

import json
import re
import signal
import subprocess
from collections.abc import Callable, Iterator
from itertools import count
from pathlib import Path
from urllib.parse import urljoin

import httpx2
import pytest

from service.bench import READ_TOKEN, TOKEN, BuildModel, batch_of
from service.event_story import TOUCHING
from service.process.beam_page import StartBench
from service.process.conftest import Service, StartService
from service.process.nginx import Nginx, nginx_in
from service.process.replica_plant import CONTACT, SURFACES, Plant
from service.process.test_page_commissioning import FORCE_N, HELD
from service.process.test_page_token import enter
from support.network.balancer import answers
from support.network.free_ports import free_port
from support.network.plain_http import TIMEOUT_S
from support.pages.browser import NO_FIGURE, OpenPage, Watched
from support.pages.pasted import ROOT, blocks_of
from support.running.debian_parts import require
from support.running.waiting import wait_until

GUIDE = "docs/how-to/proxy.md"
PLAIN, WITH_LOGIN = [block.text for block in blocks_of(GUIDE) if block.word == "nginx"]
HAPROXY, *_ = [block.text for block in blocks_of(GUIDE) if block.word == "haproxy"]
HELD_BACK = """
    location /touch/ {
        proxy_pass http://127.0.0.1:8420/;
        proxy_ignore_headers X-Accel-Buffering;
        gzip on;
        gzip_proxied any;
        gzip_types text/event-stream;
    }
"""
Below = Callable[[Service], str]
"""Starts a proxy in front of a service, and returns the address of the page."""


def lines_for(service: Service, lines: str = PLAIN, path: str = "/touch/") -> str:
    """Return lines of nginx that have this service below this path."""
    assert "127.0.0.1:8420" in lines
    return lines.replace("127.0.0.1:8420", f"127.0.0.1:{service.port}").replace("/touch/", path)


@pytest.fixture
def nginx(tmp_path: Path) -> Iterator[Nginx]:
    with nginx_in(tmp_path / "nginx") as nginx:
        yield nginx


@pytest.fixture(params=["nginx", "haproxy"])
def below(request: pytest.FixtureRequest, nginx: Nginx, tmp_path: Path) -> Iterator[Below]:
    started: list[subprocess.Popen[bytes]] = []

    def start(service: Service) -> str:
        if request.param == "nginx":
            nginx.start(lines_for(service))
            return nginx.url
        port = free_port()
        text = (ROOT / "deploy" / "haproxy-one.cfg").read_text().replace("127.0.0.1:8420", f"127.0.0.1:{service.port}")
        text = re.sub(r"bind :8443 ssl .*", f"bind 127.0.0.1:{port}", text)
        text = text.replace("    default_backend", f"{HAPROXY}    default_backend")
        (tmp_path / "haproxy.cfg").write_text(text)
        program = require("haproxy", "haproxy")
        started.append(subprocess.Popen([program, "-f", tmp_path / "haproxy.cfg"], stderr=subprocess.DEVNULL))
        wait_until(lambda: answers(f"http://127.0.0.1:{port}/touch"))
        return f"http://127.0.0.1:{port}"

    yield start
    for process in started:
        process.kill()
        process.wait(60)


def get(url: str) -> httpx2.Response:
    return httpx2.get(url, trust_env=False, timeout=TIMEOUT_S)


@pytest.mark.promise("docs/reference/page.md", "A proxy may have the page below a path of its own.")
@pytest.mark.promise(
    "docs/how-to/proxy.md",
    "All links on the page are relative, so the service does not need to know the path",
)
def test_all_of_the_page_comes_from_below_the_path(
    start_press: StartService, below: Below, open_page: OpenPage
) -> None:
    service = start_press(sections="[surfaces.press-8]")
    service.post(batch_of([0.0, 0.0, 0.0], [0.5, 0.25, 0.125], [0.0, 0.0, 0.0], [0.5, 0.25, 0.125]))
    base = below(service)
    # Without the slash: the proxy sends the browser on.
    seen = open_page(base, "/touch")
    seen.wait_for_state("contact")
    assert (seen.page.url, seen.text("position")) == (f"{base}/touch/", "150.0")
    seen.page.wait_for_selector("#events tr")
    seen.wait_for_text("beam-words", "Circles")
    seen.page.select_option("#chooser", "press-8")
    seen.wait_for_text("headline", "The surface has no model")
    assert seen.page.url == f"{base}/touch/?surface=press-8"
    seen.page.go_back()
    seen.wait_for_state("contact")

    needs_attention, *links = seen.page.eval_on_selector_all("a[href]", "all => all.map(one => one.href)")
    assert needs_attention == f"{base}/touch/?surface=press-8"
    assert links == [f"{base}/touch/contact?surface=press-7", f"{base}/touch/openapi.json"]
    contact, description = map(get, links)
    assert contact.json()["position_mm"] == 150
    (server,) = description.json()["servers"]
    assert urljoin(links[1], server["url"]) == f"{base}/touch/"
    assert {path for path in seen.requests if not path.startswith(f"{base}/touch")} == set()
    assert seen.complaints == []


@pytest.mark.parametrize("below", ["nginx", pytest.param("haproxy", marks=pytest.mark.soak)], indirect=True)
def test_a_technician_commissions_below_the_path(start_bench: StartBench, below: Below, open_page: OpenPage) -> None:
    bench = start_bench()

    def send(*loads: tuple[float, float]) -> None:
        for _ in range(HELD):
            bench.send(list(bench.deflection_mm(*loads)))

    send()
    seen = open_page(below(bench.service), "/touch/")
    seen.wait_for_state("clear")
    seen.page.click("#commissioning-open")
    seen.page.fill("#commissioning-token", TOKEN)
    seen.page.keyboard.press("Enter")
    seen.wait_for_text("commissioning-prompt", "Take everything off")
    send()
    for _ in range(bench.service.get("/surfaces/press-7/commissioning").json()["run"]["steps"]):
        seen.wait_for_text("commissioning-prompt", "Press")
        at_mm = bench.service.get("/surfaces/press-7/commissioning").json()["run"]["at_mm"]
        send((at_mm["position"], FORCE_N))
        seen.wait_for_text("commissioning-prompt", "Lift")
        send()
    seen.wait_for_text("commissioning-prompt", "Every step is done")
    seen.page.fill("#commissioning-by", "Ann")
    seen.page.click("#commissioning-confirm button")
    seen.wait_for_text("commissioning-newest-words", "On record")
    with seen.page.expect_download() as waiting:
        seen.page.click("#commissioning-json")
    assert json.loads(Path(waiting.value.path()).read_text())["by"] == "Ann"


@pytest.mark.soak
def test_the_page_of_several_services_below_a_path(
    start_service: StartService,
    build_model: BuildModel,
    token_file: Path,
    events_url: str,
    open_page: OpenPage,
    tmp_path: Path,
) -> None:
    surfaces = "".join(f"[surfaces.{name}]\nmodel = '{build_model()}'\nstale_ms = 60000\n" for name in SURFACES)
    server = f"[server]\nreplica = true\nwrite_token_file = '{token_file}'\n"
    (tmp_path / "service.toml").write_text(f"{server}[events]\nurl = '{events_url}'\n{surfaces}")
    plant = Plant(tmp_path, [start_service("--config", "service.toml") for _ in range(2)], HAPROXY)
    plant.balancer.start()
    try:
        for name in SURFACES:
            plant.deliver(name, *CONTACT, TOUCHING)
        base = plant.balancer.url
        seen = open_page(base, "/touch")
        for name in SURFACES:
            seen.wait_for_text("headline", "Contact")
            seen.page.wait_for_selector("#events tr")
            seen.page.select_option("#chooser", name)
            seen.page.wait_for_function("name => document.title.includes(name)", arg=name)
        assert plant.get("/touch/contact?surface=press-3").json()["surface"] == "press-3"
        assert {url for url in seen.requests if not url.startswith(f"{base}/touch")} == set()
        # The list of surfaces is refused by each service, and has all names: the browser notes that.
        assert [text for text in seen.complaints if "status of 421" not in text] == []
    finally:
        plant.balancer.stop()


@pytest.mark.promise("docs/how-to/proxy.md", "A 503 of the service is an answer: its body says why there is no contact")
def test_programs_get_the_answers_of_the_service_through_nginx(fresh: Service, nginx: Nginx) -> None:
    nginx.start(lines_for(fresh))
    base, headers = f"{nginx.url}/touch", {"Authorization": f"Bearer {TOKEN}"}
    refused = get(f"{base}/contact")
    assert (refused.status_code, refused.json()["type"]) == (503, "urn:beamtouch:problem:no-samples")
    for size, status in ((2**20 - 100, 400), (2**20 + 1, 413)):
        url = f"{base}/surfaces/press-7/samples"
        answer = httpx2.post(url, content=b" " * size, headers=headers, trust_env=False, timeout=TIMEOUT_S)
        assert (answer.status_code, answer.headers["content-type"]) == (status, "application/problem+json")
    # The stream arrives event by event, though nginx would gather several of this size.
    with httpx2.stream("GET", f"{base}/stream", trust_env=False, timeout=TIMEOUT_S) as stream:
        events = (json.loads(line.removeprefix("data: ")) for line in stream.iter_lines() if line.startswith("data: "))
        assert next(events)["problem"]["type"] == "urn:beamtouch:problem:no-samples"
        fresh.post(batch_of())
        assert next(one for one in events if one["contact"])["contact"]["position_mm"] == 150


@pytest.mark.soak
@pytest.mark.promise("docs/how-to/proxy.md", "It keeps the token for its own path only.")
def test_two_services_below_one_host_keep_a_token_each(
    start_service: StartService, nginx: Nginx, open_page: OpenPage, tmp_path: Path
) -> None:
    services = []
    for place, token in (("one", READ_TOKEN), ("two", f"{READ_TOKEN}-of-the-other")):
        (tmp_path / f"{place}.token").write_text(token)
        (tmp_path / f"{place}.toml").write_text(f"[surfaces.{place}]\n")
        read = ("--read-token-file", tmp_path / f"{place}.token")
        services.append((start_service("--config", f"{place}.toml", *read), place, token))
    nginx.start("".join(lines_for(service, path=f"/{place}/") for service, place, _ in services))
    seen = open_page(nginx.url, "/one/")
    for _, place, token in services:
        seen.page.goto(f"{nginx.url}/{place}/")
        enter(seen, token, keep=True)
        seen.wait_for_text("surface", place)
    for _, place, _ in services:
        seen.page.goto(f"{nginx.url}/{place}/")
        seen.wait_for_text("surface", place)
        seen.wait_for_state("problem")


LOGIN_PAGE = 'default_type text/html; return 200 "<html>Who are you?</html>";'


@pytest.mark.promise(
    "docs/how-to/proxy.md",
    "`A proxy asks for a login (401): load this page again.`",
    "`A proxy answers with a page of its own, perhaps a login: load this page again.`",
)
@pytest.mark.parametrize(
    ("lines", "said"),
    [
        ("location / { return 502; }", "A proxy does not reach the service (502). Trying again."),
        ("location / { return 504; }", "A proxy does not reach the service (504). Trying again."),
        ("location / { return 403; }", "A proxy asks for a login (403): load this page again. Trying again."),
        ("location / { return 302 http://127.0.0.1:9/login; }", "perhaps a login: load this page again. Trying again."),
        (f"location / {{ {LOGIN_PAGE} }}", "perhaps a login: load this page again. Trying again."),
        ("location / { return 404; }", "A proxy answers in place of the service (404). Trying again."),
    ],
    ids=["bad-gateway", "timeout", "forbidden", "redirected", "login-page", "not-found"],
)
def test_the_page_says_what_a_proxy_answers_in_place_of_the_service(
    fresh: Service, nginx: Nginx, open_page: OpenPage, lines: str, said: str
) -> None:
    nginx.start(lines_for(fresh))
    fresh.post(batch_of())
    seen = open_page(nginx.url, "/touch/")
    seen.wait_for_state("contact")
    seen.watch()
    nginx.start(lines)
    seen.wait_for_text("detail", said)
    assert seen.text("headline").startswith("No connection since")
    assert seen.text("position") == NO_FIGURE
    nginx.start(lines_for(fresh))
    seen.wait_for_state("contact")
    assert seen.wrongs() == []


@pytest.mark.soak
def test_a_service_that_goes_and_comes_back_behind_the_proxy(
    fresh: Service, start_press: StartService, nginx: Nginx, open_page: OpenPage
) -> None:
    nginx.start(lines_for(fresh))
    fresh.post(batch_of())
    seen = open_page(nginx.url, "/touch/")
    seen.wait_for_state("contact")
    fresh.stop(signal.SIGKILL)
    seen.wait_for_text("detail", "A proxy does not reach the service (502).")
    start_press("--port", str(fresh.port)).post(batch_of())
    seen.wait_for_state("contact")


@pytest.mark.promise(
    "docs/how-to/proxy.md",
    "`The service answers, but its stream does not arrive. A proxy may hold it back.`",
)
def test_a_stream_that_a_proxy_holds_back_is_named(fresh: Service, nginx: Nginx, open_page: OpenPage) -> None:
    nginx.start(lines_for(fresh, HELD_BACK))
    numbers = count(1)
    seen = open_page(nginx.url, "/touch/", is_patient=False)

    def is_said() -> bool:
        """Send a sample; return whether the page says what is wrong."""
        fresh.post(batch_of(sequence=next(numbers)))
        return "its stream does not arrive. A proxy may hold it back." in seen.text("detail")

    wait_until(is_said, pause_s=0.2)
    assert seen.text("position") == NO_FIGURE


@pytest.mark.promise("docs/how-to/proxy.md", "So let nginx have the read token, and the page needs none")
@pytest.mark.parametrize("is_in_address", [False, True], ids=["typed", "in-the-address"])
def test_behind_a_login_of_nginx_the_page_needs_no_token(
    start_press: StartService, nginx: Nginx, open_page: OpenPage, tmp_path: Path, *, is_in_address: bool
) -> None:
    service = start_press(read=READ_TOKEN)
    service.post(batch_of())
    (tmp_path / "hall.users").write_text("ann:{PLAIN}of-the-hall\n")
    lines = lines_for(service, WITH_LOGIN).replace("/etc/nginx/hall.users", str(tmp_path / "hall.users"))
    assert "READ-TOKEN" in lines
    nginx.start(lines.replace("READ-TOKEN", READ_TOKEN))
    assert get(f"{nginx.url}/touch/").status_code == 401
    # A panel, where nobody types, has the login in the address of the page.
    base = nginx.url.replace("://", "://ann:of-the-hall@") if is_in_address else nginx.url
    login = {"username": "ann", "password": "of-the-hall"}
    seen: Watched = open_page(base, "/touch/", http_credentials=login)
    seen.wait_for_state("contact")
    assert seen.text("position") == "150.0"
    assert not seen.page.is_visible("#token-form, #forget, #with-token")
