"""A channel that was out for long is back soon after its repair: it makes up for the stated time at most."""

import pytest

from beamtouch_service.sections import SurfaceSection
from service.bench import START_US, Bench, surface_of

AFTER_S = 2.0
EVERY_US = 400_000
"""Between samples: less than the surface takes for a pause."""
CHUNK = 100
GOOD, BAD = ["good"] * 4, ["good", "good", "missing", "good"]


class Cable:
    """Sends samples of a beam at rest, whose third channel may be off."""

    def __init__(self) -> None:
        section = SurfaceSection(degraded_after_s=AFTER_S, stale_ms=1000)
        self.bench, self._sent = Bench(surface_of(section=section, channels=4)), 0

    def send(self, seconds: float, *, is_off: bool) -> None:
        left = round(seconds * 1e6 / EVERY_US)
        while left > 0:
            count = min(left, CHUNK)
            row = [0.0, 0.0, None if is_off else 0.0, 0.0]
            self.bench.now_s += count * EVERY_US / 1e6
            begin_us = START_US + self._sent * EVERY_US
            self.bench.send(
                *[row] * count,
                sequence=self._sent + 1,
                quality=BAD if is_off else GOOD,
                begin_us=begin_us,
                every_us=EVERY_US,
            )
            self._sent, left = self._sent + count, left - count

    @property
    def is_out(self) -> bool:
        return "s3" in self.bench.get("/surfaces/press-7").json()["channels_out"]


@pytest.mark.promise(
    "docs/reference/sensor-health.md",
    "a channel is back after as long as it was away, at most `degraded_after_s`",
)
@pytest.mark.promise(
    "docs/how-to/troubleshooting.md",
    "When the sensor is good again, the note `degraded` goes after at most `degraded_after_s`.",
)
@pytest.mark.parametrize("off_s", [4.0, 40.0, 4000.0])
def test_however_long_a_cable_was_off_it_is_back_after_the_stated_time(off_s: float) -> None:
    cable = Cable()
    cable.send(off_s, is_off=True)
    assert cable.is_out
    assert cable.bench.contact()["notes"] == ["degraded"]
    cable.send(AFTER_S - 0.8, is_off=False)
    assert cable.is_out, "a cable that makes contact for a moment is not repaired"
    cable.send(0.8, is_off=False)
    assert not cable.is_out
    assert cable.bench.contact()["notes"] == []


def test_a_long_good_time_buys_no_patience() -> None:
    cable = Cable()
    cable.send(4000.0, is_off=False)
    cable.send(AFTER_S - 0.8, is_off=True)
    assert not cable.is_out
    cable.send(1.6, is_off=True)
    assert cable.is_out
