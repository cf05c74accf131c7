"""What `noise` prints: a table, the lines to paste, and remarks; and for how long it records."""

import asyncio
import math
from collections.abc import AsyncGenerator, Mapping
from contextlib import AbstractContextManager, nullcontext
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from beamtouch_common.errors import InputError
from beamtouch_daemon.commands.noise import Measurement, Recording, _as_json, _record, _seconds, report
from beamtouch_daemon.config.settings import Surface
from beamtouch_daemon.measuring.at_rest import NotAtRestError
from beamtouch_daemon.measuring.noise import ChannelNoise, Keys
from beamtouch_daemon.sources.reading import Reading
from beamtouch_daemon.sources.requests import Requests

from .surfaces import CHANNEL, mean_of, surface_of

FIRST = ChannelNoise("s1", 0.00212, 1.5, 0.00231, 0.002, 0.00047, None, 0.0001, False, 3, 1.25, 700)
SECOND = replace(FIRST, channel="s2", noise_mm=0.00312, correlated_readings=4.0, effective_noise_mm=0.0031, step_mm=0.0)
KEYS = Keys(0.00313, {}, 0.00311, 0.000625, None, None)
AVERAGED = surface_of(filter=mean_of(7))


def measurement(*channels: ChannelNoise, keys: Keys = KEYS, surface: Surface = AVERAGED, lost: int = 0) -> Measurement:
    recording = Recording(np.zeros((700, 2)), lost, 3.504)
    return Measurement("bench", surface, recording, channels or (FIRST, SECOND), keys)


PASTE = "        # in the daemon's configuration"


def test_the_noise_of_each_channel_is_a_row_and_the_keys_are_lines_to_paste() -> None:
    head, first, second, *lines = report([measurement()])
    assert head.split() == [
        *("surface", "channel", "noise", "mm", "correlation", "ms", "effective", "mm", "drift", "mm", "step", "mm")
    ]
    assert first.split() == ["bench", "s1", "0.00212", "7.5", "0.00231", "0.00047", "0.0001"]
    assert second.split() == ["bench", "s2", "0.00312", "20", "0.0031", "0.00047", "-"]
    assert head.index("noise mm") + len("noise mm") == first.index("0.00212") + len("0.00212")  # to the right
    assert lines == [
        "",
        "bench: 700 readings in 3.5 s; effective noise for the mean of 7 readings",
        "",
        f'[surfaces."bench"]{PASTE}',
        "noise_mm = 0.00313",
        "",
        "[sensors]        # in the scene, without noise_percent_of_max; then build the model again",
        "noise_mm = 0.00311",
        "zero_drift_mm = 0.000625        # within such a time; zeros drift further in a longer one",
    ]


def test_all_that_is_known_of_a_surface_is_stated() -> None:
    keys = Keys(0.00313, {"s2": 3460.0}, 0.00311, 0.000625, 4.35, 13)
    channels = [
        CHANNEL | {"name": name, "register": at, "position_mm": 85.5 + 100 * at} for at, name in enumerate(("s1", "s2"))
    ]
    lines = report([measurement(keys=keys, surface=surface_of(filter=mean_of(7), channels=channels), lost=6)])[3:]
    assert lines[1].startswith("bench: 700 readings in 3.5 s, 6 lost; effective")
    assert "stuck_after_ms = 3460.0        # under the channel s2: noise_mm would call it stuck" in lines
    assert lines[-7:] == [
        "noise_mm = 0.00311",
        "zero_drift_mm = 0.000625        # beside the drift that is followed",
        "adc_bits = 13",
        "fixed_mm = [85.5, 185.5]        # where the sensors are mounted; without it, a new layout may move them",
        "",
        "[environment]        # in the scene",
        "drift_um_per_min = 4.35        # also in zero_tracking of the daemon's configuration",
    ]


