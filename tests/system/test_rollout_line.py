"""A wrong, a worse and a better model through all stages on a line that runs, while a controller asks all the time."""

import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from hashlib import sha256
from itertools import groupby
from pathlib import Path
from typing import Any

import httpx2
import numpy as np
import pytest

from beamtouch_models.design.calibration.calibrate import calibrate
from beamtouch_models.design.effort import Effort
from beamtouch_models.design.sweeps import silent
from beamtouch_models.lab.rig.surface import Imperfections
from beamtouch_models.runtime import ModelFile
from beamtouch_service import cli
from line import Line, Surface
from support.network.plain_http import NO_TLS, TIMEOUT_S
from support.programs.forked_line import ForkedLine
from support.running.waiting import wait_until
from support.surfaces.example_scenes import ROUGH, SCENES
from support.surfaces.real_surfaces import recorded

pytestmark = [pytest.mark.long, pytest.mark.soak, pytest.mark.timeout(600)]

REAL = Imperfections(gain=(1.008, 0.992, 1.0, 1.006))
"""The surface of the line. The model in use knows nothing of it, and places contacts a few mm off."""
BENT = Imperfections(gain=(0.996, 1.004, 1.0, 0.997))
"""Of another beam of the same design, for which the worse model was calibrated."""
SCRIPT = """
[[step]]
seconds = 2
[[step]]
seconds = 3600
position_mm = 140
force_n = 10
"""
"""A load that lies there for longer than all of this takes."""
STALE_MS = 60_000
"""A starved machine may read nothing for a while."""
ASK_S = 0.02
PATIENT_S = 120.0


class Controller:
    """Asks for the contact again and again, as a controller does, in a thread."""

    def __init__(self, url: str) -> None:
        self.answers: list[dict[str, Any]] = []
        self._url, self._ends = url, threading.Event()

    @contextmanager
    def asking(self) -> Iterator[None]:
        thread = threading.Thread(target=self._ask)
        thread.start()
        try:
            yield
        finally:
            self._ends.set()
            thread.join()

    def _ask(self) -> None:
        with httpx2.Client(base_url=self._url, verify=NO_TLS, timeout=TIMEOUT_S) as client:
            while not self._ends.wait(ASK_S):
                self.answers.append(client.get("/contact").json())

    @property
    def models(self) -> list[str]:
        """The models that answered, in order."""
        return [name for name, _ in groupby(one.get("model", "") for one in self.answers)]


class Rollout:
    """The line, and the commands on its model files."""

    def __init__(self, line: Line) -> None:
        self.line, self.model = line, line.folder / "bench.onnx"

    def get(self, path: str) -> dict[str, Any]:
        found: dict[str, Any] = httpx2.get(self.line.url + path, verify=NO_TLS, timeout=TIMEOUT_S).json()
        return found

    @property
    def candidate(self) -> dict[str, Any]:
        return self.get("/surfaces/bench/candidate")

    def stage(self, content: bytes) -> None:
        """Put a candidate there in one step, as rsync does."""
        new = self.model.with_name(".new")
        new.write_bytes(content)
        new.rename(self.model.with_name("bench.candidate.onnx"))

    def wait_for_verdict(self, content_of: str) -> dict[str, Any]:
        """Return the comparison with the candidate of this digest once there are enough samples."""
        found: list[dict[str, Any]] = []

        def is_judged() -> bool:
            found.append(self.candidate)
            is_it = str(found[-1]["candidate"]).endswith(content_of)
            return is_it and found[-1]["comparison"]["is_worse"] is not None

        wait_until(is_judged, PATIENT_S)
        comparison: dict[str, Any] = found[-1]["comparison"]
        return comparison

    def wait_for_error(self, complaint: str) -> None:
        wait_until(lambda: complaint in str(self.candidate["error"]), PATIENT_S)

    def run(self, word: str, *options: str) -> int:
        return cli.main([word, "--config", str(self.line.folder / "service.toml"), "bench", *options])


def calibrated(bench: ModelFile, real: Imperfections) -> bytes:
    loads = recorded(bench.metadata, real, np.random.default_rng(3))
    return calibrate(bench, loads, silent, effort=Effort(ROUGH)).content


def test_a_wrong_a_worse_and_a_better_model_on_a_line_that_is_touched(
    tmp_path: Path,
    bench: ModelFile,
    bench_model: Path,
    built_model: Callable[[str], Path],
) -> None:
    better, worse = calibrated(bench, REAL), calibrated(bench, BENT)
    (tmp_path / "bench.onnx").write_bytes(bench_model.read_bytes())
    (tmp_path / "script.toml").write_text(SCRIPT)
    (tmp_path / "real.toml").write_text(f"gain = {list(REAL.gain)}\n")
    surface = Surface(
        "bench",
        "modbus-tcp",
        tmp_path / "script.toml",
        ("--no-ringing", "--imperfections", str(tmp_path / "real.toml")),
    )
    sections = {"surfaces": {"bench": {"model": "bench.onnx", "stale_ms": STALE_MS}}}
    config = bench_model.with_suffix(".toml")
    with ForkedLine(tmp_path, SCENES / "bench.toml", tmp_path / "bench.onnx", config, [surface], sections) as line:
        rollout, controller = Rollout(line), Controller(line.url)
        line.wait_for_still_contact()
        old = line.contact()["model"]
        with controller.asking():
            for wrong, complaint in (
                (better[: len(better) // 2], "damaged"),
                (built_model("cantilever").read_bytes(), "it is of beam"),
            ):
                rollout.stage(wrong)
                rollout.wait_for_error(complaint)
                assert rollout.run("take") == 2

            rollout.stage(worse)
            said = rollout.wait_for_verdict(fingerprint(worse))
            assert said["is_worse"], said
            assert "It is worse: it " in said["verdict"]

            rollout.stage(better)
            said = rollout.wait_for_verdict(fingerprint(better))
            assert not said["is_worse"], said
            assert "Nothing speaks against it; for it: it explains contacts with a mean misfit of" in said["verdict"]
            assert controller.models == [old]

            assert rollout.run("take", "--digest", fingerprint(worse)) == 2
            assert rollout.run("take", "--digest", fingerprint(better)) == 0
            wait_until(lambda: str(line.contact()["model"]).endswith(fingerprint(better)), PATIENT_S)
            new = line.contact()["model"]
            wait_until(lambda: controller.models == [old, new], PATIENT_S)
            assert rollout.run("take-back") == 0
            wait_until(lambda: controller.models == [old, new, old], PATIENT_S)
            # The one that was taken is the candidate again.
            assert rollout.wait_for_verdict(fingerprint(better))["samples"] > 0
        assert line.dead() == []
    assert {one.get("state") for one in controller.answers} == {"contact"}
    assert max(one["age_ms"] for one in controller.answers) <= STALE_MS
    numbers = [one["sequence"] for one in controller.answers]
    assert numbers == sorted(numbers)


def fingerprint(content: bytes) -> str:
    """Return the first digits of the digest, as the name of a model has them."""
    return sha256(content).hexdigest()[:6]
