"""The path of a contact from its first sample to its last one, however few points there are between."""

from datetime import datetime, timedelta

import pytest

from service.bench import Bench, Row
from service.event_story import RESTING, Story

MAX_POINTS = 25


def sliding(samples: int) -> list[Row]:
    """Return the samples of a contact that slides along the beam, the last of them elsewhere than all others."""
    return [[0.5, 0.1 + 0.3 * number / samples, 0.1] for number in range(samples)]


@pytest.mark.parametrize("samples", [3, 150, 398, 401, 999])
def test_a_path_covers_a_contact_from_the_touch_to_the_lift(bench: Bench, samples: int) -> None:
    contact = sliding(samples)
    story = Story(bench, [RESTING, *contact, *[RESTING] * 3])
    story.deliver(0, len(story.rows))
    (listed,) = bench.get("/events").json()["events"]
    event = bench.get(f"/events/{listed['id']}").json()
    path = event["path"]
    assert 2 <= len(path) <= MAX_POINTS
    touched, lifted = (datetime.fromisoformat(event[name]) for name in ("touched_at", "lifted_at"))
    begins = [datetime.fromisoformat(point["at"]) for point in path]
    ends = [begin + timedelta(milliseconds=point["lasts_ms"]) for begin, point in zip(begins, path, strict=True)]
    assert (begins[0], ends[-1]) == (touched, lifted)
    assert begins[1:] == ends[:-1]
    for point, row in ((path[0], contact[0]), (path[-1], contact[-1])):
        # As the small model has it, within the way of one stay.
        assert point["position_mm"] == pytest.approx(100 + 100 * ((row[1] or 0.0) + 2 * (row[2] or 0.0)), abs=6)