def test_on_a_plate_a_place_has_two_coordinates_and_one_that_is_missing_leaves_all_out() -> None:
    channels = [CHANNEL | {"name": f"s{at}", "register": at, "x_mm": 20.0 * at, "y_mm": 7.5} for at in (1, 2)]
    lines = report([measurement(surface=surface_of(channels=channels))])
    places = "[{ x_mm = 20.0, y_mm = 7.5 }, { x_mm = 40.0, y_mm = 7.5 }]"
    assert (
        lines[-1] == f"fixed = {places}        # where the sensors are mounted; without it, a new layout may move them"
    )
    unplaced = [channels[0], CHANNEL | {"name": "s2", "register": 2}]
    assert "fixed" not in report([measurement(surface=surface_of(channels=unplaced))])[-1]


def test_another_unit_than_mm_is_named_and_several_stand_behind_the_figures() -> None:
    field = replace(measurement(surface=surface_of(2, {"value_unit": "uT"})), surface="field")
    head, *_, last = report([field])[:12]
    assert head.split()[2:4] == ["noise", "uT"]
    assert "noise_mm = 0.00313        # in uT" in report([field])
    assert "noise_mm = 0.00311        # in uT" in report([field])
    head, first, *_ = report([measurement(), field])
    assert head.split() == ["surface", "channel", "noise", "correlation", "ms", "effective", "drift", "step"]
    assert first.split() == ["bench", "s1", "0.00212", "mm", "7.5", "0.00231", "mm", "0.00047", "mm", "0.0001", "mm"]
    assert last != head


@pytest.mark.parametrize(
    ("first", "second", "remarks"),
    [
        ({}, {}, []),
        (
            {"is_rounded": True},
            {"is_rounded": True},
            [
                "  s1, s2: the ADC's steps hide the noise, so a mean stays as wrong as a reading; a finer ADC or more "
                "noise would help"
            ],
        ),
        (
            {"mean_run": 4.04},
            {"mean_run": 8.0},
            [
                "  s1, s2: values come about 4 times in a row, so they change 50 times a second; set rate_hz to that, "
                "also in the scene"
            ],
        ),
        (
            {"effective_noise_mm": 0.00530},
            {"effective_noise_mm": 0.00530},
            [
                "  s1, s2: successive readings are alike, so the mean of 7 readings is up to 2.5 times as noisy as "
                "with white noise"
            ],
        ),
    ],
)
def test_what_a_mean_does_not_take_away_is_remarked_on_with_its_size(
    first: dict[str, Any], second: dict[str, Any], remarks: list[str]
) -> None:
    channels = replace(FIRST, **first), replace(SECOND, **second)
    lines = report([measurement(*channels)])
    assert [line for line in lines if line.startswith("  ")] == remarks


def test_the_json_has_each_figure_of_the_table_and_the_keys() -> None:
    found = _as_json(measurement(lost=6))
    assert (found["readings"], found["readings_lost"], found["seconds"]) == (700, 6, 3.504)
    assert (found["error"], found["filter"]) == (None, "the mean of 7 readings")
    assert found["channels"] == [
        {
            "channel": channel.channel,
            "noise_mm": channel.noise_mm,
            "correlation_ms": correlation_ms,
            "effective_noise_mm": channel.effective_noise_mm,
            "drift_mm": 0.00047,
            "step_mm": channel.step_mm,
            "steps_hide_noise": False,
        }
        for channel, correlation_ms in ((FIRST, 7.5), (SECOND, 20.0))
    ]
    assert found["daemon"] == {"noise_mm": 0.00313, "stuck_after_ms": {}}
    assert (found["scene"], found["environment"]) == ({"noise_mm": 0.00311, "zero_drift_mm": 0.000625}, {})
    keys = Keys(0.00313, {"s2": 3460.0}, 0.00311, 0.000625, 4.35, 13)
    stated = _as_json(measurement(keys=keys))
    assert stated["scene"] == {"noise_mm": 0.00311, "zero_drift_mm": 0.000625, "adc_bits": 13}
    assert stated["environment"] == {"drift_um_per_min": 4.35}


