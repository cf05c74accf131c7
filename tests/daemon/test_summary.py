"""The end of a run: what its summary counts, says and writes; and what a running daemon says of its surfaces."""

import asyncio
import json
import logging
import stat
from pathlib import Path

import pytest

from beamtouch_common.parts import Parts
from beamtouch_common.systemd import ServiceManager
from beamtouch_daemon.cli import main
from beamtouch_daemon.config.settings import Config
from beamtouch_daemon.config.tare_file import NOT_TARED, TareFile
from beamtouch_daemon.delivery.log_file import Chunk
from beamtouch_daemon.delivery.log_store import LogStore
from beamtouch_daemon.processing.characteristic import Characteristic
from beamtouch_daemon.running import daemon
from beamtouch_daemon.running.acquisition import Acquisition
from beamtouch_daemon.running.daemon import Summary
from beamtouch_daemon.running.kept_zeros import KeptZeros
from support.programs.in_process import command_of
from support.surfaces import configs

from .acquiring import Bench, reading
from .publishing import boot, taken
from .surfaces import surface_of


def parts(**failing: str) -> Parts:
    made = Parts(logging.getLogger(__name__))
    made.failing.update({name.replace("_", " "): why for name, why in failing.items()})
    return made


def surfaces(*names: str) -> list[Acquisition]:
    """Return surfaces that are read, one reading each."""
    benches = [Bench() for _ in names]
    for name, bench in zip(names, benches, strict=True):
        bench.line.name = name
        bench.take(reading(50.0))
    return [bench.line for bench in benches]


@pytest.mark.anyio
async def test_the_summary_counts_surfaces_that_are_read_and_those_of_which_only_the_log_knows(
    caplog: pytest.LogCaptureFixture,
) -> None:
    bench, store = Bench(), LogStore(None, 0)
    bench.take(reading(50.0), reading(50.1, lost=3))
    present = store.surface("bench")
    present.begin(boot(), 100).put(taken(1, 5))
    present.counts.published, present.counts.dropped = 11, 4
    store.surface("gone").adopt(Chunk(1, 3, 9), boot("boot-0000"))
    assert daemon._summaries([bench.line], store) == {"bench": Summary(2, 3, 11, 9, 0), "gone": Summary(0, 0, 0, 0, 7)}
    said = "bench: 5 samples dropped: neither the service nor the log file took them"
    assert [line for line in caplog.messages if "neither" in line] == [said]


