"""Tokens and passwords in files."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

from beamtouch_common.errors import FailedError, InputError
from beamtouch_common.secrets import read_password, read_token

if TYPE_CHECKING:
    from pathlib import Path


@pytest.mark.parametrize("content", [b"sixteen-chars-16", b"  sixteen-chars-16\r\n\n"])
def test_white_space_around_a_token_is_none_of_it(tmp_path: Path, content: bytes) -> None:
    (tmp_path / "token").write_bytes(content)
    assert read_token(tmp_path / "token") == "sixteen-chars-16"


@pytest.mark.parametrize(
    ("content", "problem"),
    [
        (b"", "empty"),
        (b" \n", "empty"),
        (b"short", "only 5 characters"),
        (b"s", "only 1 character;"),
        (b"two words of text", "more than one word of printable ASCII"),
        ("sécret-of-sixteen".encode(), "more than one word of printable ASCII"),
        (b"\x00" * 32, "more than one word of printable ASCII"),
        (b"x" * 4097, "longer than 4096 bytes"),
    ],
)
def test_a_token_that_cannot_be_used_is_refused(tmp_path: Path, content: bytes, problem: str) -> None:
    (tmp_path / "token").write_bytes(content)
    with pytest.raises(InputError, match=problem) as caught:
        read_token(tmp_path / "token", "write the service's token to it")
    assert str(caught.value).startswith(f"token file {tmp_path / 'token'}: ")
    assert str(caught.value).endswith("; write the service's token to it")


@pytest.mark.parametrize("content", ["päss word", "päss word\n", "päss word\r\n"])
def test_a_password_may_hold_spaces(tmp_path: Path, content: str) -> None:
    (tmp_path / "password").write_bytes(content.encode())
    assert read_password(tmp_path / "password") == "päss word"


@pytest.mark.parametrize("content", [b"", b"\n", b"two\nlines", b"\xff\xfe", b"x" * 4097])
def test_a_password_is_one_line_of_text(tmp_path: Path, content: bytes) -> None:
    (tmp_path / "password").write_bytes(content)
    with pytest.raises(InputError, match="not one line of text; write the password to it, in one line"):
        read_password(tmp_path / "password")


@pytest.mark.parametrize("read", [read_token, read_password])
def test_a_file_that_cannot_be_read_may_come_later(tmp_path: Path, read: object) -> None:
    assert callable(read)
    with pytest.raises(FailedError, match=r"file .*nothing: No such file or directory; write "):
        read(tmp_path / "nothing")
