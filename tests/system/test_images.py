"""The images that `make images` has built: what they hold, and a line whose daemon and service run in them."""

import json
import os
import re
import signal
import subprocess
import tomllib
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any
from uuid import uuid4

import httpx2
import pytest
import tomli_w

from line import Kind, Surface
from support.network.free_ports import free_port
from support.network.plain_http import TIMEOUT_S
from support.programs.contained_line import CONTAINED, USER, Contained, podman_in
from support.programs.service_manager import Manager
from support.programs.toolchain import run
from support.running.debian_parts import give_up, require
from support.running.waiting import wait_until
from support.surfaces.example_scenes import SCENES

pytestmark = [pytest.mark.soak, pytest.mark.timeout(600)]

ROOT = Path(__file__).parents[2]
BUILT = ROOT / "build" / "images"
MakeLine = Callable[[Mapping[str, Any], Mapping[str, Sequence[str]]], Contained]
VERSION = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["version"]
MAX_MB = {"beamtouch-daemon": 60, "beamtouch-service": 120}
"""Largest size of an image as it is sent."""
NOT_IN_IT = ["/bin/sh", "/usr/bin/dpkg", "/usr/bin/design-sensors", "/usr/bin/beamtouch-rig"]
IMAGES = {program: f"localhost/{program}:{VERSION}" for program in MAX_MB}


def newest(program: str) -> Path:
    """Return the image of a program for this machine; without it, or if it is older than the code, gives up."""
    architecture = run(require("dpkg", "dpkg"), "--print-architecture").strip()
    image = BUILT / f"{program}_{architecture}.tar"
    sources = [
        ROOT / name
        for name in ("constraints.txt", "pyproject.toml", "packaging/environment.sh", "packaging/images/build")
    ]
    if not image.exists() or image.stat().st_mtime < max(path.stat().st_mtime for path in sources):
        give_up("the images are not built, or older than what they are made from; type: make images")
    return image


@pytest.fixture(scope="module")
def podman() -> Iterator[list[str]]:
    """The beginning of a command of podman, which has both images."""
    if os.getuid() != 0:
        give_up("only root can run containers on any machine")
    with TemporaryDirectory(prefix="podman-") as store:  # it takes paths of 50 characters at most
        command = podman_in(store, require("podman", "podman"), require("crun", "crun"))
        for program in MAX_MB:
            run(*command, "load", "--quiet", "--input", newest(program))
        yield command


@pytest.fixture
def make_line(tmp_path: Path, bench_model: Path, podman: list[str]) -> MakeLine:
    """A function that makes a line of two surfaces, as in the demo, each with a load at 150 mm that stays.

    It takes further sections of the configuration of the service, and options of the containers by program.
    """
    (tmp_path / "script.toml").write_text("[[step]]\nseconds = 600\nposition_mm = 150.0\nforce_n = 10.0\n")
    model = tmp_path / "bench.onnx"
    model.write_bytes(bench_model.read_bytes())
    kinds: dict[str, Kind] = {"bench": "modbus-tcp", "cable": "serial"}
    surfaces = [Surface(name, kind, tmp_path / "script.toml", ("--no-ringing",)) for name, kind in kinds.items()]
    os.chown(tmp_path, USER, USER)

    def make(sections: Mapping[str, Any], options: Mapping[str, Sequence[str]]) -> Contained:
        sections = {"events": {"file": "/var/lib/beamtouch/events.db"}, **sections}
        daemon_config = bench_model.with_suffix(".toml")
        line = Contained(tmp_path, SCENES / "bench.toml", model, daemon_config, surfaces, sections)
        line.podman, line.images, line.options = podman, IMAGES, options
        return line

    return make


@pytest.mark.promise("docs/how-to/containers.md", "to try a line, run a rig beside the containers")
def test_a_line_in_containers_finds_a_contact_and_ends_as_asked(make_line: MakeLine) -> None:
    with make_line({}, {}) as line:

        def answer(surface: str) -> dict[str, object]:
            response = httpx2.get(f"{line.url}/surfaces/{surface}/contact", timeout=TIMEOUT_S)
            return dict(response.json())

        def has_contact(surface: str) -> bool:
            return answer(surface).get("state") == "contact"

        for surface in ("bench", "cable"):
            wait_until(partial(has_contact, surface), pause_s=0.2)
            assert answer(surface)["position_mm"] == pytest.approx(150.0, abs=5.0)
        # The record is in a volume that podman has just made.
        events = f"{line.url}/events?kind=contact"
        wait_until(lambda: bool(httpx2.get(events, timeout=TIMEOUT_S).json().get("events")), pause_s=0.2)
        assert line.end("daemon") == 0
        assert line.end("service") == 0


