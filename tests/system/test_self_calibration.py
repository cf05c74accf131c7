"""The steps of the README from a surface whose sensors are off to a calibrated model, typed as they stand there."""

import os
import re
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import httpx2
import numpy as np
import pytest

from beamtouch_models import modelfile
from beamtouch_models.building.model_prior import physics_of
from beamtouch_models.calibration.theory import Theory
from beamtouch_models.rig.imperfections import load_imperfections
from example_scenes import SCENES
from plain_http import TIMEOUT_S
from unlabelled_contacts import missed_mm

pytestmark = [pytest.mark.long, pytest.mark.timeout(600)]

README = Path(__file__).parent.parent.parent / "README.md"
PROGRAMS = Path(sys.executable).parent
ENOUGH, PATIENCE_S, RATE_HZ = 40, 400, 50.0
"""Contacts to wait for, and how long: there is one a second, of which a busy machine misses some."""


def steps() -> tuple[str, str, str]:
    """The section's imperfections, what it starts, and what it does a few minutes later."""
    section = README.read_text().split("## Calibrating without known loads")[1].split("\n## ")[0]
    blocks = re.findall(r"```\w*\n(.*?)```", section, re.DOTALL)
    return blocks[0], blocks[1], blocks[2]


def free_port() -> int:
    with socket.socket() as listener:
        listener.bind(("127.0.0.1", 0))
        port: int = listener.getsockname()[1]
        return port


@contextmanager
def typed(commands: str, folder: Path) -> Iterator[None]:
    """A shell that has typed commands, with what they leave running; it ends with the block."""
    shell = subprocess.Popen(
        ["bash", "-c", f"set -e\n{commands}\nwait"], cwd=folder, env=environment(), start_new_session=True
    )
    try:
        yield
    finally:
        os.killpg(shell.pid, signal.SIGTERM)
        shell.wait(timeout=60)


def environment() -> dict[str, str]:
    return {**os.environ, "PATH": f"{PROGRAMS}:{os.environ['PATH']}"}


def wait_for_contacts(url: str) -> None:
    """Wait until the service has kept enough contacts."""
    deadline, rows = time.monotonic() + PATIENCE_S, 0
    while rows < ENOUGH:
        assert time.monotonic() < deadline, f"{rows} contacts"
        time.sleep(1)
        try:
            answer = httpx2.get(f"{url}/surfaces/bench/calibration-data", timeout=TIMEOUT_S)
        except httpx2.TransportError:  # it is not up yet
            continue
        if answer.is_success:
            rows = len(answer.text.splitlines()) - 1


def test_the_steps_of_the_readme_calibrate_a_surface(tmp_path: Path) -> None:
    imperfections, begin, later = steps()
    (tmp_path / "off.toml").write_text(imperfections)
    (tmp_path / "models").symlink_to(SCENES.parent)
    rig, service = free_port(), free_port()
    begin = begin.replace("beamtouch-service run", f"beamtouch-service run --port {service}").replace("5020", str(rig))
    # The daemon's configuration has the ports of the commands as they stand, and a rate too high for a busy machine.
    changes = f"s/5020/{rig}/; s/8420/{service}/; s/^rate_hz = .*/rate_hz = {RATE_HZ}/"
    begin = begin.replace("beamtouch-daemon run", f"sed -i '{changes}' daemon.toml\nbeamtouch-daemon run")
    with typed(begin, tmp_path):
        wait_for_contacts(f"http://127.0.0.1:{service}")
        done = subprocess.run(
            ["bash", "-ec", later.replace("8420", str(service))],
            cwd=tmp_path,
            env=environment(),
            capture_output=True,
            text=True,
            timeout=300,
            check=False,
        )
    assert done.returncode == 0, done.stderr
    metadata = modelfile.load(tmp_path / "bench-real.onnx").metadata
    calibration = metadata.calibration
    assert calibration is not None
    assert calibration.contacts >= ENOUGH
    assert f"calibrated with {calibration.contacts} unlabelled contacts" in done.stdout
    assert calibration.misfit_before is not None
    assert calibration.misfit_after is not None
    assert calibration.misfit_after < 0.5 * calibration.misfit_before
    theory, real = Theory.of(physics_of(metadata), metadata), load_imperfections(tmp_path / "off.toml")
    before, after = (
        missed_mm(theory, vector, metadata, real)
        for vector in (np.zeros(theory.size), theory.vector_of(calibration.departures))
    )
    assert after < 0.5 * before
