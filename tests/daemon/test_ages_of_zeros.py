"""How old a tare and kept zeros are, and of which sensors they are."""

import asyncio
import json
import logging
import math
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from pathlib import Path

import pytest

from beamtouch_common.errors import FailedError, InputError
from beamtouch_common.uptime import uptime_s
from beamtouch_daemon.config import tare_file
from beamtouch_daemon.config.tare_file import TareFile
from beamtouch_daemon.running import kept_zeros
from beamtouch_daemon.running.daemon import _tared
from beamtouch_daemon.running.kept_zeros import KeptZeros, SurfaceZeros, surface_zeros
from beamtouch_daemon.tasks import cancel
from beamtouch_models.filters import TARED, Rested

from .surfaces import surface_of
from .waits import until

NOW = datetime(2026, 3, 5, 12, 0, 7, tzinfo=UTC)


def tare(taken_at: str, **others: object) -> TareFile:
    return TareFile.model_validate(
        {"surface": "bench", "taken_at": taken_at, "readings": 50, "rest_gap_mm": {"s1": 2.5, "s2": 2.6}} | others
    )


def changed(name: str, value: object) -> str:
    """Return the content of a tare file with one other member."""
    return json.dumps(tare("").model_dump() | {name: value})


@pytest.mark.parametrize(
    ("taken_at", "age_s"),
    [
        ("2026-03-05T12:00:00+00:00", 7.0),
        ("2026-03-05T12:00:00", 7.0),  # without a zone, UTC
        ("2026-03-05T13:00:00+01:00", 7.0),
        ("2026-03-05T12:00:07+00:00", 0.0),
        ("2026-03-05T12:00:08+00:00", math.inf),  # the clock is before it
        ("", math.inf),
        ("yesterday", math.inf),
    ],
)
def test_the_age_of_a_tare_is_infinite_if_it_is_not_known(taken_at: str, age_s: float) -> None:
    assert tare(taken_at).age_s(NOW) == age_s


def test_a_batch_states_the_time_of_a_tare_if_the_file_has_one() -> None:
    assert tare("2026-03-05T12:00:00+00:00").stated_time == "2026-03-05T12:00:00+00:00"
    assert tare("yesterday").stated_time is None


def test_a_tare_file_holds_the_gaps_and_of_which_sensors_they_are(tmp_path: Path) -> None:
    path, surface = tmp_path / "bench.tare.json", surface_of()
    assert tare_file.load(path, surface.channel_names) is None
    tare_file.save(path, "bench", 57, {"s1": 2.4375, "s2": 2.5}, surface.channels)
    found = tare_file.load(path, surface.channel_names)
    assert found is not None
    assert (found.surface, found.readings, found.rest_gap_mm) == ("bench", 57, {"s1": 2.4375, "s2": 2.5})
    assert 0 <= found.age_s(datetime.now(UTC)) < 600
    assert found.other_characteristics(surface.channels) == []
    other = surface_of(2, {"offset_mm": 4.6}).channels
    assert found.other_characteristics(other) == ["s1", "s2"]
    assert found.other_characteristics([surface.channels[0], other[1]]) == ["s2"]
    assert found.other_characteristics(surface.channels[:1]) == []  # what is no longer there is no other sensor
    assert tare("").other_characteristics(surface.channels) == []
    assert {len(identity) for identity in found.characteristic.values()} == {8}


@pytest.mark.parametrize(
    ("content", "said"),
    [
        ("{", "not a tare file; delete it or run beamtouch-daemon tare again"),
        ('{"surface": "bench"}', "not a tare file; delete it or run beamtouch-daemon tare again"),
        *(
            (changed(name, value), "not a tare file; delete it or run beamtouch-daemon tare again")
            for name, value in (
                ("readings", "57"),
                ("rest_gap_mm", {"s1": "2.5", "s2": 2.5}),
                ("rest_gap_mm", {"s1": True, "s2": 2.5}),
                ("taken_at", 1795218046),
                ("gap_mm", 2.5),
            )
        ),
        (
            tare("").model_dump_json().replace('"s2"', '"s3"'),
            "made for other channels; delete it or run beamtouch-daemon tare again",
        ),
    ],
)
def test_a_tare_file_that_cannot_be_used_is_named_with_what_to_do(tmp_path: Path, content: str, said: str) -> None:
    path = tmp_path / "bench.tare.json"
    path.write_text(content)
    with pytest.raises(InputError) as raised:
        tare_file.load(path, ["s1", "s2"])
    assert str(raised.value) == f"{path}: {said}"
    path.unlink()
    path.mkdir()
    with pytest.raises(FailedError, match=r"bench\.tare\.json: "):
        tare_file.load(path, ["s1", "s2"])


def test_a_start_says_that_a_load_may_be_taken_for_drift_a_minute_after_the_tare(
    caplog: pytest.LogCaptureFixture,
) -> None:
    caplog.set_level(logging.INFO)
    tracked = surface_of(noise_mm=0.003, zero_tracking={"drift_um_per_min": 4.0, "max_mm": 0.05})
    assert _tared("bench", tracked, None) == TARED
    now = datetime.now(UTC)
    recent = _tared("bench", tracked, tare(str(now - timedelta(seconds=20))))
    assert 20 <= recent.ago_s < 60
    assert _tared("bench", surface_of(), tare(str(now - timedelta(seconds=90)))).ago_s >= 90
    assert caplog.messages == []
    taken_at = str(now - timedelta(seconds=90))
    assert _tared("bench", tracked, tare(taken_at)).ago_s >= 90
    assert caplog.messages == [
        f"bench: of its zeros, only those of the tare are known ({taken_at}): a light load that lies on the beam now "
        "is taken for their drift"
    ]


