"""`noise` on real lines with known noise."""

import json
import math
import random
import re
import tomllib
from pathlib import Path

import numpy as np
import pytest

from . import configs
from .devices import SerialDevice, pymodbus_server
from .lines import Terminal, terminal
from .process import command

pytestmark = pytest.mark.anyio

NOISE_COUNTS = 20.0
NOISE_MM = NOISE_COUNTS * 0.0001
CHANCE = random.Random(3)  # noqa: S311 - noise, not secrets


class NoisyDevice(SerialDevice):
    """A serial device whose first channel has white noise, and its second noise that stays alike."""

    def __init__(self, line: Terminal, alike: float) -> None:
        super().__init__(line)
        self._alike, self._last = alike, 0.0
        self._random = np.random.default_rng(5)

    def counts(self, _sequence: int) -> tuple[int, ...]:
        white, fresh = self._random.standard_normal(2).tolist()
        self._last = self._alike * self._last + math.sqrt(1 - self._alike**2) * fresh
        return round(20_000 + NOISE_COUNTS * white), round(20_000 + NOISE_COUNTS * self._last)


async def noise(_function: int, _start: int, _address: int, _count: int, now: list[int], _set: object) -> None:
    now[:2] = [round(20_000 + CHANCE.gauss(sigma=NOISE_COUNTS)) for _ in range(2)]


async def step(_function: int, _start: int, _address: int, _count: int, now: list[int], _set: object) -> None:
    now[2] += 1
    touched = 1000 if now[2] > 300 else 0
    now[:2] = [round(20_000 + touched + CHANCE.gauss(sigma=NOISE_COUNTS)) for _ in range(2)]


def surface(name: str, source: str, window: int = 4) -> str:
    return configs.surface(name, source).replace("window = 1", f"window = {window}")


async def test_the_noise_of_a_serial_and_a_modbus_device_is_measured_at_the_same_time(tmp_path: Path) -> None:
    with terminal() as line:
        NoisyDevice(line, 0.8)
        async with pymodbus_server([20_000, 20_000], noise) as port:
            surfaces = surface("line", configs.serial(line.path)), surface("bus", configs.tcp(port))
            outcome = await command("noise", configs.write(tmp_path, *surfaces), "--seconds", "8", "--json")
    assert outcome.code == 0, outcome.err
    assert outcome.err.count("keep everything off the beam") == 2
    found = json.loads(outcome.out)["surfaces"]
    assert (found["line"]["filter"], found["bus"]["error"]) == ("the mean of 4 readings", None)
    white, alike = found["line"]["channels"]
    assert [one["noise_mm"] for one in found["bus"]["channels"]] == [pytest.approx(NOISE_MM, rel=0.2)] * 2
    assert white["noise_mm"] == pytest.approx(NOISE_MM, rel=0.2)
    assert white["effective_noise_mm"] == pytest.approx(NOISE_MM, rel=0.25)
    lags = np.arange(1, 4)
    expected = NOISE_MM * math.sqrt(1 + 2 * float(np.sum((1 - lags / 4) * 0.8**lags)))
    assert alike["effective_noise_mm"] == pytest.approx(expected, rel=0.35)  # 1.8 times the noise
    assert alike["correlation_ms"] > 2 * white["correlation_ms"]
    assert found["line"]["daemon"]["noise_mm"] >= alike["effective_noise_mm"]
    assert found["line"]["scene"]["zero_drift_mm"] >= alike["effective_noise_mm"] / 5


async def test_the_printed_lines_are_keys_of_the_configuration(tmp_path: Path) -> None:
    async with pymodbus_server([20_000, 20_000], noise) as port:
        path = configs.write(tmp_path, surface("bench", configs.tcp(port)))
        outcome = await command("noise", path, "--seconds", "5")
        assert outcome.code == 0, outcome.err
        head = " ".join(outcome.out.splitlines()[0].split())
        assert head == "surface channel noise mm correlation ms effective mm drift mm step mm"
        _, daemon, scene = re.split(r"^(?=\[)", outcome.out, flags=re.MULTILINE)
        stated = tomllib.loads(daemon)["surfaces"]["bench"]
        assert sorted(tomllib.loads(scene)["sensors"]) == ["noise_mm", "zero_drift_mm"]
        assert stated == {"noise_mm": pytest.approx(NOISE_MM, rel=0.25)}
        path.write_text(path.read_text().replace("rate_hz", f"noise_mm = {stated['noise_mm']}\nrate_hz", 1))
        assert (await command("tare", path)).code == 0


async def test_a_touched_beam_fails_in_one_line_and_the_others_are_measured(tmp_path: Path) -> None:
    async with pymodbus_server([20_000, 20_000, 0], step) as port, pymodbus_server([20_000, 20_000], noise) as other:
        touched, still = configs.tcp(port), configs.tcp(other)
        config = configs.write(tmp_path, surface("touched", touched), surface("still", still))
        outcome = await command("noise", config, "--seconds", "5", "--json")
    assert outcome.code == 1
    found = json.loads(outcome.out)["surfaces"]
    assert found["still"]["error"] is None
    assert re.search("s1 moved by 0.[01][0-9]* mm after .* s; take everything off", found["touched"]["error"])
    assert outcome.err.splitlines()[-1].startswith("beamtouch-daemon: touched: not measured: s1 moved by ")


async def test_a_device_that_cannot_be_read_fails_in_one_line(tmp_path: Path) -> None:
    async with pymodbus_server([65_535, 20_000], None) as port:
        config = configs.write(tmp_path, surface("full", configs.tcp(port)), surface("absent", configs.tcp(1)))
        outcome = await command("noise", config, "--seconds", "3")
    assert (outcome.code, outcome.out) == (1, "")
    complaints = [line for line in outcome.err.splitlines() if line.startswith("beamtouch-daemon: ")]
    assert len(complaints) == 2
    assert re.match(
        "beamtouch-daemon: full: not measured: s1 is saturated in .* readings; check the sensor", complaints[0]
    )
    assert complaints[1].startswith("beamtouch-daemon: absent: not measured: no connection to 127.0.0.1:1")


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (("--seconds", "2.4"), "--seconds: give 2.5 to 3600, as its rate and its filter require"),
        (("--seconds", "nan"), "--seconds: give 2.5 to 3600, as its rate and its filter require"),
        (("--seconds", "3601"), "--seconds: give 2.5 to 3600, as its rate and its filter require"),
        (("--surface", "press"), "--surface: there is no surface press; choose one of bench"),
    ],
)
async def test_wrong_input_is_one_line(tmp_path: Path, options: tuple[str, ...], said: str) -> None:
    outcome = await command("noise", configs.write(tmp_path, configs.surface()), *options)
    assert (outcome.code, outcome.out) == (2, "")
    assert outcome.complaint() == said


async def test_readings_that_take_longer_than_is_recorded_are_refused_at_once(tmp_path: Path) -> None:
    outcome = await command("noise", configs.write(tmp_path, configs.surface(rate_hz=0.1)))
    assert (outcome.code, outcome.out) == (2, "")
    assert outcome.complaint() == "its filter needs 5000 s of readings, and at most 3600 s are recorded"
