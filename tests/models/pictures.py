"""SVG files as a program draws them that is no browser: librsvg, as in file managers and office programs."""

import io
import subprocess
from pathlib import Path

import numpy as np
import numpy.typing as npt
from matplotlib.image import imread

from support.running.debian_parts import require

Pixels = npt.NDArray[np.float32]
"""Shape (height, width, 3 or 4): red, green, blue, and opacity where it is not all of it, from 0 to 1."""


def drawn(svg: Path, width: int = 800) -> Pixels:
    """Return an SVG file as librsvg draws it."""
    program = require("rsvg-convert", "librsvg2-bin")
    done = subprocess.run([program, "--width", str(width), str(svg)], capture_output=True, check=True, timeout=60)
    return decoded(done.stdout)


def decoded(png: bytes) -> Pixels:
    """Return the pixels of a PNG."""
    return np.asarray(imread(io.BytesIO(png), format="png"), np.float32)


def share_of_black(pixels: Pixels) -> float:
    """Return how much of a picture is black."""
    black = pixels[..., :3].max(axis=2) < 1 / 16
    return float((black & (pixels[..., 3:] > 0.5).all(axis=2)).mean())


def share_of(pixels: Pixels, colour: str) -> float:
    """Return how much of a picture has a colour #rrggbb."""
    wanted = [int(colour[at : at + 2], 16) / 255 for at in (1, 3, 5)]
    return float((np.abs(pixels[..., :3] - wanted).max(axis=2) < 2.5 / 255).mean())