RESTED = Rested(30.0, (0.01, -0.02), (0.001, 0.002))


def test_zeros_are_kept_with_the_time_of_their_rest() -> None:
    kept = surface_zeros("4f2c", RESTED, 530.0)
    assert kept == SurfaceZeros(
        characteristic="4f2c", rested_s=500.0, zero_mm=[0.01, -0.02], deviation_mm=[0.001, 0.002]
    )


@pytest.mark.parametrize(
    ("characteristic", "rested", "last_s"),
    [
        (None, RESTED, 530.0),
        ("4f2c", None, 530.0),
        ("4f2c", RESTED, None),
        ("4f2c", replace(RESTED, ago_s=math.inf), 530.0),
        ("4f2c", replace(RESTED, zero_mm=None), 530.0),
        ("4f2c", replace(RESTED, deviation_mm=None), 530.0),
    ],
)
def test_zeros_of_which_something_is_not_known_are_not_kept(
    characteristic: str | None, rested: Rested | None, last_s: float | None
) -> None:
    assert surface_zeros(characteristic, rested, last_s) is None


def zeros_of(ago_s: float, characteristic: str = "4f2c") -> SurfaceZeros:
    rested_s = uptime_s() - ago_s
    return SurfaceZeros(
        characteristic=characteristic, rested_s=rested_s, zero_mm=[0.01, -0.02], deviation_mm=[0.0, 0.002]
    )


def test_kept_zeros_are_of_the_same_tare_and_as_old_as_their_rest(tmp_path: Path) -> None:
    path = tmp_path / "zeros.json"
    before = KeptZeros(path)
    before.write({"bench": zeros_of(5.0), "late": zeros_of(-60.0)})
    before.write({"other": zeros_of(7.0)})  # what was kept of others stays
    before.write({})
    kept = KeptZeros(path)
    found = kept.rested("bench", "4f2c")
    assert found is not None
    assert 5.0 <= found.ago_s < 300.0
    assert (found.zero_mm, found.deviation_mm) == ((0.01, -0.02), (0.0, 0.002))
    assert kept.rested("other", "4f2c") is not None
    assert (kept.rested("bench", "0000"), kept.rested("nobody", "4f2c")) == (None, None)
    assert kept.rested("late", "4f2c") is None  # a rest in the future


def test_without_a_file_no_zeros_are_kept() -> None:
    kept = KeptZeros(None)
    kept.write({"bench": zeros_of(5.0)})
    assert kept.rested("bench", "4f2c") is None


def test_zeros_of_another_start_of_the_machine_are_of_no_use(tmp_path: Path) -> None:
    path = tmp_path / "zeros.json"
    KeptZeros(path).write({"bench": zeros_of(5.0)})
    text = path.read_text()
    started = Path("/proc/sys/kernel/random/boot_id").read_text().strip()
    assert started in text
    path.write_text(text.replace(started, "another"))
    assert KeptZeros(path).rested("bench", "4f2c") is None


def test_a_damaged_file_of_zeros_or_one_that_cannot_be_read_is_said(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    damaged, folder = tmp_path / "zeros.json", tmp_path / "folder"
    damaged.write_text("{")
    folder.mkdir()
    for path in (damaged, folder, tmp_path / "none"):
        assert KeptZeros(path).rested("bench", "4f2c") is None
    assert caplog.messages == [
        f"{damaged}: damaged; the zeros of before are not known",
        f"{folder}: Is a directory; the zeros of before are not known",
    ]


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ('"rested_s":', '"rested_s": "5", "rested":'),
        ('"rested_s":', '"more": 1, "rested_s":'),
        ('"surfaces":', '"more": 1, "surfaces":'),
        ('"started":"', '"started":7,"x":"'),
        ("0.002", "-0.002"),
        ("0.01", '"0.01"'),
        ("-0.02", "NaN"),
    ],
)
def test_zeros_with_a_member_that_the_daemon_does_not_write_are_damaged(
    tmp_path: Path, caplog: pytest.LogCaptureFixture, old: str, new: str
) -> None:
    path = tmp_path / "zeros.json"
    KeptZeros(path).write({"bench": zeros_of(5.0)})
    assert KeptZeros(path).rested("bench", "4f2c") is not None
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new))
    assert KeptZeros(path).rested("bench", "4f2c") is None
    assert caplog.messages == [f"{path}: damaged; the zeros of before are not known"]


@pytest.mark.anyio
async def test_zeros_are_written_again_and_again_while_the_daemon_runs(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path, known = tmp_path / "zeros.json", iter([{"bench": zeros_of(5.0)}, {"press": zeros_of(7.0)}])
    early = asyncio.ensure_future(KeptZeros(path).keep(lambda: next(known, {})))
    await asyncio.sleep(0.01)
    await cancel([early])
    assert not path.exists()  # a minute after the start, and then each minute
    monkeypatch.setattr(kept_zeros, "KEEP_S", 0.005)
    keeping = asyncio.ensure_future(KeptZeros(path).keep(lambda: next(known, {})))
    await until(lambda: path.exists() and "press" in path.read_text())
    await cancel([keeping])
    assert KeptZeros(path).rested("bench", "4f2c") is not None


def test_zeros_that_cannot_be_written_are_said_once_and_that_they_can_again(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    caplog.set_level(logging.INFO)
    path = tmp_path / "gone" / "zeros.json"
    kept = KeptZeros(path)
    for _ in range(2):
        kept.write({"bench": zeros_of(5.0)})
    path.parent.mkdir()
    kept.write({"bench": zeros_of(5.0)})
    first, again = caplog.messages
    assert first == f"{path}: No such file or directory; a restart will not know the zeros"
    assert again.startswith("works again after ")
