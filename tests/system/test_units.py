"""The units: hardened, and the tokens that they load, by the guide for Debian and in the programs."""

import os
import re
import shlex
import shutil
import subprocess
from pathlib import Path

import httpx2
import pytest

from support.network.plain_http import TIMEOUT_S
from support.programs.forked import Forked
from support.running.debian_parts import require
from support.surfaces.small_model import write_model

ROOT = Path(__file__).parents[2]
GUIDE = (ROOT / "docs" / "how-to" / "debian.md").read_text()
ONE_OF_SEVERAL = ROOT / "deploy" / "beamtouch-service@.service"
UNITS = {name: ROOT / name / f"beamtouch-{name}.service" for name in ("daemon", "service")}
CREDENTIALS = "/run/credentials/beamtouch-service.service"
TOKENS = {"token": "token-that-writes-of-the-tests", "read-token": "token-that-reads-of-the-tests"}
ALWAYS = {"Restart=always", "RestartPreventExitStatus=2", "StartLimitIntervalSec=0"}
"""It is started again after whatever happens to it, but not after a wrong configuration."""


def analyzed(*words: str | Path, **environment: str) -> str:
    """Return what systemd-analyze says, which must complain of nothing."""
    command = [require("systemd-analyze", "systemd"), *map(str, words)]
    done = subprocess.run(
        command, env=os.environ | environment, capture_output=True, text=True, check=False, timeout=240
    )
    assert (done.returncode, done.stderr) == (0, ""), done.stdout + done.stderr
    return done.stdout


@pytest.mark.parametrize(
    ("unit", "least", "lines"),
    [
        (UNITS["daemon"], 1.5, {"WatchdogSec=30"}),
        (UNITS["service"], 1.2, {"Type=notify", "WatchdogSec=10"}),
        (ONE_OF_SEVERAL, 1.2, {"Type=notify", "WatchdogSec=10"}),
    ],
    ids=lambda one: one.stem if isinstance(one, Path) else "",
)
def test_the_unit_is_hardened_and_starts_its_program_again(
    tmp_path: Path, unit: Path, least: float, lines: set[str]
) -> None:
    shutil.copy(unit, tmp_path / "one.service")
    exposure = re.search(
        r"exposure level for one.service: ([0-9.]+) ", analyzed("security", "--offline=yes", tmp_path / "one.service")
    )
    assert exposure is not None
    assert float(exposure[1]) <= least
    text = set(unit.read_text().splitlines())
    # numpy tries a system call that the filter forbids.
    assert ALWAYS | lines | {"SystemCallErrorNumber=EPERM"} <= text
    # It hides /proc/cpuinfo, without which onnxruntime warns that it could be slow.
    assert ("ProcSubset=pid" in text) is (unit == UNITS["daemon"])
    # systemd finds the number of a name only if its driver is loaded when the unit starts.
    assert all(line.split("-")[1].split()[0].isdecimal() for line in text if "DeviceAllow=char-" in line)


def drop_ins() -> dict[str, str]:
    """Return the text of each file that the guide writes under /etc/systemd/system, by its path there."""
    found = re.findall(r"^\$ sudo tee /etc/systemd/system/(\S+) <<END\n(.*?)^END$", GUIDE, re.MULTILINE | re.DOTALL)
    return {path: text for path, text in found if ".d/" in path}


def started_as(unit: Path) -> list[str]:
    """Return the words of the command that a unit starts."""
    (line,) = re.findall(r"^ExecStart=(.*)$", unit.read_text(), re.MULTILINE)
    return shlex.split(line)


@pytest.mark.parametrize(
    ("unit", "name", "drops"),
    [
        (UNITS["daemon"], "beamtouch-daemon.service", 1),
        (UNITS["service"], "beamtouch-service.service", 1),
        (ONE_OF_SEVERAL, "beamtouch-service@8421.service", 0),
    ],
    ids=lambda one: one if isinstance(one, str) else "",
)
def test_systemd_accepts_the_units_with_the_tokens_of_the_guide(
    tmp_path: Path, unit: Path, name: str, drops: int
) -> None:
    # systemd looks for the command in the folders of the system, where this environment is not.
    command = tmp_path / unit.stem.rstrip("@")
    command.symlink_to("/bin/true")
    (tmp_path / unit.name).write_text(unit.read_text().replace(f"={command.name} ", f"={command} "))
    mine = {path: text for path, text in drop_ins().items() if path.startswith(f"{unit.name}.d/")}
    assert len(mine) == drops
    for path, text in mine.items():
        (tmp_path / path).parent.mkdir()
        (tmp_path / path).write_text(text)
    analyzed("verify", "--man=no", name, SYSTEMD_UNIT_PATH=f"{tmp_path}:")


def test_every_credential_that_is_named_is_loaded() -> None:
    texts = [*(unit.read_text() for unit in UNITS.values()), *drop_ins().values()]
    loaded = {name for text in texts for name in re.findall(r"^LoadCredential=([^:\n]+):", text, re.MULTILINE)}
    named = set(re.findall(rf"{CREDENTIALS}/([\w-]+)\"", GUIDE))
    named |= {name for text in texts for name in re.findall(r"\$\{CREDENTIALS_DIRECTORY\}/([\w-]+)", text)}
    assert named == {"token", "read-token"} == loaded


def test_the_service_takes_the_tokens_of_its_credentials(tmp_path: Path) -> None:
    for name, token in TOKENS.items():
        (tmp_path / name).write_text(f"{token}\n")
    model = write_model(tmp_path, "bench")
    (section,) = re.findall(r"^(\[server\]\nread_token_file = .*)$", GUIDE, re.MULTILINE)
    config = tmp_path / "service.toml"
    config.write_text(f'{section.replace(CREDENTIALS, str(tmp_path))}\nport = 0\n[surfaces.bench]\nmodel = "{model}"\n')
    words = [word.replace("${CREDENTIALS_DIRECTORY}", str(tmp_path)) for word in started_as(UNITS["service"])]
    words = [str(config) if word == "/etc/beamtouch/service.toml" else word for word in words[1:]]
    service = Forked("beamtouch_service.cli", words, tmp_path)
    try:
        url = service.stdout.readline().removeprefix("listening on ").strip()

        def status(method: str, path: str, token: str | None) -> int:
            headers = {} if token is None else {"Authorization": f"Bearer {token}"}
            answer = httpx2.request(method, url + path, headers=headers, trust_env=False, timeout=TIMEOUT_S)
            return answer.status_code

        reads = [status("GET", "/surfaces", token) for token in (None, TOKENS["read-token"], TOKENS["token"])]
        writes = [status("POST", "/surfaces/bench/samples", TOKENS[name]) for name in ("read-token", "token")]
    finally:
        service.terminate()
        service.communicate(timeout=60)
    assert reads == [401, 200, 200]
    assert writes == [403, 400]  # the write token is taken, and the empty body is not
