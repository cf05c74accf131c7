"""Sentences of the pages that state a setting or a limit have the figure that the code has."""

import math
from typing import Any

import pytest

import facts
from beamtouch_common.zones import BEGIN, HOLD, MAX_ZONES
from beamtouch_daemon.delivery.log import MAX_BATCH
from beamtouch_daemon.processing import at_rest
from beamtouch_models.calibration import recordings
from beamtouch_models.decision import decider, evidence, wrong_channels
from beamtouch_models.modelfile import State
from beamtouch_models.physics.beam import MAX_SLOPE
from beamtouch_models.reproduction.figure_8 import MEASURED_PERCENT as PAPER
from beamtouch_protocol.framing import MAX_FRAME_BYTES
from beamtouch_protocol.messages import MESSAGE_TYPES
from beamtouch_service.api.samples import MAX_BODY_BYTES, MAX_BODY_S
from beamtouch_service.commissioning import course, pressing, verdict
from beamtouch_service.commissioning.record import MAX_KEPT
from beamtouch_service.events.boot import MAX_CAPTURED, MAX_WAITING
from beamtouch_service.host.serve import IDLE_S
from beamtouch_service.outputs.modbus.registers import BLOCK, CONSTANT, MAX_SURFACES, STATES
from beamtouch_service.problems import Kind
from beamtouch_service.samples import MAX_SAMPLES, Note
from beamtouch_service.sections import ServerSection, SurfaceSection
from pasted import ROOT

WORDS: dict[float, str] = {1: "a", 3: "three", 4: "four", 5: "five", 10: "ten"}
PARTS = {0.1: "a tenth", 0.02: "a fiftieth", 0.125: "an eighth", 0.4: "two fifths"}
DOUBTFUL = sum(1 << note.bit for note in (Note.OVERLOAD, Note.UNSTEADY, Note.UNCHECKED, Note.SENDERS))
PROBLEMS = min(code for state, (code, _) in STATES.items() if isinstance(state, Kind))
RECEIVED_BYTES = 7 + max(message.max_payload_bytes() for kind, message in MESSAGE_TYPES.items() if kind < 0x80)
"""The longest frame that a device receives: a payload, with type, CRC, one byte of COBS and 00."""


def code(state: State | Kind) -> int:
    """Return the code of a state in the Modbus registers."""
    return STATES[state][0]


def bounds(path: str, name: str) -> dict[str, Any]:
    """Return the schema of a query parameter of a route, with its bounds and its default."""
    (parameter,) = [one for one in facts.openapi()["paths"][path]["get"]["parameters"] if one["name"] == name]
    schema: dict[str, Any] = parameter["schema"]
    return schema


def cells(per_second: float, fixed: int, per_channel: int) -> str:
    """Return rates for 1, 2, 4 and 8 channels as cells of a table: what a second holds, over what a reading takes."""
    return " | ".join(str(int(per_second / (fixed + per_channel * channels))) for channels in (1, 2, 4, 8))


def share(times: float) -> float:
    """Return the percentage that an interval of so many times the 95 % one holds."""
    return 100 * math.erf(times * 1.96 / math.sqrt(2))


STREAM = bounds("/stream", "interval_ms")
DATA = bounds("/surfaces/{name}/calibration-data", "limit")
SURFACE, SERVER = (
    {name: field.default for name, field in section.model_fields.items()} for section in (SurfaceSection, ServerSection)
)

