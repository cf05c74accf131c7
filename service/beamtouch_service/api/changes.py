"""What goes on the trail: starts, models, tares, uses of tokens, and commissionings, from the state of the service."""

import asyncio
import time
from collections.abc import Mapping

from beamtouch_service.api.context import Context
from beamtouch_service.callers import Caller
from beamtouch_service.record import Action, Entry, encode_details
from beamtouch_service.samples import Batch
from beamtouch_service.surfaces.surface import Surface

LOOK_S = 1.0
"""Time between two looks at the models of all surfaces."""


def make_entry(
    action: Action, details: Mapping[str, object], caller: Caller | None = None, *, surface: str = "", subject: str = ""
) -> Entry:
    """Return an entry of now, by a caller or by the service itself."""
    at_us, text = round(time.time() * 1e6), encode_details(details)
    if caller is None:
        return Entry(at_us, action, text, surface, subject)
    return Entry(at_us, action, text, surface, subject, caller.name, caller.token, caller.address)


def note_token(context: Context, caller: Caller) -> None:
    """Note who sent a request that writes."""
    subject = f"{caller.token} {caller.address}"

    def make() -> Entry:
        return make_entry(Action.TOKEN, {}, caller, subject=subject)

    context.recorder.trail.note_state(Action.TOKEN, "", subject, None, context.clock(), make)


def note_tare(context: Context, surface: str, batch: Batch, caller: Caller) -> None:
    """Note the rest gaps and characteristics that a batch was made with."""
    if batch.characteristic is None or batch.backlog:
        return

    def make() -> Entry:
        details = {"characteristic": batch.characteristic, "tared_at": batch.tared_at}
        return make_entry(Action.TARE, details, caller, surface=surface)

    value = (batch.characteristic, batch.tared_at)
    context.recorder.trail.note_state(Action.TARE, surface, "", value, context.clock(), make)


async def watch_models(context: Context) -> None:
    """Note the models of all surfaces, until cancelled."""
    while True:
        for surface in context.registry:
            note_model(context, surface)
        await asyncio.sleep(LOOK_S)


def note_model(context: Context, surface: Surface) -> None:
    """Note the model that a surface answers with."""
    identity = surface.model.identity if surface.model else None

    def make() -> Entry:
        return make_entry(Action.MODEL, {"model": identity}, surface=surface.name)

    context.recorder.trail.note_state(Action.MODEL, surface.name, "", identity, context.clock(), make)
