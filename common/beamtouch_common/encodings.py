"""Text in files: UTF-8, or the name of the encoding that an editor has left instead."""

import codecs

MARKS = (
    (codecs.BOM_UTF32_LE, "utf-32", "UTF-32"),
    (codecs.BOM_UTF32_BE, "utf-32", "UTF-32"),
    (codecs.BOM_UTF16_LE, "utf-16", "UTF-16"),
    (codecs.BOM_UTF16_BE, "utf-16", "UTF-16"),
)
"""Beginnings of files, their encoding in Python, and its name. That of UTF-32 begins with that of UTF-16."""
UNMARKED = (("utf-16-le", "UTF-16"), ("utf-16-be", "UTF-16"), ("cp1252", "Windows-1252 (ANSI)"))
"""The same of files without such a beginning."""
SAVE = "save it as UTF-8"


def decode(content: bytes) -> str:
    """Return the text of a file in UTF-8; ValueError with what it is instead, and what to do.

    Some editors begin a file with a byte order mark, which is no part of the text.
    """
    start = 0
    try:
        text = content.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        start = error.start
    else:
        if "\0" not in text:
            return text
    name = other_encoding(content)
    if not name:
        raise ValueError("not a text file in UTF-8")
    line = content.count(b"\n", 0, start) + 1
    raise ValueError(f"in {name}, not in UTF-8{'' if 'UTF' in name else f' (line {line})'}; {SAVE}")


def other_encoding(content: bytes) -> str:
    """Return the name of the encoding of a text that is not in UTF-8; empty if it is in UTF-8, or if it is no text."""
    if _is_in(content, "utf-8"):
        return ""
    marked = [(codec, name) for mark, codec, name in MARKS if content.startswith(mark)]
    return next((name for codec, name in marked or UNMARKED if _is_in(content, codec)), "")


def _is_in(content: bytes, codec: str) -> bool:
    """Return whether bytes are a text in an encoding, which every even number of bytes may be in UTF-16."""
    try:
        text = content.decode(codec)
    except UnicodeDecodeError:
        return False
    is_likely = not codec.startswith("utf-16-") or any(letter in text for letter in "\n =,")
    return bool(text) and is_likely and all(letter.isprintable() or letter in "\t\r\n\f\ufeff" for letter in text)
