"""`check` from its readings to what it prints, in the process of the test, where no service can be asked."""

import asyncio
import json
from collections.abc import Callable
from pathlib import Path

import pytest

from beamtouch_daemon.cli import main
from beamtouch_daemon.commands import check
from beamtouch_daemon.config import tare_file
from beamtouch_daemon.sources.requests import Failure
from support.programs.in_process import Outcome, command_of
from support.surfaces import configs

from .acquiring import Beam, Gone

Check = Callable[..., Outcome]
NOT_TARED = f"bench: {tare_file.NOT_TARED}"
NOT_ASKED = "The service was not asked whether it takes these samples; check --wait 5 asks it."
UNREACHED = (
    "bench: no answer from the service at http://127.0.0.1:1 (Connection refused); does it run, is publish.url right "
    "(http or https?), and does a firewall let it through?"
)


@pytest.fixture
def checked(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Check:
    """A function that checks a beam of the surface `bench`, with options."""
    run = command_of(main, capsys)
    config = configs.write(tmp_path, configs.surface(), url="http://127.0.0.1:1")

    def check_it(beam: Beam, *options: str) -> Outcome:
        monkeypatch.setattr(check, "source_of", lambda *_: beam)
        return run("check", config, *options)

    return check_it


def beam_of(first: float | None = 20_345.0) -> Beam:
    """Return a beam whose last reading of each check, number 29, has this count of s1."""
    return Beam(lambda at: (first if at % 30 == 29 else 7.0, 21_000.0))


def test_a_check_shows_the_last_of_thirty_readings(checked: Check) -> None:
    beam = beam_of()
    outcome = checked(beam)
    assert (outcome.returncode, outcome.stderr, beam.given) == (0, "", 30)
    _, first, second, *others = outcome.stdout.splitlines()
    assert first.split() == ["bench", "s1", "20345", "2.4655", "0.0345", "good"]
    assert second.split() == ["bench", "s2", "21000", "2.4000", "0.1000", "good"]
    assert others == [NOT_TARED, NOT_ASKED]


def test_a_channel_that_is_not_good_and_a_device_that_is_gone_are_complaints(checked: Check) -> None:
    missing = checked(beam_of(None))
    assert missing.returncode == 1
    assert missing.stderr.startswith("beamtouch-daemon: bench: s1 missing: the device sent no value, ")
    gone = checked(Gone())
    assert (gone.returncode, gone.stderr) == (1, "beamtouch-daemon: bench: it is gone\n")


@pytest.mark.parametrize(("failed", "code"), [(9, 0), (10, 1)])
def test_a_tenth_of_failed_requests_is_a_complaint_and_less_is_told(checked: Check, failed: int, code: int) -> None:
    beam = beam_of()
    for number in range(100):
        beam.requests["unit 3"].fail(Failure.LATE) if number < failed else beam.requests["unit 3"].answered()
    outcome = checked(beam)
    words = f"bench: {failed} of 100 requests to unit 3 fail: late answer ({failed}); raise timeout_ms"
    assert outcome.returncode == code
    assert (words in outcome.stdout, words in outcome.stderr) == (not code, bool(code))


def test_a_tare_is_used_and_json_tells_it(checked: Check, tmp_path: Path) -> None:
    configs.tare(tmp_path)
    outcome = checked(beam_of(), "--json")
    found = json.loads(outcome.stdout)
    assert found["good"]
    assert (found["surfaces"]["bench"]["tared"], found["surfaces"]["bench"]["service"]) == (True, None)
    assert found["surfaces"]["bench"]["file"] == str(tmp_path / "daemon.toml")
    assert NOT_TARED not in checked(beam_of()).stdout


def test_a_service_that_is_asked_in_vain_is_waited_for_and_then_a_complaint(checked: Check) -> None:
    at_once = checked(beam_of(), "--wait", "0")
    assert (at_once.returncode, at_once.stderr) == (1, f"beamtouch-daemon: {UNREACHED}\n")
    assert NOT_ASKED not in at_once.stdout
    assert not json.loads(checked(beam_of(), "--wait", "0", "--json").stdout)["good"]


def test_a_service_is_asked_again_twice_a_second_until_the_time_is_over(
    checked: Check, monkeypatch: pytest.MonkeyPatch
) -> None:
    times_s, pauses, pause = iter((100.0, 101.0, 104.75, 105.0)), list[float](), asyncio.sleep

    async def sleep(pause_s: float) -> None:
        pauses.extend([pause_s] if pause_s else [])
        await pause(0)

    monkeypatch.setattr(check, "monotonic", lambda: next(times_s))
    monkeypatch.setattr(asyncio, "sleep", sleep)
    beam = beam_of()
    waited = checked(beam, "--wait", "5")
    assert (beam.given, pauses) == (90, [0.5, 0.25])
    # What is waited for is told once.
    assert waited.stderr.splitlines() == [f"waiting: {UNREACHED}", f"beamtouch-daemon: {UNREACHED}"]
