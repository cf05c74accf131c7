"""The files of `deploy/`: alerts, the unit of a service that is one of several, and its configuration."""

import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from beamtouch_service.config import load_settings
from beamtouch_service.events.store import Store
from beamtouch_service.sections import EventsSection
from parts import require
from postgres import PASSWORD, Postgres

FOLDER = Path(__file__).parents[2] / "deploy"
UNIT = FOLDER / "beamtouch-service@.service"
RULES = FOLDER / "beamtouch.rules.yml"
DOCS = FOLDER.parent / "docs"


def analyzed(*words: str | Path) -> str:
    command = [require("systemd-analyze", "systemd"), *map(str, words)]
    done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=240)
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


def test_systemd_takes_the_unit_and_finds_it_hardened(tmp_path: Path) -> None:
    # systemd looks for the command in the folders of the system, where this environment is not.
    text = UNIT.read_text().replace("ExecStart=", f"ExecStart={Path(sys.executable).parent}/")
    (tmp_path / UNIT.name).write_text(text)
    analyzed("verify", "--man=no", tmp_path / "beamtouch-service@8421.service")
    shutil.copy(UNIT, tmp_path / "one.service")
    exposure = re.search(
        r"exposure level for one.service: ([0-9.]+) ", analyzed("security", "--offline=yes", tmp_path / "one.service")
    )
    assert exposure is not None
    assert float(exposure[1]) <= 1.2


def test_the_password_comes_from_a_file_that_a_group_may_read(
    postgres: Postgres, events_url: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    url = load_settings(FOLDER / "service.toml", {}).events.url
    assert url is not None
    assert "Environment=PGSERVICEFILE=" in UNIT.read_text()
    # As systemd 254 and later pass a credential.
    file = tmp_path / "pg_service.conf"
    file.write_text(f"[beamtouch]\npassword={PASSWORD}\n")
    file.chmod(0o440)
    monkeypatch.setenv("PGSERVICEFILE", str(file))
    here = url.replace("127.0.0.1/beamtouch", f"127.0.0.1:{postgres.port}/{events_url.rpartition('/')[2]}")
    store = Store(EventsSection(url=here))
    assert store.read() == []
    store.close()


def test_promtool_takes_the_alerts_and_they_fire_as_stated() -> None:
    promtool = require("promtool", "prometheus")
    for command in (["check", "rules", RULES], ["test", "rules", Path(__file__).with_name("beamtouch.rules.test.yml")]):
        done = subprocess.run([promtool, *map(str, command)], capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stdout + done.stderr


def test_alerts_read_only_metrics_that_there_are() -> None:
    """The reference comes from the programs; the metrics of MQTT are in its guide."""
    tables = [(DOCS / page).read_text() for page in ("reference/metrics.md", "how-to/mqtt.md")]
    documented = {name for text in tables for name in re.findall(r"^\| `(beamtouch_\w+)` \|", text, re.MULTILINE)}
    read = set(re.findall(r"\bbeamtouch_\w+", RULES.read_text()))
    assert len(read) > 15
    assert read <= documented
