"""The line between a device and its host: messages, framing, and the counters that wrap.

Pure: bytes in, messages out, no I/O. `PROTOCOL.md`, one folder up, says the same for implementers in any language.
"""
