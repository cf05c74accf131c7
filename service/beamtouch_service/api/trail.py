"""The route of the trail: who changed what and when, and whether its chain holds."""

import json
from collections.abc import Iterator, Sequence
from dataclasses import asdict
from functools import partial
from typing import Annotated, Any, Literal
from urllib.parse import urlencode

from fastapi import Query, Request, Response
from pydantic import BaseModel, ConfigDict, Field

from beamtouch_service.access import Role
from beamtouch_service.api import gate
from beamtouch_service.api.context import ContextParameter
from beamtouch_service.api.csv_parts import MEDIA_TYPE, NEXT_LINK, RESPONSES, CsvParts
from beamtouch_service.api.record_answers import SLOT, answer_in_parts
from beamtouch_service.api.times import Time, microseconds
from beamtouch_service.record import Action, Added, Chain, Damaged, Reader, check_chain, find_entries
from beamtouch_service.samples import SurfaceName
from beamtouch_service.surfaces.contact import rfc3339

router = gate.make_router("audit", Role.ADMIN)


class TrailQuery(BaseModel):
    """Query parameters of the trail."""

    model_config = ConfigDict(extra="forbid")

    surface: SurfaceName | None = Field(None, description="Only entries of this surface.")
    action: Action | None = Field(None, description="Only entries of this kind.")
    since: Time | None = Field(None, description="Only entries at or after this time (RFC 3339).")
    until: Time | None = Field(None, description="Only entries before this time.")
    after: str | None = Field(None, pattern="^[0-9]{1,18}$", description="`next` of the previous page.")
    limit: int = Field(100, ge=1, le=1000, description="Maximum number of entries.")
    format: Literal["json", "csv"] = Field("json", description="JSON, or CSV with a row per entry.")


class TrailEntry(BaseModel):
    """One change."""

    model_config = ConfigDict(use_attribute_docstrings=True)

    number: int
    """Number of the entry. Numbers begin at 1 and have no gaps."""
    at: str
    """When the service noticed it, by its clock (RFC 3339)."""
    action: Action
    """Kind of the change."""
    surface: str | None
    """Surface that it is of; null if it is of none, or of all."""
    subject: str | None
    """What it is of, beside the surface: of a token its name and address, of a start the address of the service, of a
    commissioning its run."""
    by: str
    """The user that a trusted proxy names, or else the name of the token; `service` for what no request asked for."""
    token: str | None
    """Name of the token."""
    address: str | None
    """Address of the client."""
    details: dict[str, Any] | str
    """The rest, by kind. Text if it was changed into something else than an object."""
    digest: str
    """SHA-256 of the entry and of the digest of the entry before."""


class DamagedEntry(BaseModel):
    """An entry whose row in the database is damaged."""

    model_config = ConfigDict(use_attribute_docstrings=True)

    number: int
    """Number of the entry."""
    reason: str
    """Why it cannot be read, with its table and its column."""


class ChainState(BaseModel):
    """Whether each entry follows from the one before."""

    model_config = ConfigDict(use_attribute_docstrings=True)

    holds: bool
    breaks_at: int | None
    """Number of the first entry that does not follow from the one before it: it, or the one before, was changed, or
    taken out. Null if all do."""
    entries: int
    """Number of entries that do."""
    digest: str | None
    """Digest of the last of them; null without one."""


class TrailPage(BaseModel):
    """Entries, newest first."""

    model_config = ConfigDict(use_attribute_docstrings=True)

    entries: list[TrailEntry]
    damaged: list[DamagedEntry]
    """Entries of this page that cannot be read."""
    next: str | None
    """Value of `after` for the next page; null on the last page."""
    chain: ChainState | None
    """Whether the chain of all entries holds; null on pages after the first."""


_COLUMNS = list(TrailEntry.model_fields)


@router.get(
    "/audit",
    response_model=TrailPage,
    responses={200: RESPONSES | {"headers": {"Link": NEXT_LINK}}},
    dependencies=[SLOT],
)
async def get_audit(context: ContextParameter, request: Request, query: Annotated[TrailQuery, Query()]) -> Response:
    """Return who changed what and when, the newest first, and whether the chain holds; as CSV, one row per entry."""
    found = await context.recorder.readers.read(partial(_find, query=query))
    page = found[: query.limit]
    following = str(page[-1].number) if len(found) > len(page) else None
    if query.format == "json":
        give = partial(_as_json, page=page, following=following, is_first=query.after is None)
        return await answer_in_parts(context, give, "application/json")
    address = urlencode({**request.query_params, "after": following})
    headers = {"Link": f'<?{address}>; rel="next"'} if following else {}
    return await answer_in_parts(context, partial(_as_csv, page=page), MEDIA_TYPE, headers)


def _find(reader: Reader, query: TrailQuery) -> list[Added | Damaged]:
    """Return the entries of a page, and one more if there is another page."""
    return find_entries(
        reader,
        surface=query.surface,
        action=query.action,
        since_us=microseconds(query.since),
        until_us=microseconds(query.until),
        before=None if query.after is None else int(query.after),
        limit=query.limit + 1,
    )


def _members_of(added: Added) -> dict[str, Any]:
    """Return the members of an entry, JSON values."""
    entry = added.entry
    return {
        "number": added.number,
        "at": rfc3339(entry.at_us),
        "action": entry.action.value,
        "surface": entry.surface or None,
        "subject": entry.subject or None,
        "by": entry.by,
        "token": entry.token or None,
        "address": entry.address or None,
        "details": _read_details(entry.details),
        "digest": added.digest,
    }


def _read_details(text: str) -> object:
    try:
        details = json.loads(text)
    except ValueError:
        return text
    return details if isinstance(details, dict) else text


def _as_json(
    reader: Reader, page: Sequence[Added | Damaged], *, following: str | None, is_first: bool
) -> Iterator[bytes]:
    """Give a page as JSON; on the first one, check the chain of all entries meanwhile."""
    members = {
        "entries": [_members_of(one) for one in page if isinstance(one, Added)],
        "damaged": [asdict(one) for one in page if isinstance(one, Damaged)],
        "next": following,
    }
    head = json.dumps(members, ensure_ascii=False).removesuffix("}")
    yield f'{head},"chain":'.encode("utf-8", "replace")
    for state in check_chain(reader) if is_first else [None]:
        # White space, so that the client sees that the answer goes on.
        yield b" " if state == "more" else json.dumps(_members_of_chain(state)).encode() + b"}"


def _members_of_chain(state: Chain | None) -> dict[str, object] | None:
    return None if state is None else {one: getattr(state, one) for one in ChainState.model_fields}


def _as_csv(reader: Reader, page: Sequence[Added | Damaged]) -> Iterator[bytes]:
    """Give a page as CSV: one row per entry. Its details are JSON in one cell; of a damaged one, the reason."""
    csv = CsvParts(_COLUMNS)
    for one in page:
        if isinstance(one, Added):
            members = _members_of(one) | {"details": one.entry.details}
        else:
            members = {"number": one.number, "details": one.reason}
        csv.add(members.get(name) for name in _COLUMNS)
        reader.rest()
    yield csv.take()
