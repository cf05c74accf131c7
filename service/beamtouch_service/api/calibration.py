"""`GET /surfaces/NAME/calibration-data`: the best sample of each contact, for `design-sensors calibrate --events`."""

import csv
import io
from typing import Annotated

from fastapi import Query, Response
from pydantic import BaseModel, ConfigDict, Field

from beamtouch_service.access import Role
from beamtouch_service.api import examples, gate, openapi
from beamtouch_service.api.context import ContextParameter, SurfaceInPath
from beamtouch_service.api.errors import NO_STORE
from beamtouch_service.api.times import Time, microseconds
from beamtouch_service.events.store import Sampled
from beamtouch_service.problems import Kind
from beamtouch_service.surfaces.contact import rfc3339

CSV = "text/csv"
_DECIMALS = 10
"""Decimals of lengths in mm."""

router = gate.make_router("events", Role.READ)


class CalibrationQuery(BaseModel):
    """Query parameters of the best samples."""

    model_config = ConfigDict(extra="forbid")

    since: Time | None = Field(None, description="Only contacts that began at or after this time (RFC 3339).")
    until: Time | None = Field(None, description="Only contacts that began before this time.")
    limit: int = Field(1000, ge=1, le=5000, description="Maximum number of contacts: the newest ones.")


@router.get(
    "/surfaces/{name}/calibration-data",
    response_class=Response,
    responses={
        200: {
            "description": "A row per contact, oldest first.",
            "content": {CSV: {"schema": {"type": "string"}, "examples": {"a contact": {"value": examples.BEST_CSV}}}},
        },
        **openapi.problems(Kind.UNKNOWN_SURFACE, Kind.INVALID_REQUEST, Kind.NO_SURFACE, Kind.EVENTS_AWAY),
    },
)
async def get_calibration_data(
    context: ContextParameter, name: SurfaceInPath, query: Annotated[CalibrationQuery, Query()]
) -> Response:
    """Return the best sample of each contact as CSV: the steady one of the most readings, with all channels good.

    Contacts of another layout of channels are left out.
    """
    surface = context.registry.named(name)
    channels = surface.model.channels if surface.model else None
    span = microseconds(query.since), microseconds(query.until), query.limit
    found = await context.recorder.ask(lambda store: _as_csv(store.best_samples(name, *span), channels))
    return Response(found, headers=NO_STORE, media_type=CSV)


def _as_csv(found: list[Sampled], channels: list[str] | None) -> bytes:
    """Return best samples of these channels, or else of those of the newest one, as CSV."""
    readable = [(one, one.best) for one in found if one.best]
    layout = channels or (readable[-1][1].channels if readable else [])
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\r\n")
    columns = [f"{name}_{what}" for what in ("mm", "sd_mm", "rest_mm", "rest_sd_mm") for name in layout]
    writer.writerow(["event", "time", "model", "characteristic", "readings", *columns])
    for one, best in readable:
        if best.channels != layout:
            continue
        values = [best.deflection_mm, best.deviation_mm, best.rest_mm, best.rest_deviation_mm]
        said = [one.number, rfc3339(best.at_us), one.model, best.characteristic or "", best.readings]
        writer.writerow([*said, *(cell for each in values for cell in _cells(each, len(layout)))])
    return text.getvalue().encode()


def _cells(values: list[float] | None, count: int) -> list[str]:
    return [""] * count if values is None else [f"{value:.{_DECIMALS}f}" for value in values]