def test_a_run_prints_and_writes_its_counts_for_everybody_to_read(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    async def run(_config: object) -> tuple[dict[str, Summary], bool]:
        return {"bench": Summary(57, 3, 41, 2, 13), "press": Summary(5)}, False

    monkeypatch.setattr(daemon, "run", run)
    path = tmp_path / "summary.json"
    path.touch(mode=0o600)
    outcome = command_of(main, capsys)("run", configs.write(tmp_path, configs.surface()), "--summary", path)
    assert (outcome.returncode, outcome.stderr.splitlines()) == (
        0,
        [
            "bench: 57 readings taken, 3 lost; 41 samples published, 2 dropped, 13 in the log file for the next start",
            "press: 5 readings taken, 0 lost; 0 samples published, 0 dropped",
        ],
    )
    assert oct(stat.S_IMODE(path.stat().st_mode)) == "0o644"
    bench, press = json.loads(path.read_text())["surfaces"].values()
    assert list(bench.values()) == [57, 3, 41, 2, 13]
    assert press == dict.fromkeys(bench, 0) | {"readings": 5}
    assert '\n  "surfaces": {\n    "bench": {\n      "readings": 57,\n' in path.read_text()


@pytest.mark.anyio
async def test_the_status_names_what_is_read_what_is_away_what_is_not_tared_and_what_fails() -> None:
    bench, press, late = surfaces("bench", "press", "late")
    assert daemon._status([bench, press], parts()) == "reading bench, press"
    late.is_missing, press.is_tared = True, False
    assert daemon._status([bench, press, late], parts(zeros="broken", metrics="")) == (
        "reading bench, press; waiting for the device of late; not tared: press; unexpected error in zeros"
    )


@pytest.mark.anyio
async def test_a_surface_hangs_unless_its_reading_is_begun_again_anyway() -> None:
    bench, press, late = surfaces("bench", "press", "late")
    bench.last_progress_s = late.last_progress_s = -1000.0
    assert daemon._hanging([bench, press, late], parts()) == ["bench", "late"]
    assert daemon._hanging([bench, press, late], parts(late_readings="broken", bench_samples="broken")) == ["bench"]


class Manager(ServiceManager):
    """A service manager that waits for a sign of life for so long."""

    def __init__(self, watchdog_s: float | None) -> None:
        self.watchdog_s = watchdog_s
        self.told = list[str]()

    def alive(self, status: str = "") -> None:
        self.told.append(status)


@pytest.mark.anyio
@pytest.mark.parametrize(("watchdog_s", "pause_s"), [(None, 0.25), (3.0, 0.75), (60.0, 1.0)])
async def test_progress_is_reported_four_times_in_the_time_of_the_watchdog_and_each_second(
    watchdog_s: float | None, pause_s: float, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    bench, press = surfaces("bench", "press")
    manager, pauses = Manager(watchdog_s), list[float]()

    async def sleep(pause_s: float) -> None:
        pauses.append(pause_s)
        bench.last_progress_s = press.last_progress_s = -1000.0
        if len(pauses) == 2:
            raise asyncio.CancelledError

    monkeypatch.setattr(asyncio, "sleep", sleep)
    with pytest.raises(asyncio.CancelledError):
        await daemon._watch([bench, press], parts(), manager)
    assert pauses == [pause_s, pause_s]
    assert manager.told == ["reading bench, press"]  # while a surface hangs, nothing is reported
    assert [line for line in caplog.messages if "progress" in line] == ["no progress on bench, press"]


def config_of(folder: Path, rest_ms: float = 100.0, **surface: object) -> Config:
    publish = {"url": "http://plc", "token_file": "token", "batch_ms": 7.0, "rest_ms": rest_ms, "log_samples": 150}
    context = {"directory": folder, "files": {"bench": folder / "daemon.toml"}}
    return Config.model_validate({"publish": publish, "surfaces": {"bench": surface_of(**surface)}}, context=context)


TARE = TareFile(
    surface="bench", taken_at="2026-11-20T23:40:46+00:00", readings=200, rest_gap_mm={"s1": 2.25, "s2": 2.75}
)


@pytest.mark.anyio
async def test_a_surface_begins_with_what_all_its_batches_state(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    growing = {"kind": "growing-mean", "max_mean_ms": 1000.0}
    config = config_of(tmp_path, noise_mm=0.002, beam="0a1b2c3d4e5f", filter=growing)
    store = LogStore(None, 0)
    line = daemon._begin(config, "bench", TARE, KeptZeros(None), store, {})
    head = line.boot.log.head
    assert (head.channels, head.noise_mm, head.beam) == (["s1", "s2"], [0.002, 0.002], "0a1b2c3d4e5f")
    assert (head.tared_at, line.is_tared) == ("2026-11-20T23:40:46+00:00", True)
    assert head.characteristic == Characteristic.of(config.surfaces["bench"], TARE.rest_gap_mm).identity
    assert (line._batch_s, line._rest_s, line.name) == (0.007, 0.1, "bench")
    assert line._pipeline._rest is not None
    assert store.surface("bench").present is line.boot
    line.boot.put(taken(1, 160))
    assert line.boot.log.in_memory == 150
    assert caplog.messages == ["bench: 10 samples dropped"]


@pytest.mark.anyio
async def test_a_surface_without_a_tare_says_so_and_without_a_rest_each_reading_is_a_sample(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    growing = {"kind": "growing-mean", "max_mean_ms": 1000.0}
    config = config_of(tmp_path, rest_ms=0.0, noise_mm=0.002, filter=growing)
    line = daemon._begin(config, "bench", None, KeptZeros(None), LogStore(None, 0), {})
    assert (line.boot.log.head.tared_at, line.is_tared, line._pipeline._rest) == (None, False, None)
    assert caplog.messages == [f"bench: {NOT_TARED}"]
    unknown = daemon._begin(config_of(tmp_path), "bench", TARE, KeptZeros(None), LogStore(None, 0), {})
    assert unknown.boot.log.head.noise_mm is None
    assert unknown.boot.log.head.boot_id != line.boot.log.head.boot_id
