"""SVG files as a program draws them that is no browser: librsvg, as in file managers and office programs."""

import struct
import subprocess
import zlib
from pathlib import Path

import numpy as np
import numpy.typing as npt

from parts import require

Pixels = npt.NDArray[np.uint8]
"""Shape (height, width, 4): red, green, blue, opacity."""


def drawn(svg: Path, width: int = 800) -> Pixels:
    """Return an SVG file as librsvg draws it."""
    program = require("rsvg-convert", "librsvg2-bin")
    done = subprocess.run([program, "--width", str(width), str(svg)], capture_output=True, check=True, timeout=60)
    return decoded(done.stdout)


def decoded(png: bytes) -> Pixels:
    """Return a PNG of 8 bits per channel, not interlaced."""
    width, height, depth, colour, _, _, interlace = struct.unpack(">IIBBBBB", png[16:29])
    assert (depth, interlace) == (8, 0)
    size = {2: 3, 6: 4}[colour]
    data, at = b"", 8
    while at < len(png):
        (length,) = struct.unpack(">I", png[at : at + 4])
        if png[at + 4 : at + 8] == b"IDAT":
            data += png[at + 8 : at + 8 + length]
        at += length + 12
    raw = zlib.decompress(data)
    stride = width * size
    rows, above = bytearray(), bytes(stride)
    for start in range(0, len(raw), stride + 1):
        row = _unfiltered(raw[start], bytearray(raw[start + 1 : start + 1 + stride]), above, size)
        rows += row
        above = bytes(row)
    pixels = np.frombuffer(bytes(rows), np.uint8).reshape(height, width, size)
    return np.concatenate([pixels, np.full((height, width, 4 - size), 255, np.uint8)], axis=2)


def _unfiltered(kind: int, row: bytearray, above: bytes, size: int) -> bytearray:
    """Return a row without its filter (PNG, 9.2)."""
    if kind == 2:
        total = np.frombuffer(bytes(row), np.uint8).astype(int) + np.frombuffer(above, np.uint8)
        row[:] = (total & 255).astype(np.uint8).tobytes()
    elif kind:
        for at in range(len(row)):
            left, corner = (row[at - size], above[at - size]) if at >= size else (0, 0)
            up = above[at]
            if kind == 1:
                guess = left
            elif kind == 3:
                guess = (left + up) // 2
            else:
                to_left, to_up, to_corner = abs(up - corner), abs(left - corner), abs(left + up - 2 * corner)
                best = min(to_left, to_up, to_corner)
                guess = left if best == to_left else up if best == to_up else corner
            row[at] = (row[at] + guess) & 255
    return row


def share_of_black(pixels: Pixels) -> float:
    """Return how much of a picture is black."""
    return float(((pixels[..., :3].max(axis=2) < 16) & (pixels[..., 3] > 128)).mean())


def share_of(pixels: Pixels, colour: str) -> float:
    """Return how much of a picture has a colour #rrggbb."""
    wanted = [int(colour[at : at + 2], 16) for at in (1, 3, 5)]
    return float((np.abs(pixels[..., :3].astype(int) - wanted).max(axis=2) <= 2).mean())
