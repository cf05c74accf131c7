"""The serial protocol between a device and its host: messages, framing, and counters that wrap.

Pure: bytes in, messages out, no I/O. `PROTOCOL.md`, one folder up, specifies it for implementers in any language.
"""
