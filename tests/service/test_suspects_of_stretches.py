"""Whom a long unexplained stretch suspects: the channel that this stretch has shown, and none of an earlier one."""

import pytest

from beamtouch_service.sections import SurfaceSection
from service.bench import Bench, Row, surface_of
from service.event_story import Story

REST: Row = [0.0] * 4
WEDGED: Row = [0.5, 0.25, 0.75, 0.125]
"""Without s3, a contact."""
TANGLED: Row = [0.5, -0.25, 0.25, 0.125]
"""No channel alone is to blame."""
STEPS = 30


def deliver(story: Story, first: int, last: int) -> None:
    """Send samples as the time passes that they took."""
    for begin in range(first, last, STEPS):
        end = min(begin + STEPS, last)
        story.bench.now_s += (end - begin) * 0.005
        story.deliver(begin, end)


def test_a_second_stretch_does_not_accuse_the_channel_of_the_first(caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level("WARNING", "beamtouch_service")
    bench = Bench(surface_of(section=SurfaceSection(unexplained_after_s=0.5), channels=4))
    story = Story(bench, [REST, *[WEDGED] * 200, *[REST] * 29, *[TANGLED] * 200])
    deliver(story, 0, 201)
    problem = bench.get("/health/ready?health=true").json()["surfaces"]["press-7"]
    assert (problem["suspect"], problem["detail"][-16:]) == ("s3", "Check sensor s3.")
    deliver(story, 201, 230)
    assert bench.contact()["state"] == "clear"
    assert bench.get("/health/ready?health=true").status_code == 200
    bench.metrics()
    deliver(story, 230, 430)
    assert (bench.contact()["state"], bench.contact()["notes"]) == ("unexplained", [])
    problem = bench.get("/health/ready?health=true").json()["surfaces"]["press-7"]
    assert problem["suspect"] is None
    assert problem["detail"].endswith("Look for a second load and for anything under the beam.")
    first, second = caplog.messages
    assert "check sensor s3" in first
    assert "s3" not in second
