"""Channels of one surface that are judged in different ways: each by its own time, or by the noise."""

import pytest

from beamtouch_daemon.config.settings import Surface
from beamtouch_daemon.measuring.at_rest import NotAtRestError, select_rest
from beamtouch_daemon.processing.pipeline import Pipeline
from beamtouch_daemon.sources.reading import Reading
from beamtouch_service.samples import Quality

from .surfaces import CHANNEL, MINUTE, NOISE_MM, RATE_HZ, autoregressive, counts_of, four_channels

STATED_MS = 1000.0
"""Of s1. The noise shows s2 after a dozen readings."""
LONG = round(2 * STATED_MS / 1e3 * RATE_HZ)
READINGS = 3 * LONG


def mixed(noise_mm: float | None) -> Surface:
    """Return a surface of which only s1 states how long it may stand still."""
    channels: list[dict[str, object]] = [{"name": f"s{index + 1}", "register": index} | CHANNEL for index in range(2)]
    channels[0]["stuck_after_ms"] = STATED_MS
    source = {"kind": "modbus-tcp", "host": "127.0.0.1"}
    return Surface.model_validate({"rate_hz": RATE_HZ, "source": source, "channels": channels, "noise_mm": noise_mm})


def first_stuck(surface: Surface) -> list[int | None]:
    """Let both channels stand still; return the number of the first sample in which each is stuck."""
    pipeline = Pipeline(surface)
    readings = [Reading(index / RATE_HZ, (20_000.0, 20_000.0)) for index in range(READINGS)]
    samples = [taken.sample for taken in pipeline.process(readings, 0.0)]
    assert len(samples) == READINGS
    return [
        next((one.sequence for one in samples if one.quality[channel] is Quality.STUCK), None) for channel in (0, 1)
    ]


@pytest.mark.promise("docs/reference/daemon-configuration.md", "default: from the surface's `noise_mm`")
def test_a_time_that_one_channel_states_leaves_the_others_to_the_noise() -> None:
    stated, by_noise = first_stuck(mixed(NOISE_MM))
    assert stated == round(STATED_MS / 1e3 * RATE_HZ) + 1
    assert by_noise is not None
    assert by_noise < stated / 5


def test_where_the_noise_is_not_known_only_the_channel_that_states_a_time_is_judged() -> None:
    assert first_stuck(mixed(None)) == [round(STATED_MS / 1e3 * RATE_HZ) + 1, None]


def test_a_recording_judges_each_channel_in_its_own_way() -> None:
    counts = counts_of(NOISE_MM * autoregressive(0.0))
    counts[:, 1] = counts[:, 2] = 20_000  # s2 states that it may stand still for so long, s3 states nothing
    surface = four_channels()
    patient = surface.channels[1].model_copy(update={"stuck_after_ms": 2e3 * MINUTE / RATE_HZ})
    channels = [surface.channels[0], patient, *surface.channels[2:]]
    surface = surface.model_copy(update={"channels": channels})
    with pytest.raises(NotAtRestError, match=r"^s3 stuck: "):
        select_rest(counts, surface, {})