@pytest.mark.parametrize(
    ("asked", "window", "rate_hz", "seconds"),
    [
        (None, 1, 200.0, 60.0),
        (2.5, 1, 200.0, 2.5),  # 500 readings
        (3600.0, 1, 200.0, 3600.0),
        (None, 200, 200.0, 120.0),  # a hundred means, and a fifth more
        (None, 3, 0.2, 3000.0),
        (None, 3, 0.15, 3600.0),  # what is needed takes 3333 s
        (200.0, 1, 10_000.0, 200.0),  # two million readings
    ],
)
def test_a_recording_takes_a_minute_or_as_long_as_its_filter_needs(
    asked: float | None, window: int, rate_hz: float, seconds: float
) -> None:
    assert _seconds(asked, surface_of(filter=mean_of(window), rate_hz=rate_hz)) == pytest.approx(seconds)


@pytest.mark.parametrize(
    ("asked", "rate_hz", "said"),
    [
        (2.4, 200.0, "--seconds: give 2.5 to 3600, as its rate and its filter require"),
        (3601.0, 200.0, "--seconds: give 2.5 to 3600, as its rate and its filter require"),
        (201.0, 10_000.0, "--seconds: give 0.05 to 200, as its rate and its filter require"),
        (None, 0.125, "its filter needs 4000 s of readings, and at most 3600 s are recorded"),
    ],
)
def test_a_time_that_gives_too_few_readings_or_too_many_is_refused(
    asked: float | None, rate_hz: float, said: str
) -> None:
    with pytest.raises(InputError) as raised:
        _seconds(asked, surface_of(rate_hz=rate_hz))
    assert str(raised.value) == said


class Line:
    """A source of two readings at a time, of which each is followed by so many that are lost."""

    limits: tuple[str, ...] = ()
    requests: Mapping[str, Requests] = {}

    def __init__(self, rate_hz: float, lost: int) -> None:
        self.given = 0
        self._rate_hz, self._lost = rate_hz, lost

    def kept_open(self) -> AbstractContextManager[None]:
        return nullcontext()

    async def readings(self) -> AsyncGenerator[list[Reading], None]:
        while True:
            taken = []
            for _ in range(2):
                self.given += 1
                at_s = 50.0 + self.given * (1 + self._lost) / self._rate_hz
                taken.append(Reading(at_s, (7.0, None), self._lost))
            yield taken


def test_a_recording_ends_after_its_time_and_counts_what_was_lost() -> None:
    surface, line = surface_of(rate_hz=100.0, filter=mean_of(1)), Line(100.0, 0)
    counts, lost, seconds = asyncio.run(_record(line, 6.0, surface))
    assert (len(counts), lost, round(seconds, 6)) == (600, 0, 6.0)
    assert counts[0, 0] == 7.0
    assert math.isnan(counts[0, 1])


def test_a_recording_that_lacks_readings_takes_longer_up_to_a_minute_or_its_time_again() -> None:
    surface = surface_of(rate_hz=100.0, filter=mean_of(1))
    counts, lost, seconds = asyncio.run(_record(Line(100.0, 3), 6.0, surface))
    assert (len(counts), lost, round(seconds, 1)) == (500, 1500, 20.0)
    for asked_s, longest_s in ((6.0, 66.0), (100.0, 200.0)):
        line = Line(100.0, round(longest_s / 5) + 1)  # too few in any case
        with pytest.raises(NotAtRestError) as raised:
            asyncio.run(_record(line, asked_s, surface))
        message = "readings arrived and its filter needs 500; give a longer --seconds"
        assert str(raised.value) == f"{line.given} {message}"
        assert line.given == pytest.approx(100 * longest_s / (round(longest_s / 5) + 2), abs=2.5)
