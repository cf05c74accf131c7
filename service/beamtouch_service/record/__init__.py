"""The record: events from every sample, once and in order, stored with the cursor of each boot. Its only door.

recorder   the record of a service: what it takes in, and when that becomes durable
fields     the fields of an event, from which outputs and documents are made
events/    samples to events, best samples and health: pure
writing/   the one writer: a thread with a connection of its own; what is deleted
reading/   two readers, each a thread with a connection of its own; queries
trail/     who changed what and when
database/  tables, and connections to SQLite or PostgreSQL
forecast   for how long events are kept
"""

from beamtouch_service.record.database.errors import RecordAwayError, RecordUnusableError, UnreadableRowError
from beamtouch_service.record.database.rows import Rows
from beamtouch_service.record.database.snapshot import copy_record
from beamtouch_service.record.database.tables import ROW_NUMBER, TABLES
from beamtouch_service.record.events.event import Begin, End, Event, EventKind, Numbered
from beamtouch_service.record.fields import (
    EventAnswer,
    EventWithPath,
    PlateEvent,
    PlateEventWithPath,
    encode_event,
    event_fields_of,
    members_of_event,
)
from beamtouch_service.record.forecast import describe_kept_days
from beamtouch_service.record.reading.queries import (
    EventKey,
    find_axes,
    find_best_samples,
    find_events,
    get_recorded_event,
    read_best_samples,
    read_events,
)
from beamtouch_service.record.reading.readers import MAX_ANSWERS, Reader, TooManyReadersError
from beamtouch_service.record.reading.trail import Chain, Damaged, check_chain, find_entries
from beamtouch_service.record.recorder import Recorder
from beamtouch_service.record.trail.entry import Action, Entry, encode_details
from beamtouch_service.record.trail.table import Added, add_entries, log_added
from beamtouch_service.record.writing.transactions import Due, Transactions

__all__ = [
    "MAX_ANSWERS", "ROW_NUMBER", "TABLES", "Action", "Added", "Begin", "Chain", "Damaged", "Due", "End", "Entry",
    "Event", "EventAnswer", "EventKey", "EventKind", "EventWithPath", "Numbered", "PlateEvent", "PlateEventWithPath",
    "Reader", "RecordAwayError", "RecordUnusableError", "Recorder", "Rows", "TooManyReadersError", "Transactions",
    "UnreadableRowError", "add_entries", "check_chain", "copy_record", "describe_kept_days", "encode_details",
    "encode_event", "event_fields_of", "find_axes", "find_best_samples", "find_entries", "find_events",
    "get_recorded_event", "log_added", "members_of_event", "read_best_samples", "read_events",
]  # fmt: skip
