"""Sentences of the pages that state a setting or a limit have the figure that the code has."""

import math
import re
import struct
import tomllib
from typing import Any

import pytest

import facts
from beamtouch_common import commands, parts, waits
from beamtouch_common.zones import BEGIN, HOLD, MAX_ZONES
from beamtouch_daemon.delivery.log_store import MEMORY_S
from beamtouch_daemon.delivery.pace import MAX_BATCH
from beamtouch_daemon.measuring import noise, tares
from beamtouch_daemon.processing import rate
from beamtouch_daemon.running.acquisition import PATIENCE_S
from beamtouch_daemon.sources import board, rtu_bus, rtu_unit, traffic
from beamtouch_models import read_scene
from beamtouch_models.design.accuracy import thresholds
from beamtouch_models.design.calibration import doubts, recordings
from beamtouch_models.design.physics.beam import MAX_SLOPE
from beamtouch_models.design.physics.motion import DAMPING_RATIO
from beamtouch_models.design.pricing import effect
from beamtouch_models.design.scene import measured_loads
from beamtouch_models.filters import rest, zeros
from beamtouch_models.filters.change_detector import DRIFT_PART, STILL_PART
from beamtouch_models.filters.motion import SCATTER_PART
from beamtouch_models.lab.challenge import challenge, contacts, drift
from beamtouch_models.lab.reproduction.figure_8 import MEASURED_PERCENT as PAPER
from beamtouch_models.lab.reproduction.figures import EXPECTED_ITERATIONS, EXPECTED_MM, figure_4
from beamtouch_models.lab.reproduction.paper import NOISE_PERCENT, SOURCE, TITLE
from beamtouch_models.lab.rig.loads import default_script
from beamtouch_models.runtime import State
from beamtouch_models.runtime.decision import decider, wrong_channels
from beamtouch_models.runtime.health import changes
from beamtouch_models.runtime.metadata import fewest_that_check
from beamtouch_protocol.framing import MAX_FRAME_BYTES
from beamtouch_protocol.messages import MESSAGE_TYPES
from beamtouch_service.api.errors import MAX_ERRORS
from beamtouch_service.api.samples import MAX_BODY_BYTES, MAX_BODY_S
from beamtouch_service.commissioning import pressing, run, verdict, wiring
from beamtouch_service.commissioning.results import MAX_KEPT
from beamtouch_service.host.serve import IDLE_S
from beamtouch_service.outputs.modbus.registers import BLOCK, CONSTANT, MAX_SURFACES, REGISTERS, STATES, identity
from beamtouch_service.outputs.mqtt import statuses
from beamtouch_service.outputs.opcua import door, space
from beamtouch_service.problems import Kind
from beamtouch_service.record import forecast, recorder
from beamtouch_service.record.database.connections import READERS
from beamtouch_service.record.database.write_ahead import MAX_BYTES, WARN_BYTES
from beamtouch_service.record.events.boot_record import MAX_CAPTURED, MAX_WAITING
from beamtouch_service.record.events.load import MAX_STAYS
from beamtouch_service.record.reading import readers
from beamtouch_service.record.reading.readers import MAX_ANSWERS
from beamtouch_service.record.trail import pending
from beamtouch_service.samples import MAX_SAMPLES, Note
from beamtouch_service.sections import EventsSection, ServerSection, SurfaceSection
from beamtouch_service.surfaces import comparison
from beamtouch_service.surfaces.follower import PAUSE
from beamtouch_service.surfaces.freshness import WINDOW_S
from support.pages.pasted import ROOT, blocks_of

WORDS: dict[float, str] = {1: "a", 2: "two", 3: "three", 4: "four", 5: "five", 10: "ten"}
TIMES = {2.0: "twice"}
OFTEN_S = {1.0: "Once a second"}
HOURS = {1.0: "an hour"}
MANY = {100: "a hundred"}
PARTS = {0.1: "a tenth", 0.02: "a fiftieth", 0.125: "an eighth", 0.25: "a quarter", 0.4: "two fifths", 0.5: "half"}
DOUBTFUL = sum(1 << note.bit for note in (Note.OVERLOAD, Note.UNSTEADY, Note.UNCHECKED, Note.SENDERS))
PROBLEMS = min(code for state, (code, _) in STATES.items() if isinstance(state, Kind))


