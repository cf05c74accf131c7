"""The status of a surface at the broker: in one word what readiness says, with the channels that are the cause."""

import json

import pytest

from beamtouch_service.outputs.mqtt.statuses import status_of
from beamtouch_service.sections import SurfaceSection
from service.bench import Row, parsed, surface_of

NOW_S = 1000.0
REST: Row = [0.0] * 4
WEDGED: Row = [0.5, 0.25, 0.75, 0.125]
WITHOUT_S3 = ["good", "good", "missing", "good"]


@pytest.mark.promise(
    "docs/how-to/mqtt.md",
    "`status` is `ready`, or the last part of the `type` of the problem that there is",
    "(for longer than `unexplained_after_s`)",
    "(a sensor has been out for longer than `degraded_after_s`, and contacts are found without it)",
    "`channels` are those that are the cause, or the one of `check-NAME`.",
)
@pytest.mark.parametrize(
    ("row", "samples", "quality", "notes", "age_s", "status", "channels"),
    [
        (REST, 1, None, [], 0.0, "ready", []),
        (REST, 1, None, ["rate"], 0.0, "ready", []),
        (REST, 1, None, ["zeros"], 0.0, "zeros-moved", []),
        (REST, 1, None, [], 0.5001, "stale", []),
        (WEDGED, 90, None, [], 0.0, "ready", []),
        (WEDGED, 160, None, [], 0.0, "unexplained", ["s3"]),
        ([0.0, 0.0, None, 0.0], 360, WITHOUT_S3, [], 0.0, "ready", []),
        ([0.0, 0.0, None, 0.0], 440, WITHOUT_S3, [], 0.0, "channels-out", ["s3"]),
        ([0.0, None, None, None], 1, ["good", *["missing"] * 3], [], 0.0, "too-few-channels", ["s2", "s3", "s4"]),
    ],
)
def test_a_status_is_what_somebody_must_look_at(
    row: Row,
    samples: int,
    quality: list[str] | None,
    notes: list[str],
    age_s: float,
    status: str,
    channels: list[str],
) -> None:
    surface = surface_of(section=SurfaceSection(unexplained_after_s=0.5, degraded_after_s=2.0), channels=4)
    assert json.loads(status_of(surface, NOW_S))["status"] == "no-samples"
    batch = parsed(*[row] * samples, quality=quality)
    surface.receive(type(batch).model_validate(batch.model_dump() | {"notes": notes}), NOW_S)
    said = json.loads(status_of(surface, NOW_S + age_s))
    assert said == {"surface": "press-7", "status": status, "channels": channels}
