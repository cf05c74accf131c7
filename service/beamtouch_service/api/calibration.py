"""`GET /surfaces/NAME/calibration-data`: the best sample of each contact, for `design-sensors calibrate --events`."""

import csv
import io
from typing import Annotated

from fastapi import Query, Response
from pydantic import BaseModel, ConfigDict, Field

from beamtouch_service.access import Role
from beamtouch_service.api import gate
from beamtouch_service.api.context import ContextParameter, SurfaceInPath
from beamtouch_service.api.events import Time, microseconds
from beamtouch_service.events.store import Sampled
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
        200: {"description": "A row per contact, oldest first.", "content": {CSV: {"schema": {"type": "string"}}}}
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
    content = await context.recorder.ask(lambda store: _as_csv(store.best_samples(name, *span), channels))
    return Response(content, media_type=CSV)


def _as_csv(contacts: list[Sampled], channels: list[str] | None) -> str:
    """Return best samples of these channels, or else of those of the newest one, as CSV."""
    readable = [(contact, contact.best) for contact in contacts if contact.best]
    layout = channels or (readable[-1][1].channels if readable else [])
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\r\n")
    columns = [f"{name}_{what}" for what in ("mm", "sd_mm", "rest_mm", "rest_sd_mm") for name in layout]
    writer.writerow(["event", "time", "model", "characteristic", "readings", *columns])
    for contact, best in readable:
        if best.channels != layout:
            continue
        values = [best.deflection_mm, best.deviation_mm, best.rest_mm, best.rest_deviation_mm]
        about = [contact.number, rfc3339(best.at_us), contact.model, best.characteristic or "", best.readings]
        writer.writerow([*about, *(cell for each in values for cell in _cells(each, len(layout)))])
    return text.getvalue()


def _cells(values: list[float] | None, count: int) -> list[str]:
    return [""] * count if values is None else [f"{value:.{_DECIMALS}f}" for value in values]
