"""Shows what an open port has carried since its last frame. Pure.

That a port opens says little: there may be nothing at its other end, or a device that boots, prints text, or speaks at
another rate. So what decodes a line notes here which bytes were frames and which were not.
"""

import math
import re

BOOT_S = 8.0
"""Opening a port resets many devices, and until the first frame one may boot for this long. Boot loaders take 1 to 3 s,
some firmware several more."""
SILENT_S = 30.0
"""A port without a frame for this long is opened again, because some USB adapters hang until then. It is longer than
devices boot, as opening may reset them."""
RECENT_S = 2.0
"""A line that has carried a frame within this time works."""
KEPT_BYTES = 256
"""The newest bytes, which may be text."""
MIN_TEXT, MIN_SHARE = 6, 1 / 3
"""Bytes are text if they hold this many readable characters in words, and this share of them is readable."""
SHOWN = 60
"""Characters of a text in a message."""
_WORDS = re.compile(rb"[\t -~]{4,}")


class Traffic:
    """The bytes that an open port has carried.

    Parameters
    ----------
    now_s : When it was opened, by the clock of `uptime_s`.
    """

    def __init__(self, now_s: float) -> None:
        self._opened_s = now_s
        self._frame_s = -math.inf
        self._bytes = 0
        self._kept = b""

    @property
    def boots_until_s(self) -> float:
        """Time until which a device may boot; it has booted once it has sent a frame."""
        return self._opened_s + BOOT_S if math.isinf(self._frame_s) else -math.inf

    def note_frame(self, now_s: float) -> None:
        """Note that a frame came."""
        self._frame_s, self._bytes, self._kept = now_s, 0, b""

    def note_other(self, data: bytes) -> None:
        """Note bytes that are no frame."""
        self._bytes += len(data)
        self._kept = (self._kept + data)[-KEPT_BYTES:]

    def forget(self) -> None:
        """Let the bytes so far say nothing, because they came with other settings of the line."""
        self._bytes, self._kept = 0, b""

    def is_silent(self, now_s: float) -> bool:
        """Return whether no frame has come for so long that the port should be opened again."""
        return now_s - max(self._opened_s, self._frame_s) >= SILENT_S

    def describe_last_frame(self, now_s: float) -> str:
        """Return when the last frame came."""
        if math.isinf(self._frame_s):
            return "no intact frame has come since the port was opened"
        return f"the last intact frame came {now_s - self._frame_s:.1f} s ago"

    def describe(self, now_s: float) -> str:
        """Return what came instead of frames, and what to check; empty if a frame came recently."""
        if now_s - self._frame_s < RECENT_S:
            return ""
        if self.text:
            return f"the device prints text: {self.text!r}; is it the right device, and does it start again and again?"
        since = "" if math.isinf(self._frame_s) else " since its last frame"
        if self.noise:
            return f"the port is open, and {self.noise} came{since}, none of them a frame; check baud and parity"
        return f"the port is open, but not a byte came{since}; check supply and wiring"

    @property
    def noise(self) -> str:
        """Number of bytes that came and are no frame, as text; empty if none did."""
        return f"{self._bytes} bytes" if self._bytes else ""

    @property
    def text(self) -> str:
        """The beginning of the text among the newest bytes; empty if they are something else."""
        return text_of(self._kept)


def text_of(data: bytes) -> str:
    """Return the beginning of the text that bytes are; empty if they are something else."""
    text = b" ".join(words.strip() for words in _WORDS.findall(data)).strip()
    is_text = len(text) >= max(MIN_TEXT, MIN_SHARE * len(data))
    return text.decode()[:SHOWN] if is_text else ""
