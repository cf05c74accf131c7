"""Tokens and passwords in files."""

from collections.abc import Callable
from pathlib import Path

import pytest

from beamtouch_common.errors import FailedError, InputError
from beamtouch_common.secrets import read_password, read_token, read_tokens

Read = Callable[[Path], str]


@pytest.mark.parametrize(
    ("read", "content", "secret"),
    [
        (read_token, b"  sixteen-chars-16\r\n\n", "sixteen-chars-16"),
        (read_token, b"\xef\xbb\xbfsixteen-chars-16\r\n", "sixteen-chars-16"),
        (read_password, "p\u00e4ss word\r\n".encode(), "p\u00e4ss word"),  # spaces belong to a password
        (read_password, "p\u00e4ss word\r\n".encode("utf-8-sig"), "p\u00e4ss word"),
        (read_password, b"  p word \n", "  p word "),
        (read_password, b"x" * 4096, "x" * 4096),
        (read_password, b"x", "x"),
        (read_token, b"x" * 4096, "x" * 4096),
        (read_token, b"x" * 16, "x" * 16),
        (read_token, b"!" * 8 + b"~" * 8, "!" * 8 + "~" * 8),
    ],
)
def test_white_space_at_the_ends_is_no_part_of_a_token_and_of_a_password_only_its_line_end_is_none(
    tmp_path: Path, read: Read, content: bytes, secret: str
) -> None:
    (tmp_path / "secret").write_bytes(content)
    assert read(tmp_path / "secret") == secret


ONE_LINE = "not one line of text; write the password to it, in one line"


@pytest.mark.parametrize(
    ("read", "content", "problem"),
    [
        (read_token, b" \n", "empty"),
        (read_token, b"s", "only 1 character;"),
        (read_token, b"two words of text", "more than one word of printable ASCII"),
        (read_token, "s\u00e9cret-of-sixteen".encode(), "more than one word of printable ASCII"),
        (read_token, b"\x00" * 32, "more than one word of printable ASCII"),
        (read_token, b"x" * 4097, "longer than 4096 bytes"),
        (read_token, b"x" * 15, "only 15 characters; write at least 16 random characters to it, as `openssl rand -hex"),
        (read_token, "sixteen-chars-16\r\n".encode("utf-16"), "in UTF-16; save it as UTF-8; write at least 16 random"),
        (read_password, "password\r\n".encode("utf-16"), "in UTF-16; save it as UTF-8"),
        (read_password, "p\u00e4ss word\n".encode("cp1252"), r"in Windows-1252 \(ANSI\); save it as UTF-8"),
        (read_password, b"\n", ONE_LINE),
        (read_password, b"two\nlines", ONE_LINE),
        (read_password, b"\xff\xfe", ONE_LINE),
        (read_password, b"x" * 4097, ONE_LINE),
    ],
)
def test_a_secret_that_cannot_be_used_is_refused_with_its_file(
    tmp_path: Path, read: Read, content: bytes, problem: str
) -> None:
    (tmp_path / "secret").write_bytes(content)
    with pytest.raises(InputError, match=rf"file {tmp_path / 'secret'}: .*{problem}"):
        read(tmp_path / "secret")


SIXTEEN, OTHER = "sixteen-chars-16", "further-chars-16"


@pytest.mark.parametrize(
    ("content", "tokens"),
    [
        (f"{SIXTEEN}\n", {"write": SIXTEEN}),
        (f"hall {SIXTEEN}\n", {"hall": SIXTEEN}),
        (f"hall  {SIXTEEN}\r\n\r\nann\t{OTHER}", {"hall": SIXTEEN, "ann": OTHER}),
        (f"{SIXTEEN}\n\n{OTHER}\n", {"write-1": SIXTEEN, "write-3": OTHER}),
        (f"{'x' * 40} {SIXTEEN}", {"x" * 40: SIXTEEN}),
        (f"0.a_b-c {SIXTEEN}", {"0.a_b-c": SIXTEEN}),
    ],
)
def test_a_token_has_the_name_before_it_or_that_of_its_role_and_line(
    tmp_path: Path, content: str, tokens: dict[str, str]
) -> None:
    (tmp_path / "tokens").write_bytes(content.encode())
    assert read_tokens(tmp_path / "tokens", "write") == tokens


@pytest.mark.parametrize(
    ("content", "problem"),
    [
        ("", "tokens: empty; write at least 16"),
        ("hall short\n", "tokens: only 5 characters"),
        (f"{SIXTEEN}\nhall short\n", "tokens: line 2: only 5 characters"),
        (f"the hall {SIXTEEN}", "neither TOKEN nor NAME TOKEN"),
        (f"h\u00e4ll {SIXTEEN}", "neither TOKEN nor NAME TOKEN"),
        (f"{'x' * 41} {SIXTEEN}", "a name has up to 40 letters"),
        (f"hall {SIXTEEN}\nhall {OTHER}", "line 2: the name hall stands in a line before"),
        (f"hall {SIXTEEN}\nann {SIXTEEN}", "line 2: the token stands in a line before"),
    ],
)
def test_a_file_of_tokens_that_cannot_be_used_is_refused_without_quoting_a_token(
    tmp_path: Path, content: str, problem: str
) -> None:
    (tmp_path / "tokens").write_bytes(content.encode())
    with pytest.raises(InputError, match=problem) as caught:
        read_tokens(tmp_path / "tokens", "write")
    assert SIXTEEN not in str(caught.value)


@pytest.mark.parametrize(
    ("read", "said"),
    [
        (read_token, r"token file .*absent: No such file or directory; write at least 16 random characters to it, as"),
        (read_password, r"password file .*absent: No such file or directory; write the password to it, in one line"),
    ],
)
def test_a_secret_that_is_not_there_may_come_later(tmp_path: Path, read: Read, said: str) -> None:
    with pytest.raises(FailedError, match=said):
        read(tmp_path / "absent")
