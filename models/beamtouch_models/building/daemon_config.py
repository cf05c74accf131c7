"""The daemon's configuration for a model, ready to run against the rig. The daemon owns and checks the format."""

import json
import secrets
from pathlib import Path

from beamtouch_common.files import write_atomically
from beamtouch_models.metadata import FilterChoice, Metadata
from beamtouch_models.surface import Surface

TOKEN_FILE = "beamtouch.token"  # noqa: S105  # the name of a file, not a secret
RIG_PORT = 5020
SERVICE_URL = "http://127.0.0.1:8420"


def daemon_config(metadata: Metadata) -> str:
    """Return the TOML text of a configuration with one surface, with the model's name and characteristic."""
    return "\n".join(
        [
            _head(metadata),
            _filter(metadata),
            _loads(metadata),
            *(_channel(metadata, i) for i in range(len(metadata.layout))),
        ]
    )


def write_token_if_absent(folder: Path) -> Path:
    """Write a random token that only its owner may read, unless the file exists; returns its path."""
    path = folder / TOKEN_FILE
    if not path.exists():
        write_atomically(path, f"{secrets.token_urlsafe(32)}\n".encode(), mode=0o600)
    return path


def _head(metadata: Metadata) -> str:
    name, surface = json.dumps(metadata.name), Surface.of_model(metadata)
    return f"""\
# Acquisition of the surface {name}. Check this file with `beamtouch-daemon check`.

[publish]
url = "{SERVICE_URL}"
token_file = "{TOKEN_FILE}"        # the file that `beamtouch-service run --write-token-file` uses

[surfaces.{name}]
{f"beam = {json.dumps(metadata.beam)}":<38}# beam and layout; a model of another beam gets no samples
rate_hz = {metadata.sensor.rate_hz!r}
{_noise(metadata)}{_drift(surface)}{_period(surface)}
[surfaces.{name}.source]
kind = "modbus-tcp"                   # the rig: beamtouch-rig ... --modbus-tcp 127.0.0.1:{RIG_PORT}
host = "127.0.0.1"
port = {RIG_PORT}
unit = 1
# kind = "modbus-rtu"                 # or a serial bus:
# port = "/dev/ttyUSB0"
# baud = 115200
# unit = 1
# kind = "serial"                     # or a device that implements PROTOCOL.md:
# port = "/dev/ttyACM0"
# baud = 1000000
"""


def _noise(metadata: Metadata) -> str:
    """Return the line with the noise of a reading; empty if the scene has no noise: the daemon then estimates it."""
    if metadata.noise.reading_mm == 0:
        return ""
    return (
        f"{f'noise_mm = {metadata.noise.reading_mm!r}':<38}# of a reading; `tare` refuses a surface that moves more,\n"
        "                                      # and a channel whose counts repeat for too long counts as stuck\n"
    )


def _drift(surface: Surface) -> str:
    """Return the line with the drift of a rest gap since the last tare; empty if the scene has none."""
    drift_mm = surface.readings.drift_mm
    return f"{f'zero_drift_mm = {drift_mm:.3g}':<38}# of a rest gap since the last tare\n" if drift_mm else ""


def _period(surface: Surface) -> str:
    """Return the line with the slowest period; empty if the scene does not state the beam's mass."""
    period_ms = surface.slowest_period_ms
    if period_ms is None:
        return ""
    return (
        f"{f'slowest_period_ms = {period_ms:.4g}':<38}# of the beam with a weight on it; readings that differ\n"
        "                                      # within it show that the beam moves\n"
    )


def _filter(metadata: Metadata) -> str:
    chosen: FilterChoice = metadata.filter
    lines = [
        f"[surfaces.{json.dumps(metadata.name)}.filter]    # the model was made for this filter",
        f'kind = "{chosen.kind}"',
    ]
    if chosen.kind != "none":
        lines.append(f"window = {chosen.window}")
    if chosen.kind == "growing-mean":
        lines.append(f"max_mean_ms = {chosen.max_readings * 1e3 / metadata.sensor.rate_hz!r}")
    if chosen.spike_mm is not None:
        lines.append(f"spike_mm = {chosen.spike_mm!r}")
    return "\n".join(lines) + "\n"


def _loads(metadata: Metadata) -> str:
    """Return the limits of the known loads that `record` accepts."""
    return f"""\
[surfaces.{json.dumps(metadata.name)}.loads]     # known loads that `record` accepts: the ranges of the model
position_mm = [{metadata.ranges.position_mm[0]!r}, {metadata.ranges.position_mm[1]!r}]
max_force_n = {metadata.ranges.force_n[1]!r}
"""


def _channel(metadata: Metadata, index: int) -> str:
    sensor, channel = metadata.sensor, metadata.layout[index]
    most = max(abs(row[index]) for row in metadata.influence.mm_per_n)
    smallest_mm = metadata.ranges.force_n[0] * most
    smallest = (
        f"{f'smallest_force_mm = {smallest_mm:.4g}':<38}# deflection here under {metadata.ranges.force_n[0]:g} N\n"
    )
    return f"""\
[[surfaces.{json.dumps(metadata.name)}.channels]]
{f"name = {json.dumps(channel.name)}":<38}# mounted {channel.position_mm:g} mm from the left end
register = {index}
gain_mm_per_count = {sensor.gain_mm_per_count!r}
offset_mm = {sensor.offset_mm!r}
rest_gap_mm = {sensor.standoff_mm!r}
{smallest if smallest_mm else ""}range_mm = [{sensor.range_mm[0]!r}, {sensor.range_mm[1]!r}]
adc_bits = {sensor.adc_bits}
"""
