"""Modules that are read faster than they measure: `noise` states a time after which they are stuck, and not before."""

import numpy as np
import pytest

from beamtouch_daemon.measuring.noise import keys_of, measure_noise
from beamtouch_daemon.processing.stuck import Runs, longest_runs
from beamtouch_models.filters import FloatArray

from .surfaces import CHANNEL, CHANNELS, MINUTE, NOISE_MM, counts_of, four_channels

SLOW = (1, 3)
"""Channels whose module repeats itself; the others measure anew for each reading."""


def recorded(held: int, seed: int) -> FloatArray:
    """Return a minute of counts at rest, in which slow modules repeat each value so often, or once more."""
    chance = np.random.default_rng(seed)
    noise = chance.standard_normal((MINUTE, CHANNELS))
    for channel in SLOW:
        lengths = held + chance.integers(0, 2, size=MINUTE // held + 1)
        noise[:, channel] = np.repeat(chance.standard_normal(len(lengths)), lengths)[:MINUTE]
    return counts_of(NOISE_MM * noise)


@pytest.mark.promise(
    "docs/explanation/readings-to-samples.md",
    (
        "or that repeats itself, as a module does that is read faster than it measures; then it says which `rate_hz` "
        "would do."
    ),
)
@pytest.mark.parametrize("held", [4, 8, 40])
def test_a_module_that_repeats_itself_is_not_stuck_and_a_dead_one_is_soon(held: int) -> None:
    surface = four_channels()
    keys = keys_of(measure_noise(recorded(held, 1), surface), surface)
    assert sorted(keys.stuck_after_ms) == [f"s{channel + 1}" for channel in SLOW]
    channels = [
        CHANNEL | {"name": name, "register": index, "stuck_after_ms": keys.stuck_after_ms.get(name)}
        for index, name in enumerate(f"s{index + 1}" for index in range(CHANNELS))
    ]
    stated = four_channels(channels=channels, noise_mm=keys.daemon_noise_mm)
    allowed = longest_runs(stated)
    longest = np.max([Runs.of(stated).lengths(recorded(held, seed)).max(axis=0) for seed in range(2, 12)], axis=0)
    assert np.all(longest <= allowed)
    # Ten minutes come near it: a cable that is off is noticed after a few of its values.
    assert np.all(allowed[list(SLOW)] < 6 * longest[list(SLOW)])
