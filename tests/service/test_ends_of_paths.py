"""The ends of the path of a contact: its first sample and its last one, however few points there are between."""

from datetime import datetime, timedelta

import pytest

from service.bench import Bench, Row
from service.event_story import RESTING, Story

MAX_POINTS = 200
EVERY = timedelta(milliseconds=5)


def sliding(samples: int) -> list[Row]:
    """Return the samples of a contact that slides along the beam, the last of them elsewhere than all others."""
    return [[0.5, 0.1 + 0.3 * number / samples, 0.1] for number in range(samples)]


@pytest.mark.parametrize("samples", [3, 150, 398, 401, 999])
def test_a_path_begins_with_the_touch_and_ends_with_the_last_sample(bench: Bench, samples: int) -> None:
    contact = sliding(samples)
    story = Story(bench, [RESTING, *contact, *[RESTING] * 3])
    story.deliver(0, len(story.rows))
    (listed,) = bench.get("/events").json()["events"]
    event = bench.get(f"/events/{listed['id']}").json()
    path = event["path"]
    assert 3 <= len(path) <= MAX_POINTS
    touched, lifted = (datetime.fromisoformat(event[name]) for name in ("touched_at", "lifted_at"))
    times = [datetime.fromisoformat(point["at"]) for point in path]
    assert (times[0], times[-1]) == (touched, lifted - EVERY)
    assert times == sorted(set(times))
    for point, row in ((path[0], contact[0]), (path[-1], contact[-1])):
        # As the small model has it.
        assert point["position_mm"] == pytest.approx(100 + 100 * ((row[1] or 0.0) + 2 * (row[2] or 0.0)), abs=0.1)
