"""Configurations of the daemon as text, as a user writes them."""

import json
from pathlib import Path

TOKEN = "swordfish-of-the-tests-and-longer"  # noqa: S105
PUBLISH = """
[publish]
url = "http://127.0.0.1:8420"
token_file = "beamtouch.token"
batch_ms = 20
"""


def tcp(port: int, host: str = "127.0.0.1") -> str:
    """Return a source that waits for an answer as long as a starved machine takes for it."""
    return f'kind = "modbus-tcp"\nhost = "{host}"\nport = {port}\ntimeout_ms = 30_000'


def rtu(path: str) -> str:
    return f'kind = "modbus-rtu"\nport = "{path}"'


def serial(path: str) -> str:
    return f'kind = "serial"\nport = "{path}"'


def surface(
    name: str = "bench", source: str = tcp(502), rate_hz: float = 200.0, registers: tuple[int, ...] = (0, 1)
) -> str:
    """Return the tables of one surface; counts of 20000 stand for a gap of 2.5 mm, which is the gap at rest."""
    channels = "".join(
        f"""
[[surfaces.{name}.channels]]
name = "s{index + 1}"
register = {register}
gain_mm_per_count = -0.0001
offset_mm = 4.5
rest_gap_mm = 2.5
range_mm = [1.0, 4.0]
"""
        for index, register in enumerate(registers)
    )
    return f"""
[surfaces.{name}]
rate_hz = {rate_hz}
[surfaces.{name}.source]
{source}
[surfaces.{name}.filter]
kind = "moving-average"
window = 1
{channels}"""


def tare(folder: Path, name: str = "bench", taken_at: str = "2026-11-20T23:40:46+00:00") -> None:
    """Write the tare file of a surface: 2.5 mm at rest."""
    gaps = {
        "surface": name,
        "taken_at": taken_at,
        "readings": 200,
        "rest_gap_mm": {"s1": 2.5, "s2": 2.5},
    }
    (folder / f"{name}.tare.json").write_text(json.dumps(gaps))


def write(folder: Path, *surfaces: str, url: str = "http://127.0.0.1:8420") -> Path:
    """Write a configuration with its token beside it."""
    (folder / "beamtouch.token").write_text(f"{TOKEN}\n")
    path = folder / "daemon.toml"
    path.write_text(PUBLISH.replace("http://127.0.0.1:8420", url) + "".join(surfaces))
    return path
