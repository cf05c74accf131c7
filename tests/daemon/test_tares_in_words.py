"""A tare from its readings to what it prints, in the process of the test, where no service can be asked."""

import json
import stat
from collections.abc import Callable
from pathlib import Path

import pytest

from beamtouch_daemon.cli import main
from beamtouch_daemon.commands import tare
from support.programs.in_process import Outcome, command_of
from support.surfaces import configs

from .acquiring import Beam, Gone

Tare = Callable[..., Outcome]
UNASKED = "the service could not be asked, or has no contact to give"


def counts(first: float, second: float = 20_000.0) -> Beam:
    """Return a beam at rest with noise of two counts."""
    return Beam(lambda at: (first + 2.0, second - 2.0) if at % 2 else (first - 2.0, second + 2.0))


@pytest.fixture
def tared(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Tare:
    """A function that tares a beam of the surface `bench`, with options and with keys of the surface."""
    run = command_of(main, capsys)

    def tare_it(beam: Beam, *options: str, keys: str = "") -> Outcome:
        monkeypatch.setattr(tare, "source_of", lambda _: beam)
        config = configs.write(
            tmp_path, configs.surface().replace("rate_hz", f"{keys}rate_hz", 1), url="http://127.0.0.1:1"
        )
        return run("tare", config, *options)

    return tare_it


def gaps(folder: Path) -> dict[str, float]:
    found: dict[str, float] = json.loads((folder / "bench.tare.json").read_text())["rest_gap_mm"]
    return found


def test_a_tare_is_the_mean_of_a_second_and_is_told_with_what_to_do_next(tmp_path: Path, tared: Tare) -> None:
    beam = counts(20_100.0)
    outcome = tared(beam)
    assert (outcome.returncode, beam.given) == (0, 200)
    first, compared, last = outcome.stdout.splitlines()
    path = tmp_path / "bench.tare.json"
    assert first == f"bench: rest gaps s1 2.4900 mm, s2 2.5000 mm, mean of 200 readings, in {path}"
    assert compared.endswith(f"; {UNASKED}")
    assert last == "bench: a running daemon takes them when it starts again: systemctl restart beamtouch-daemon"
    assert gaps(tmp_path) == {"s1": pytest.approx(2.49, abs=1e-9), "s2": pytest.approx(2.5, abs=1e-9)}
    assert oct(stat.S_IMODE(path.stat().st_mode)) == "0o644"  # the user of the service reads it
    digits = tared(counts(20_100.0), keys="noise_mm = 0.00001\n").stdout
    assert digits.startswith("bench: rest gaps s1 2.49000 mm, s2 2.50000 mm, ")


REMEDY = "take everything off the beam and tare again, or add --accept-change if "
MOVED = "the sensors were moved or the beam was changed"


@pytest.mark.parametrize(
    ("before", "now", "said"),
    [
        (
            None,
            counts(24_000.0),  # the ranges are 3 mm, of which a tenth is allowed before the first tare
            f"s1 -0.400 mm from its rest_gap_mm; {REMEDY}nothing touches it: before the first tare, a load and a "
            "sensor mounted elsewhere look alike",
        ),
        (counts(20_000.0), counts(22_000.0), f"s1 -0.200 mm from the last tare; {REMEDY}{MOVED}"),
        (
            counts(20_000.0),
            counts(22_000.0, 22_100.0),
            f"s1 -0.200 mm from the last tare, s2 -0.210 mm from the last tare; {REMEDY}{MOVED}",
        ),
        (
            None,
            Beam(lambda _: (20_000.0, 20_000.0)),
            "s1, s2 stuck: the counts do not change; check the sensor, or state stuck_after_ms if it works",
        ),
    ],
    ids=["unlike the configuration", "another rest gap", "two others", "stuck"],
)
def test_a_tare_that_cannot_be_right_is_refused_and_the_last_one_stays(
    before: Beam | None, now: Beam, said: str, tared: Tare, tmp_path: Path
) -> None:
    keys = "noise_mm = 0.0002\n"
    if before is not None:
        assert tared(before, keys=keys).returncode == 0
    outcome = tared(now, keys=keys)
    assert (outcome.returncode, outcome.stdout) == (1, "")
    assert outcome.stderr == f"beamtouch-daemon: bench: not tared: {said}\n"
    path = tmp_path / "bench.tare.json"
    assert path.exists() is (before is not None)
    assert before is None or gaps(tmp_path)["s1"] == pytest.approx(2.5)


@pytest.mark.parametrize(
    ("before", "now", "compared", "new"),
    [
        (None, counts(24_000.0), "first tare, compared with rest_gap_mm: s1 differs most, by 0.4 mm; 0.3 mm are", ""),
        (
            counts(20_000.0),
            counts(22_000.0),
            "compared with the last tare: s1 differs most, by 0.2 mm; 0.06 mm are",
            "bench: another rest gap of s1: if a sensor is new or stands elsewhere, calibrate the model; until then, a "
            "contact may be unexplained or misplaced",
        ),
    ],
)
def test_a_change_that_is_accepted_is_told(
    before: Beam | None, now: Beam, compared: str, new: str, tared: Tare
) -> None:
    keys = "noise_mm = 0.0002\n"
    if before is not None:
        tared(before, keys=keys)
    outcome = tared(now, "--accept-change", keys=keys)
    assert outcome.returncode == 0
    _, second, *others, _ = outcome.stdout.splitlines()
    words = "a load that moves less is not noticed, as the channels state no smallest_force_mm"
    assert second == f"bench: {compared} allowed; {words}; {UNASKED}"
    assert others == ([new] if new else [])


def test_a_tare_whose_file_cannot_be_written_and_one_without_a_device_are_failures(tmp_path: Path, tared: Tare) -> None:
    path = tmp_path / "bench.tare.json"
    path.mkdir()
    said = f"beamtouch-daemon: bench: cannot write {path}: Is a directory\n"
    assert (tared(counts(20_000.0)).returncode, tared(counts(20_000.0)).stderr) == (1, said)
    said = "beamtouch-daemon: bench: not tared: it is gone\n"
    assert tared(Gone()).stderr == said
