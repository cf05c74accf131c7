"""The route of the best samples, for `design-sensors calibrate --events`."""

from collections.abc import Iterator, Sequence
from functools import partial
from typing import Annotated

from fastapi import Query, Response
from pydantic import BaseModel, ConfigDict, Field

from beamtouch_service.access import Role
from beamtouch_service.api import gate
from beamtouch_service.api.context import ContextParameter, SurfaceInPath
from beamtouch_service.api.csv_parts import MEDIA_TYPE, RESPONSES, CsvParts
from beamtouch_service.api.record_answers import SLOT, answer_in_parts
from beamtouch_service.api.times import Time, microseconds
from beamtouch_service.record import EventKey, Reader, find_best_samples, read_best_samples
from beamtouch_service.surfaces.contact import rfc3339

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
    responses={200: {"description": "A row per contact, oldest first.", **RESPONSES}},
    dependencies=[SLOT],
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
    keys = await context.recorder.readers.read(lambda reader: find_best_samples(reader, name, *span))
    return await answer_in_parts(context, partial(_as_csv, keys=keys, channels=channels), MEDIA_TYPE)


def _as_csv(reader: Reader, keys: Sequence[EventKey], channels: list[str] | None) -> Iterator[bytes]:
    """Give best samples of these channels, or else of those of the newest one, as CSV."""
    layout = channels or _newest_channels(reader, keys)
    columns = [f"{name}_{what}" for what in ("mm", "sd_mm", "rest_mm", "rest_sd_mm") for name in layout]
    csv = CsvParts(["event", "time", "model", "characteristic", "readings", *columns])
    for contacts in read_best_samples(reader, keys):
        for contact in contacts:
            reader.rest()
            best = contact.best
            if best is None or best.channels != layout:
                continue
            values = [best.deflection_mm, best.deviation_mm, best.rest_mm, best.rest_deviation_mm]
            about = [contact.number, rfc3339(best.at_us), contact.model, best.characteristic or "", best.readings]
            csv.add([*about, *(cell for each in values for cell in _cells(each, len(layout)))])
        yield csv.take()
    yield csv.take()


def _newest_channels(reader: Reader, keys: Sequence[EventKey]) -> list[str]:
    """Return the channels of the newest best sample that can be read; none without one."""
    for key in reversed(keys):
        for contacts in read_best_samples(reader, [key]):
            for contact in contacts:
                if contact.best:
                    return contact.best.channels
    return []


def _cells(values: list[float] | None, count: int) -> list[str]:
    return [""] * count if values is None else [f"{value:.{_DECIMALS}f}" for value in values]