STATED = {
    "docs/explanation/paper.md": [
        f"two sensors: {PAPER[2, 'equal']} % at equal pitch, {PAPER[2, 'optimised']} % optimised;",
        f"with five: {PAPER[5, 'equal']} and {PAPER[5, 'optimised']} %.",
    ],
    "docs/explanation/readings-to-samples.md": [
        f"more than {PARTS[at_rest.LOAD_SHARE]} of `smallest_force_mm`",
        f"{WORDS[at_rest.STATED_DEVIATIONS].capitalize()} times `zero_drift_mm` is always allowed",
        f"by {PARTS[at_rest.MOUNTED_WITHIN]} of the sensor's range",
        f"each later one by {PARTS[at_rest.DRIFTS_WITHIN]}",
    ],
    "docs/how-to/calibrate.md": [
        f"with {WORDS[recordings.MIN_SAMPLES]} rows or more for each load",
        f"Loads may stand about {WORDS[recordings.STATED.placing_mm]} millimetre off",
        f"by about {WORDS[100 * recordings.STATED.force]} percent (standard deviations)",
    ],
    "docs/how-to/commission-on-the-page.md": [
        f"Press at the {WORDS[course.PLACES]} marks",
        f"elsewhere for {WORDS[pressing.SETTLED_US // 1_000_000]} seconds",
        f"an error passes up to {verdict.PRESS_MM:g} mm",
        f"keeps the last {MAX_KEPT} results",
    ],
    "docs/how-to/commissioning.md": [
        f"within {PARTS[at_rest.MOUNTED_WITHIN]} of the sensor's range",
        f"at bit {Note.DEGRADED.bit} of `notes` and at every `state` from {PROBLEMS} on",
    ],
    "docs/how-to/design.md": [
        f"slopes by more than {MAX_SLOPE:g} rad",
        f"`damping_ratio` is {math.log(2) / (2 * math.pi):.2f} over this number",
    ],
    "docs/how-to/plc.md": [
        f"Bit {Note.DEGRADED.bit} of `notes`, `degraded`",
        f"from `state` {PROBLEMS} on",
        f"reads offsets 0 to {BLOCK - 2}",
    ],
    "docs/how-to/troubleshooting.md": [
        f"`state` {code(Kind.STALE)} (`no-samples`: {code(Kind.NO_SAMPLES)})",
        f"| register | `state` {code(Kind.OTHER_BEAM)} |",
        f"| register | `state` {code(State.UNEXPLAINED)}; the bit of the channel in `check` |",
        f"| register | bit {Note.DEGRADED.bit} of `notes`;",
        f"| register | bit {Note.SENDERS.bit} of `notes` |",
        f"`beamtouch_unexplained` is 1 after {SURFACE['unexplained_after_s']:g} s",
        f"the limit is {SURFACE['stale_ms']:g} ms.",
        f"After {WORDS[wrong_channels.CONTACTS]} contacts at different places "
        f"({WORDS[wrong_channels.OF_FEW]} with three sensors)",
    ],
    "docs/how-to/two-hosts.md": [f"reach port {SERVER['port']}"],
    "docs/how-to/zones.md": [
        f"at most {MAX_ZONES} zones",
        f"{share(BEGIN):.1f} % to begin an answer and {share(HOLD):.0f} % to keep it",
    ],
    "docs/explanation/what-it-can-know.md": [f"`check-NAME` needs {WORDS[evidence.CHECKED + 1]} working channels"],
    "docs/reference/contact.md": [
        f"until {WORDS[decider.REST]} still samples in a row",
        f"a touch needs {WORDS[decider.CLEARLY]} times the log odds, or {WORDS[decider.PERSISTENCE]} samples in a row",
        f"the log odds fall to {PARTS[decider.LIFT_FRACTION]} of the threshold",
    ],
    "docs/reference/events.md": [f"holds the first {WORDS[MAX_CAPTURED]} unexplained samples"],
    "docs/reference/http.md": [
        f"every `interval_ms` ({STREAM['minimum']} to {STREAM['maximum']}; default {STREAM['default']})",
        f"| a batch | {MAX_BODY_BYTES >> 20} MiB |",
        f"| samples in a batch | {MAX_SAMPLES}; the daemon sends at most {MAX_BATCH} |",
        f"| time for a batch to arrive | {MAX_BODY_S:g} s |",
        f"| time without a request, after an answer | {IDLE_S} s |",
        f"`max_streams`, {SERVER['max_streams']} |",
        f"| samples of a boot that are not durable yet | {MAX_WAITING:,} |".replace(",", " "),
    ],
    "docs/reference/loads.md": [
        f"at least {WORDS[recordings.MIN_SAMPLES]} good samples",
        f"at least {WORDS[recordings.MIN_POSITIONS]} different positions",
        f"over at least {PARTS[recordings.MIN_SPREAD]} of the range",
        f"(the newest {DATA['default']}; at most {DATA['maximum']})",
        f"uses the newest {recordings.MAX_CONTACTS} contacts",
    ],
    "docs/reference/registers.md": [
        f"addresses 0 to {BLOCK - 1}, the second {BLOCK} to {2 * BLOCK - 1}",
        f"| surfaces | {MAX_SURFACES} |",
        f"The last value is {CONSTANT} if the word order is right",
        f"doubtful := (w[3] AND 16#{DOUBTFUL:04X})",
        f"`no-samples`, and {code(Kind.STALE)}, `stale`",
        f"All other states from {PROBLEMS} on",
    ],
    "firmware_protocol/README.md": [
        f"the longest frame, {MAX_FRAME_BYTES} bytes",
        f"receives no frame longer than {RECEIVED_BYTES} bytes, so define `BEAMTOUCH_MAX_FRAME_BYTES={RECEIVED_BYTES}`",
        f"| limit of the ADC, with `oversampling` 1 | {cells(1e6, 40, 32)} |",
        f"| limit of the line | {cells(1e5, 14, 2)} |",
        f"| `max_rate_hz`, without lost readings | {cells(0.9e5, 14, 2)} |",
    ],
}
"""Sentences with their figures from the code, by page."""


@pytest.mark.parametrize("page", STATED)
def test_a_page_states_the_settings_and_limits_of_the_code(page: str) -> None:
    text = " ".join((ROOT / page).read_text().split())

    assert [sentence for sentence in STATED[page] if sentence not in text] == []