def is_a_third(part: float) -> bool:
    return math.isclose(part, 1 / 3, rel_tol=0.02)


RECEIVED_BYTES = 7 + max(message.max_payload_bytes() for kind, message in MESSAGE_TYPES.items() if kind < 0x80)
"""The longest frame that a device receives: a payload, with type, CRC, one byte of COBS and 00."""
PYTHON = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["requires-python"].removeprefix(">=")
FIGURE_4 = figure_4(0).results()
README_SCENE = next(block.text for block in blocks_of("README.md") if "[beam]" in block.text)
TOUCH = default_script(read_scene(README_SCENE.split("END'\n")[1].split("END")[0])).step[3]
"""The load of the rig's own script that rests before the first lift."""
PAIRS_MM = [f"{left}/{right}" for left, right in zip(EXPECTED_MM[::2], EXPECTED_MM[1::2], strict=True)]
BENCH = read_scene(ROOT / "models" / "scenes" / "bench.toml")
(CHECKS,) = {int(fall) for fall in re.findall(r" fall (\d+) ", (ROOT / "deploy" / "haproxy.cfg").read_text())}
OFTEN = {1: "one false stretch of `unexplained` in a day", 0.5: "one in two days"}
"""How often a day, in words."""
ZONES = next(register.offset for register in REGISTERS if register.name == "zones")
LAST = ZONES + MAX_ZONES
"""Last register of the zones."""
CONVERSION_US, OVERHEAD_US = (
    int(re.findall(rf"#define {name} (\d+)", (ROOT / "firmware_protocol" / "avr" / "config.h").read_text())[0])
    for name in ("CONVERSION_US", "SCAN_OVERHEAD_US")
)


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


def in_the_wrong_word_order(value: float) -> float:
    """Return a float32 whose two registers are swapped."""
    first, second = struct.unpack(">HH", struct.pack(">f", value))
    (swapped,) = struct.unpack(">f", struct.pack(">HH", second, first))
    return float(swapped)


STREAM = bounds("/stream", "interval_ms")
DATA = bounds("/surfaces/{name}/calibration-data", "limit")
SURFACE, SERVER, EVENTS = (
    {name: field.default for name, field in section.model_fields.items()}
    for section in (SurfaceSection, ServerSection, EventsSection)
)

