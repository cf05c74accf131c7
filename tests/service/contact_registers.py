"""Registers of one surface decoded by their documented addresses, without a word of the service's code."""

import struct
from math import isnan
from typing import Any

USED = 42
"""Registers of a block that have a meaning."""
STATES = {1: "clear", 2: "contact", 3: "unexplained"}
NOTES = ["overload", "unsteady", "unchecked", "rate", "noise", "degraded", "senders"]
FIGURES = {
    "position_mm": 8,
    "position_low_mm": 10,
    "position_high_mm": 12,
    "force_n": 14,
    "force_low_n": 16,
    "force_high_n": 18,
}


def single(value: float | None) -> float | None:
    """Return a value of double precision as the nearest of single precision; None stays None."""
    return None if value is None else float(struct.unpack(">f", struct.pack(">f", value))[0])


def number(words: list[int], kind: str, word_order: str = "big") -> float | None:
    """Return the value of two registers; None for NaN."""
    high, low = words if word_order == "big" else reversed(words)
    value = float(struct.unpack(kind, struct.pack(">HH", high, low))[0])
    return None if isnan(value) else value


def decoded(words: list[int], channels: list[str], word_order: str = "big") -> dict[str, Any]:
    """Return a block as `GET /contact` has it, without the age: figures in single precision."""
    assert number(words[20:22], ">f", word_order) == 1234.5
    notes = [note for bit, note in enumerate(NOTES) if words[3] >> bit & 1]
    return {
        "state": STATES.get(words[2]),
        "sequence": number(words[6:8], ">I", word_order),
        "readings": words[5] or None,
        "notes": sorted([*notes, *[f"check-{name}" for name in named(words, 22, channels)]]),
        "degraded_channels": sorted(name for offset in (26, 30, 34, 38) for name in named(words, offset, channels)),
        **{name: number(words[offset : offset + 2], ">f", word_order) for name, offset in FIGURES.items()},
    }


def named(words: list[int], offset: int, channels: list[str]) -> list[str]:
    """Return the channels whose bits are set from an offset on."""
    return [name for place, name in enumerate(channels) if words[offset + place // 16] >> place % 16 & 1]


def expected(contact: dict[str, Any]) -> dict[str, Any]:
    """Return what the registers must say of a contact of `GET /contact`."""
    kept = {name: contact[name] for name in ("state", "sequence", "readings")}
    figures = {name: single(contact[name]) for name in FIGURES}
    lists = {name: sorted(contact[name]) for name in ("notes", "degraded_channels")}
    return kept | lists | figures
