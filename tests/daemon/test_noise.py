"""`noise`: the command on real lines."""

import json
import math
import random
import re
import tomllib
from pathlib import Path

import pytest

from support.surfaces import configs

from .devices import SerialDevice, pymodbus_server
from .lines import Terminal, terminal
from .process import command
from .surfaces import NOISE_MM, STEP_MM, of_white

NOISE_COUNTS = NOISE_MM / STEP_MM
CHANCE = random.Random(3)  # noqa: S311 - noise, not secrets


class NoisyDevice(SerialDevice):
    """A serial device whose first channel has white noise, and its second noise that stays alike."""

    def __init__(self, line: Terminal, alike: float) -> None:
        super().__init__(line)
        self._alike, self._last = alike, 0.0

    def counts(self, _sequence: int) -> tuple[int, ...]:
        self._last = self._alike * self._last + math.sqrt(1 - self._alike**2) * CHANCE.gauss()
        return round(20_000 + NOISE_COUNTS * CHANCE.gauss()), round(20_000 + NOISE_COUNTS * self._last)


async def noise(_function: int, _start: int, _address: int, _count: int, now: list[int], _set: object) -> None:
    now[:2] = [round(20_000 + CHANCE.gauss(sigma=NOISE_COUNTS)) for _ in range(2)]


async def step(_function: int, _start: int, _address: int, _count: int, now: list[int], _set: object) -> None:
    now[2] += 1
    touched = 1000 if now[2] > 300 else 0
    now[:2] = [round(20_000 + touched + CHANCE.gauss(sigma=NOISE_COUNTS)) for _ in range(2)]


def surface(name: str, source: str) -> str:
    return configs.surface(name, source).replace("window = 1", "window = 4")


@pytest.mark.anyio
async def test_noise_is_measured_on_all_surfaces_at_once_and_each_that_cannot_be_fails_alone(tmp_path: Path) -> None:
    with terminal() as line:
        NoisyDevice(line, 0.8)
        async with (
            pymodbus_server([20_000, 20_000], noise) as port,
            pymodbus_server([20_000, 20_000, 0], step) as other,
            pymodbus_server([65_535, 20_000]) as full,
        ):
            sources = {"line": configs.serial(line.path)}
            sources |= {"bus": configs.tcp(port), "touched": configs.tcp(other), "full": configs.tcp(full)}
            sources["absent"] = configs.tcp(1)
            config = configs.write(tmp_path, *(surface(*item) for item in sources.items()))
            outcome = await command("noise", config, "--seconds", "3", "--json")
    assert outcome.code == 1
    found = json.loads(outcome.out)["surfaces"]
    assert (found["line"]["filter"], found["bus"]["error"]) == ("the mean of 4 readings", None)
    white, alike = found["line"]["channels"]
    for one in (white, *found["bus"]["channels"]):
        assert one["effective_noise_mm"] == pytest.approx(NOISE_MM, rel=0.35)
    assert alike["effective_noise_mm"] == pytest.approx(NOISE_MM * of_white(4, 0.8), rel=0.4)
    # The time itself scatters by its own size in three seconds: over a minute it is held above.
    assert min(one["correlation_ms"] for one in found["line"]["channels"]) > 0
    assert found["line"]["daemon"]["noise_mm"] >= alike["effective_noise_mm"]
    assert found["line"]["scene"]["zero_drift_mm"] >= alike["effective_noise_mm"] / 5
    assert re.search("s1 moved by 0.[01][0-9]* mm after .* s; take everything off", found["touched"]["error"])
    refused = [said for said in outcome.err.splitlines() if said.startswith("beamtouch-daemon: ")]
    for said, words in zip(
        refused,
        (
            "touched: not measured: s1 moved by ",
            "full: not measured: s1 is saturated in .* readings; check the sensor",
            "absent: not measured: no connection to 127.0.0.1:1",
        ),
        strict=True,
    ):
        assert re.search(words, said)


@pytest.mark.anyio
async def test_the_printed_lines_are_keys_of_the_configuration(tmp_path: Path) -> None:
    async with pymodbus_server([20_000, 20_000], noise) as port:
        path = configs.write(tmp_path, surface("bench", configs.tcp(port)))
        outcome = await command("noise", path, "--seconds", "2.5")
        assert outcome.code == 0, outcome.err
        _, daemon, scene = re.split(r"^(?=\[)", outcome.out, flags=re.MULTILINE)
        stated = tomllib.loads(daemon)["surfaces"]["bench"]
        assert sorted(tomllib.loads(scene)["sensors"]) == ["noise_mm", "zero_drift_mm"]
        assert stated == {"noise_mm": pytest.approx(NOISE_MM, rel=0.3)}
        text = path.read_text()
        for name, place_mm in (("s1", 85.5), ("s2", 354.0)):
            text = text.replace(f'name = "{name}"', f'name = "{name}"\nposition_mm = {place_mm}', 1)
        path.write_text(text)
        outcome = await command("noise", path, "--seconds", "2.5")
        *_, scene = re.split(r"^(?=\[)", outcome.out, flags=re.MULTILINE)
        assert tomllib.loads(scene)["sensors"]["fixed_mm"] == [85.5, 354.0]
        assert stated == {"noise_mm": pytest.approx(NOISE_MM, rel=0.3)}
        on_plate = tmp_path / "plate.toml"
        on_plate.write_text(text.replace("position_mm", "y_mm = 20.5\nx_mm"))
        outcome = await command("noise", on_plate, "--seconds", "2.5")
        *_, scene = re.split(r"^(?=\[)", outcome.out, flags=re.MULTILINE)
        fixed = [{"x_mm": 85.5, "y_mm": 20.5}, {"x_mm": 354.0, "y_mm": 20.5}]
        assert tomllib.loads(scene)["sensors"]["fixed"] == fixed
        path.write_text(path.read_text().replace("rate_hz", f"noise_mm = {stated['noise_mm']}\nrate_hz", 1))
        assert (await command("tare", path)).code == 0


@pytest.mark.anyio
@pytest.mark.parametrize(
    ("rate_hz", "seconds", "said"),
    [
        (200.0, "2.4", "--seconds: give 2.5 to 3600, as its rate and its filter require"),
        (200.0, "nan", "--seconds: give 2.5 to 3600, as its rate and its filter require"),
        (0.1, "60", "its filter needs 5000 s of readings, and at most 3600 s are recorded"),
    ],
)
async def test_a_time_that_cannot_be_is_refused_at_once(
    tmp_path: Path, rate_hz: float, seconds: str, said: str
) -> None:
    outcome = await command("noise", configs.write(tmp_path, configs.surface(rate_hz=rate_hz)), "--seconds", seconds)
    assert (outcome.code, outcome.out) == (2, "")
    assert outcome.complaint() == said