STATED = {
    "CITATION.cff": [TITLE],
    "README.md": [
        TITLE,
        SOURCE,
        f"Linux and Python {PYTHON} or later",
        f"pressed with {TOUCH.force_n:g} N at {TOUCH.position_mm:g} mm",
    ],
    "daemon/beamtouch-daemon.service": [f"when a surface has hung for {PATIENCE_S:g} s"],
    "daemon/daemon.example.toml": [
        f"keeps such samples on disk after {MEMORY_S:g} s",
        f"differs by more than {PARTS[rate.TOLERANCE]}",
        f"tare allows {WORDS[tares.STATED_DEVIATIONS]} times",
        f"is asked again after {rtu_bus.REST_TIMEOUTS:g} timeouts",
        f"after {rtu_unit.FORGOTTEN_S:g} s or {rtu_unit.FORGOTTEN_TIMEOUTS} timeouts",
        f"What changes more than {TIMES[zeros.SPEED]} as fast is a load",
        f"gap that differs by {PARTS[tares.LOAD_SHARE]} of it.",
        f"Default: by {PARTS[tares.MOUNTED_WITHIN]} of range_mm",
        f"or {PARTS[tares.DRIFTS_WITHIN]} from the last tare",
    ],
    "deploy/README.md": [f"After {WORDS[CHECKS]} checks without an answer"],
    "deploy/haproxy-one.cfg": [f"The service waits {MAX_BODY_S:g} s for a body"],
    "deploy/haproxy.cfg": [f"a service waits {MAX_BODY_S:g} s for it"],
    "docs/challenge.md": [
        f"Contacts of {WORDS[drift.HELD_S]} seconds, or of {drift.MOST_READINGS} readings",
        f"at up to {TIMES[drift.FASTEST]} the standard deviation",
        f"{1e3 * contacts.RINGING_S:g} ms after a sudden force, and while the load keeps moving at "
        f"{contacts.LOST_MM_PER_S:g} mm/s",
        f"Readings {', '.join(map(str, contacts.AFTER[:-1]))} and {contacts.AFTER[-1]} after it are judged",
        f"at most {100 * challenge.MISLEADING:g} % of the samples mislead",
        f"in {100 * challenge.HELD:g} % of the contacts without a note",
        f"and in {100 * challenge.HELD_UNSTEADY:g} % of those with `unsteady`",
        f"begins twice in at most {100 * challenge.GHOSTS:g} % of the plays",
        f"at most {100 * challenge.NOTED:g} % of settled contacts carry a note",
        f"at least {challenge.NOTICED:g} of the power",
        f"by more than chance explains ({100 * challenge.CHANCE:g} %)",
    ],
    "docs/decisions/002-freshness.md": [f"above the least of the last {WINDOW_S:g} to {2 * WINDOW_S:g} s"],
    "docs/decisions/007-events.md": [f"longer than {WORDS[PAUSE]} times `stale_ms`"],
    "docs/decisions/012-covariance.md": [
        f"more recent than {PARTS[STILL_PART]} of the slowest period",
        f"over {PARTS[SCATTER_PART]} of the slowest period",
    ],
    "docs/decisions/015-health.md": [
        f"at least {WORDS[changes.MIN_CONTACTS]} contacts",
        f"beyond {WORDS[changes.DRIFT]} times the stated drift",
    ],
    "docs/decisions/017-mean-since-touch.md": [
        f"only {PARTS[1 / DRIFT_PART]} of them",
        f"until {PARTS[STILL_PART]} of the slowest period agrees",
    ],
    "docs/decisions/018-when-a-state-begins-and-ends.md": [
        f"begins and ends with {WORDS[decider.PERSISTENCE]} samples in a row"
    ],
    "docs/decisions/031-samples-at-rest.md": [f"further from the mean than {WORDS[rest.EXPLAINED]} deviations"],
    "docs/decisions/032-zones.md": [
        f"the interval at {share(BEGIN):.1f} % lies on one side, and ends if that at {share(HOLD):.0f} % does not"
    ],
    "docs/decisions/033-commissioning.md": [
        f"one cable in {MANY[round(math.exp(wiring.FAULT / 2))]} is taken to be wrong",
        f"not {MANY[round(math.exp(wiring.FAULT / 2))]} times as likely as the next one",
    ],
    "docs/explanation/index.md": [f"while their prices sum to less than {PARTS[effect.NEGLIGIBLE]}"],
    "docs/explanation/paper.md": [
        TITLE,
        SOURCE,
        f"with B near {FIGURE_4['B'][0]:.0f}",
        f"At {NOISE_PERCENT:g} % noise only {WORDS[FIGURE_4['larger'][0]]} components are larger than their error",
        f"up to {'a third' if is_a_third(FIGURE_4['four_up_to_percent'] / NOISE_PERCENT) else '?'} of that noise",
        f"reverse order: {', '.join(f'{400 / (n + 1):.0f}' for n in (2, 3, 4))} and {400 / 6:.0f} mm belong",
        f"on a simulated rig with {NOISE_PERCENT:g} % noise",
        f"With {NOISE_PERCENT:g} % noise the paper's network errs more",
        f"after about {EXPECTED_ITERATIONS} iterations",
        f"are near {', '.join(PAIRS_MM[:3])} and {PAIRS_MM[3]} mm",
        f"two sensors: {PAPER[2, 'equal']} % at equal pitch, {PAPER[2, 'optimised']} % optimised;",
        f"with five: {PAPER[5, 'equal']} and {PAPER[5, 'optimised']} %.",
    ],
    "docs/explanation/readings-to-samples.md": [
        f"in blocks of {PARTS[zeros.BLOCK_S]} of a second",
        f"more than {PARTS[tares.LOAD_SHARE]} of `smallest_force_mm`",
        f"{WORDS[tares.STATED_DEVIATIONS].capitalize()} times `zero_drift_mm` is always allowed",
        f"by {PARTS[tares.MOUNTED_WITHIN]} of the sensor's range",
        f"each later one by {PARTS[tares.DRIFTS_WITHIN]}",
    ],
    "docs/explanation/speed-or-accuracy.md": [f"agree for {PARTS[STILL_PART]} of the beam's slowest period"],
    "docs/how-to/calibrate-without-loads.md": [f"With the {BENCH.sensors.gain_error_percent:g} % of `bench.toml`"],
    "docs/how-to/calibrate.md": [
        f"at least {WORDS[round(math.exp(doubts.PERHAPS))]} times as probable as no such mistake, "
        f"but less than {round(math.exp(doubts.SURELY), -1):.0f} times",
        f"with {WORDS[recordings.MIN_SAMPLES]} rows or more for each load",
        f"Loads may stand about {WORDS[recordings.STATED.placing_mm]} millimetre off",
        f"by about {WORDS[100 * recordings.STATED.force]} percent (standard deviations)",
    ],
    "docs/how-to/commission-on-the-page.md": [
        f"Press at the {WORDS[run.PARTS[1][0]]} marks",
        f"elsewhere for {WORDS[pressing.SETTLED_US // 1_000_000]} seconds",
        f"an error passes up to {verdict.PRESS_MM:g} mm",
        f"keeps the last {MAX_KEPT} results",
    ],
    "docs/how-to/commissioning.md": [
        f"within {PARTS[tares.MOUNTED_WITHIN]} of the sensor's range",
        f"at bit {Note.DEGRADED.bit} of `notes` and at every `state` from {PROBLEMS} on",
    ],
    "docs/how-to/design.md": [
        f"slopes by more than {MAX_SLOPE:g} rad",
        f"`damping_ratio` is {math.log(2) / (2 * math.pi):.2f} over this number",
    ],
    "docs/how-to/opcua.md": [
        f"or above {HOURS[door.MAX_INTERVAL_MS / 3.6e6]} is refused",
        f"can hold the {door.MAX_CONNECTIONS} connections, {WORDS[door.ACTIVATION_S]} seconds each",
        f"shows within {WORDS[space.LOOK_S]} second and an interval",
        f"at most {door.MAX_WAITING} values of a variable",
        f"{door.MAX_CONNECTIONS} connections, {door.MAX_SUBSCRIPTIONS} subscriptions and {door.MAX_ITEMS} subscribed",
        f"at most {door.MAX_OPERATIONS} nodes in a request, {door.MAX_BROWSED} to browse, "
        f"or 20 paths of {door.MAX_ELEMENTS} elements in all",
        f"messages of {door.MAX_MESSAGE_BYTES >> 20} MiB",
        f"more than {door.MAX_PENDING} requests wait",
        f"after at most {door.MAX_KEEP_ALIVE} publishing intervals",
        f"asks for nothing for {door.MAX_LIFETIME}",
        f"publishing interval below {door.MIN_INTERVAL_MS:g} ms",
    ],
    "docs/how-to/plc.md": [
        f"identity {identity('strip')}, heartbeat",
        f"Bit {Note.DEGRADED.bit} of `notes`, `degraded`",
        f"from `state` {PROBLEMS} on",
        f"reads offsets 0 to {LAST}",
    ],
    "docs/how-to/rollout.md": [
        f"null before {comparison.ENOUGH_SAMPLES} samples, {comparison.ENOUGH_TOUCHED} of which at least one",
    ],
    "docs/how-to/troubleshooting.md": [
        f"`state` {code(Kind.STALE)} (`no-samples`: {code(Kind.NO_SAMPLES)})",
        f"| register | `state` {code(Kind.OTHER_BEAM)} |",
        f"| register | `state` {code(State.UNEXPLAINED)}; the bit of the channel in `check` |",
        f"| register | bit {Note.DEGRADED.bit} of `notes`;",
        f"| register | bit {Note.SENDERS.bit} of `notes` |",
        f"`beamtouch_unexplained` is 1 after {SURFACE['unexplained_after_s']:g} s",
        f"after {SURFACE['unexplained_after_s']:g} s: `neither rest nor a single contact explains",
        f"the limit is {SURFACE['stale_ms']:g} ms.",
        f"After {WORDS[wrong_channels.CONTACTS]} contacts at different places "
        f"({WORDS[wrong_channels.OF_FEW]} with three sensors)",
    ],
    "docs/how-to/two-hosts.md": [f"reach port {SERVER['port']}"],
    "docs/how-to/zones.md": [
        f"at most {MAX_ZONES} zones",
        f"{share(BEGIN):.1f} % to begin an answer and {share(HOLD):.0f} % to keep it",
    ],
    "docs/explanation/what-it-can-know.md": [
        f"`check-NAME` needs {WORDS[fewest_that_check(1) + 1]} working channels",
        f"allow {OFTEN[thresholds.PER_DAY]} of rest, and {OFTEN[thresholds.PER_DAY_OF_CONTACT]} of good contacts",
    ],
    "docs/reference/contact.md": [
        f"`check-NAME` needs {WORDS[fewest_that_check(1) + 1]} working channels: without the named one, "
        f"{WORDS[fewest_that_check(1)]} must be left",
        f"On a plate it needs {WORDS[fewest_that_check(2) + 1]}",
        f"may be seen {WORDS[decider.PERSISTENCE - 1]} samples late",
        f"because they are so uncertain, take {WORDS[decider.PERSISTENCE]} in a row",
        f"**`unexplained` begins** after {WORDS[decider.PERSISTENCE]} samples in a row",
        f"**and ends** after {WORDS[decider.PERSISTENCE]} that one of them explains",
        f"until {WORDS[decider.REST]} still samples in a row",
        f"a touch needs {WORDS[decider.CLEARLY]} times the log odds, or {WORDS[decider.PERSISTENCE]} samples in a row",
        f"the log odds fall to {PARTS[decider.LIFT_FRACTION]} of the threshold",
    ],
    "docs/reference/events.md": [
        f"takes some {forecast.EVENT_BYTES} bytes",
        f"holds one each {forecast.EVERY_S:g} s for {EVENTS['keep_days']:g} days",
        f"add `path`, at most {MAX_STAYS} points",
        f"gave no reading for longer than {WORDS[PAUSE]} times `stale_ms`",
        f"holds the first {WORDS[MAX_CAPTURED]} unexplained samples",
        f"reads for {WORDS[READERS]} clients at a time. Beyond {MAX_ANSWERS} that wait",
        f"Above {WARN_BYTES / 1e6:g} MB the log of the service names",
        f"above {MAX_BYTES / 1e6:g} MB the record waits",
    ],
    "docs/reference/http.md": [
        f"| after {WORDS[readers.SLOT_S]} second, 503 `too-many-clients`",
        f"every `interval_ms` ({STREAM['minimum']} to {STREAM['maximum']}; default {STREAM['default']})",
        f"| a batch | {MAX_BODY_BYTES >> 20} MiB, also decompressed |",
        f"| samples in a batch | {MAX_SAMPLES}; the daemon sends at most {MAX_BATCH}, "
        "and more only over a line with a long delay |",
        f"| time for a batch to arrive | {MAX_BODY_S:g} s |",
        f"| time without a request, after an answer | {IDLE_S} s |",
        f"`max_streams`, {SERVER['max_streams']} |",
        f"| answers from the record under way | {MAX_ANSWERS}, of which {WORDS[READERS]} are being read |",
        f"| the last {MAX_KEPT} results on record",
        f"| samples of a boot that are not durable yet | {MAX_WAITING:,} |".replace(",", " "),
    ],
    "docs/reference/loads.md": [
        f"at least {WORDS[recordings.MIN_SAMPLES]} good samples",
        f"at least {WORDS[recordings.MIN_POSITIONS]} different positions",
        f"over at least {PARTS[recordings.MIN_SPREAD]} of the range",
        f"(the newest {DATA['default']}; at most {DATA['maximum']})",
        f"uses the newest {recordings.MAX_CONTACTS} contacts",
    ],
    "docs/reference/problems.md": [f"`errors` (at most {MAX_ERRORS})"],
    "docs/reference/registers.md": [
        f"addresses 0 to {BLOCK - 1}, the second {BLOCK} to {2 * BLOCK - 1}",
        f"| surfaces | {MAX_SURFACES} |",
        f"The last value is {CONSTANT} if the word order is right",
        f"doubtful := (w[3] AND 16#{DOUBTFUL:04X})",
        f"`no-samples`, and {code(Kind.STALE)}, `stale`",
        f"All other states from {PROBLEMS} on",
        f"so take 16#{DOUBTFUL & ~(1 << Note.UNCHECKED.bit):04X} for `doubtful` there",
        f"Read offsets 0 to {ZONES - 1} in one request, or 0 to {LAST} with zones",
        f"Read offsets 0 to {LAST} of the block into `w : ARRAY[0..{LAST}] OF WORD`",
        f"without zones, 0 to {ZONES - 1}",
        f"the numbers 1 to {MAX_ZONES}",
        f"**Registers {LAST + 1} and {BLOCK - 4} to {BLOCK - 1}** of a block read as 0",
        f"and so do {ZONES} to {LAST} without zones",
        f"w[0] = {identity('press-7')} (* the identity of press-7",
        f"REAL_OF(w[20], w[21]) = {CONSTANT};",
        f"**NaN** is 16#{struct.pack('>f', math.nan).hex().upper()}",
        f"276.5215 becomes {in_the_wrong_word_order(276.5215):.1f}",
    ],
    "docs/reference/rig.md": [f"({100 * DAMPING_RATIO:g} % of critical if it states none)"],
    "docs/reference/sensor-health.md": [f"within {WORDS[changes.DRIFT]} times the drift that the scene states"],
    "docs/reference/trail.md": [f"than are watched ({pending.MOST_STATES}); once an hour"],
    "docs/reference/metrics.md": [
        f"is begun again after {parts.FIRST_PAUSE_S:g} to {parts.LONGEST_PAUSE_S:g} s",
        f"until it has run for {waits.STEADY_S:g} s",
    ],
    "docs/how-to/mqtt.md": [
        f"{OFTEN_S[statuses.LOOK_S]}, the service asks what",
    ],
    "docs/reference/samples.md": [
        f"not made durable, at most {WORDS[recorder.COMMIT_S]} second of samples",
    ],
    "docs/how-to/adc-module.md": [
        f"waits {traffic.BOOT_S:g} s for a board that boots",
    ],
    "docs/how-to/drift.md": [
        f"from {noise.FEWEST_MINUTES} minutes on",
    ],
    "docs/how-to/measured.md": [
        f"{measured_loads.MOST:,} loads at {measured_loads.MOST_PLACES} places".replace(",", " "),
    ],
    "docs/reference/commands.md": [
        f"is {commands.DONE} if the work is done, {commands.FAILED} if it failed, "
        f"{commands.WRONG_INPUT} for wrong input",
        f"and {commands.INTERRUPTED} after Ctrl-C",
    ],
    "firmware_protocol/PROTOCOL.md": [
        f"asks for {traffic.BOOT_S:g} s after the opening, and for {board.HELLO_TIMEOUT_S:g} s later on",
        f"double from {board.REPEAT_S:g} s up to {board.MAX_REPEAT_S:g} s",
        f"if no frame has come for {traffic.SILENT_S:g} s",
        f"every {board.PING_S:g} s, sooner at first",
        f"no reading for {board.SILENCE_S:g} s or {WORDS[board.SILENCE_PERIODS]} periods",
        f"more than {MAX_FRAME_BYTES - 1} bytes before its 00",
        f"no more than {RECEIVED_BYTES} bytes, the longest frame that it is sent",
    ],
    "firmware_protocol/README.md": [
        f"the longest frame, {MAX_FRAME_BYTES} bytes",
        f"receives no frame longer than {RECEIVED_BYTES} bytes, so define `BEAMTOUCH_MAX_FRAME_BYTES={RECEIVED_BYTES}`",
        f"| limit of the ADC, with `oversampling` 1 | {cells(1e6, OVERHEAD_US, CONVERSION_US)} |",
        f"1000000 / ({CONVERSION_US} x channels x oversampling + {OVERHEAD_US})",
        f"`oversampling` is at most {0xFFFF // (2**10 - 1)}, so that sums fit 16 bits",
        f"| limit of the line | {cells(1e5, 14, 2)} |",
        f"| `max_rate_hz`, without lost readings | {cells(0.9e5, 14, 2)} |",
    ],
}
"""Sentences with their figures from the code, by page."""


@pytest.mark.parametrize("page", STATED)
def test_a_page_states_the_settings_and_limits_of_the_code(page: str) -> None:
    text = " ".join(re.sub(r"\n +# ", " ", (ROOT / page).read_text()).split())  # a comment may go on

    assert [sentence for sentence in STATED[page] if sentence not in text] == []