PAGE = ROOT / "docs" / "how-to" / "containers.md"
QUADLET = ROOT / "deploy" / "containers" / "beamtouch-service.container"


@pytest.mark.promise("docs/how-to/containers.md", "that check fails as soon as samples stop")
def test_the_health_check_fails_once_no_samples_come(make_line: MakeLine, podman: list[str], tmp_path: Path) -> None:
    port, name = free_port(), f"beamtouch-{uuid4().hex}"
    ready, live = (re.findall(r"^HealthCmd=(.*)$", path.read_text(), re.MULTILINE)[0] for path in (PAGE, QUADLET))

    def ask(*command: str) -> int:
        return subprocess.run([*podman, *command], capture_output=True, check=False, timeout=120).returncode

    (tmp_path / "read-token").write_text("reading-horse-battery-staple")
    server = {"port": port, "write_token_file": "token", "read_token_file": "read-token"}
    # Without systemd, which runs the check every 30 s otherwise.
    health = ["--health-cmd", ready.replace("8420", str(port)), "--health-interval", "disable"]
    options = ["--name", name, "--volume", f"{tmp_path}/token:/run/secrets/token:ro", *health]
    with make_line({"server": server}, {"beamtouch-service": options}) as line:
        wait_until(lambda: ask("healthcheck", "run", name) == 0, pause_s=0.2)
        assert line.end("daemon") == 0
        wait_until(lambda: ask("healthcheck", "run", name) == 1, pause_s=0.2)
        # The process still answers, as the check of the unit asks.
        assert ask("exec", name, *json.loads(live.replace("8420", str(port)))) == 0
        assert line.end("service") == 0


@pytest.mark.promise("docs/how-to/containers.md", "no shell, no package manager, no root user")
@pytest.mark.parametrize("program", MAX_MB)
def test_an_image_is_small_and_has_neither_root_nor_shell(podman: list[str], program: str) -> None:
    assert newest(program).stat().st_size < MAX_MB[program] * 1e6
    (image,) = json.loads(run(*podman, "image", "inspect", f"localhost/{program}:{VERSION}"))
    assert image["Config"]["User"] == f"{USER}:20"
    looks = "import os; print(os.getuid(), *[os.path.exists(one) for one in " + str(NOT_IN_IT) + "])"
    python = ["--entrypoint", "/usr/bin/python3", f"localhost/{program}:{VERSION}"]
    assert run(*podman, *CONTAINED, *python, "-c", looks) == f"{USER} False False False False\n"
    writes = "import sys\ntry: open('/opt/beamtouch/x', 'w')\nexcept OSError as error: print(error.strerror)"
    assert run(*podman, *CONTAINED, *python, "-c", writes) == "Read-only file system\n"
    keeps = "import os; open('/var/lib/beamtouch/x', 'w').close(); print(oct(os.stat('/var/lib/beamtouch').st_mode))"
    volume = ["--volume", f"{uuid4().hex}:/var/lib/beamtouch"]
    assert run(*podman, *CONTAINED, *volume, *python, "-c", keeps) == "0o40700\n"


def test_an_image_without_a_configuration_says_so_in_a_line(podman: list[str]) -> None:
    command = [*podman, *CONTAINED, f"localhost/beamtouch-service:{VERSION}"]
    done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=120)
    assert done.returncode == 2
    assert done.stderr == "beamtouch-service: /etc/beamtouch/service.toml: No such file or directory\n"


def test_the_service_in_a_container_tells_the_service_manager(
    tmp_path: Path, podman: list[str], bench_model: Path
) -> None:
    """It says that it is ready, and that it still works; the manager's signal ends it."""
    (tmp_path / "bench.onnx").write_bytes(bench_model.read_bytes())
    configuration = {"server": {"port": 0}, "surfaces": {"bench": {"model": "bench.onnx"}}}
    (tmp_path / "service.toml").write_text(tomli_w.dumps(configuration))
    os.chown(tmp_path, USER, USER)
    manager = Manager(tmp_path)
    notifies = {"NOTIFY_SOCKET": str(tmp_path / "notify"), "WATCHDOG_USEC": "400000"}
    command = [
        *(*podman, *CONTAINED, "--sdnotify", "container", "--env", "WATCHDOG_USEC"),
        *("--volume", f"{tmp_path}:/etc/beamtouch:ro", f"localhost/beamtouch-service:{VERSION}"),
    ]
    with subprocess.Popen(command, env=os.environ | notifies, stdout=subprocess.DEVNULL) as service:
        try:
            assert manager.until("READY=1")
            assert manager.until("WATCHDOG=1", times=2)
        finally:
            service.send_signal(signal.SIGTERM)
            manager.close()
        assert service.wait(60) == 0
