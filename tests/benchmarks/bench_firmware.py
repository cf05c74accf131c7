"""The reference firmware on the simulated board, in simulated time: scans per second, and what ADC and line allow."""

import sys
import tempfile
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent.parent))

from beamtouch_protocol.messages import Start
from simulated_board import Board, at, build_board, build_firmware

SECONDS = 10.0
CONVERSION_US, SETUP_US = 32.0, 40.0
"""What a conversion and a scan take: the figures of firmware_protocol/README.md."""


def run() -> list[dict[str, object]]:
    """Run the highest rates of four and eight channels."""
    rows: list[dict[str, object]] = []
    with tempfile.TemporaryDirectory() as made:
        folder = Path(made)
        build_board(folder)
        for channels in (4, 8):
            build_firmware(folder, channels)
            line_hz = 100_000 / (14 + 2 * channels)
            rate_hz = int(0.9 * line_hz)
            board = Board(folder / "board", folder / "firmware.elf")
            seen = board.record(folder, SECONDS + 0.1, at(0.1, Start(rate_hz, 1)))
            rows.append(
                {
                    "name": f"firmware, {channels} channels, highest rate",
                    "value": len(seen.readings) / SECONDS / line_hz,
                    "unit": "scans/s over what the line carries",
                    "scans/s": len(seen.readings) / SECONDS,
                    "line, scans/s": line_hz,
                    "ADC, scans/s": 1e6 / (CONVERSION_US * channels + SETUP_US),
                    "lost": seen.lost,
                    "damaged": seen.rejected,
                }
            )
    return rows


if __name__ == "__main__":
    for row in run():
        print(row)
