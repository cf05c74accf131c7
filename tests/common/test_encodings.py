"""Files in other encodings than UTF-8: one line names the encoding, whoever reads the file."""

import pytest

from beamtouch_common.encodings import decode, other_encoding

TOML = 'name = "Pr\u00fcfstand"\r\nlength_mm = 400\r\n'
UTF_16, ANSI = (
    "in UTF-16, not in UTF-8; save it as UTF-8",
    "in Windows-1252 (ANSI), not in UTF-8 (line 1); save it as UTF-8",
)


@pytest.mark.parametrize(
    ("encoding", "mark", "said"),
    [
        ("utf-16-le", "\ufeff", UTF_16),
        ("utf-16-be", "\ufeff", UTF_16),
        ("utf-16-le", "", UTF_16),
        ("utf-16-be", "", UTF_16),
        ("utf-32", "", "in UTF-32, not in UTF-8; save it as UTF-8"),
        ("cp1252", "", ANSI),
        ("latin-1", "", ANSI),
    ],
)
def test_a_text_in_another_encoding_is_named(encoding: str, mark: str, said: str) -> None:
    with pytest.raises(ValueError, match="save it as UTF-8") as raised:
        decode((mark + TOML).encode(encoding))
    assert str(raised.value) == said


@pytest.mark.parametrize("content", [TOML.encode(), TOML.encode("utf-8-sig"), b"", b"a = 1", "\u9580 = 1".encode()])
def test_a_text_in_utf_8_is_taken_with_and_without_its_mark(content: bytes) -> None:
    assert decode(content) == content.decode("utf-8-sig")
    assert other_encoding(content) == ""


@pytest.mark.parametrize(
    "content", [b"\xff\xfe", b"\xff\xfe\x00", b"\x00" * 32, b"a\x00b", bytes(range(256)), b"\x08\x12\xe4\x00onnx"]
)
def test_what_is_no_text_has_no_encoding(content: bytes) -> None:
    assert other_encoding(content) == ""
    with pytest.raises(ValueError, match=r"^not a text file in UTF-8$"):
        decode(content)
