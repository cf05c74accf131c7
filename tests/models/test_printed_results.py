"""The one printer of commands: tables, paragraphs, columns and notes, for people and for programs."""

import json

import pytest

from beamtouch_models.design.printing import Result, Table, Words, markdown, note, show

LONG = "a line of words that goes on and on until it is wider than a page of a hundred characters, and then some more"


def printed(capsys: pytest.CaptureFixture[str], *blocks: object, remark: str = "", as_json: bool = False) -> list[str]:
    show(Result({"one": 1, "none": None}, blocks, remark), as_json=as_json)  # type: ignore[arg-type]
    return capsys.readouterr().out.splitlines()


def test_for_programs_a_result_is_one_json_object(capsys: pytest.CaptureFixture[str]) -> None:
    show(Result({"one": 1, "none": None}, ["for people"], "a remark"), as_json=True)
    shown = capsys.readouterr()
    assert json.loads(shown.out) == {"one": 1, "none": None}
    assert shown.err == ""


def test_for_people_text_is_as_it_is_and_paragraphs_keep_to_a_hundred_characters(
    capsys: pytest.CaptureFixture[str],
) -> None:
    assert printed(capsys, f"{LONG} {LONG}") == [f"{LONG} {LONG}"]
    lines = printed(capsys, Words(f"{LONG}\n- {LONG}\nshort"))
    assert [len(line) <= 100 for line in lines] == [True] * 5
    assert " ".join(lines[:2]) == LONG
    assert lines[2].startswith("- a line of words")
    assert lines[3].startswith("  ")
    assert f"{lines[2]} {lines[3].strip()}" == f"- {LONG}"
    assert lines[4] == "short"
    assert printed(capsys, [("one", "first"), ("another", LONG)]) == [
        "one      first",
        "another  a line of words that goes on and on until it is wider than a page of a hundred characters,",
        "         and then some more",
    ]


def test_the_numbers_of_a_table_stand_to_the_right(capsys: pytest.CaptureFixture[str]) -> None:
    rows = [("s1", "1.5", "left"), ("sensor two", "10", "of it")]
    lines = printed(capsys, Table(("name", "mm", "side"), rows, text=("side",)))
    shown = [line for line in lines if line.strip()]
    assert [line.split() for line in (shown[0], *shown[2:])] == [
        ["name", "mm", "side"],
        ["s1", "1.5", "left"],
        ["sensor", "two", "10", "of", "it"],
    ]
    ends = [
        line.index(cell) + len(cell) for line, cell in zip((shown[0], *shown[2:]), ("mm", "1.5", "10"), strict=True)
    ]
    assert len(set(ends)) == 1
    begins = [line.index(cell) for line, cell in zip((shown[0], *shown[2:]), ("side", "left", "of it"), strict=True)]
    assert len(set(begins)) == 1
    assert {line.index(cell) for line, cell in zip((shown[0], *shown[2:]), ("name", "s1", "sensor"), strict=True)} == {
        1
    }
    titled = printed(capsys, Table(("name of each",), [("one",), ("two",)], title="what it is"))
    assert titled[0].strip() == "what it is"
    ruled = printed(capsys, Table(("name",), [("one",), ("two",)], ruled=True))
    plain = printed(capsys, Table(("name",), [("one",), ("two",)]))
    assert len(ruled) == len(plain) + 1


def test_what_stands_beside_a_result_is_on_standard_error(capsys: pytest.CaptureFixture[str]) -> None:
    assert printed(capsys, "text") == ["text"]
    show(Result({}, ["text"], "where the files are"), as_json=False)
    shown = capsys.readouterr()
    assert (shown.out, shown.err) == ("text\n", "where the files are\n")
    note("", "the first", LONG)
    note("beware", kind="warning")
    shown = capsys.readouterr()
    assert shown.out == ""
    first, second, third, last = shown.err.splitlines()
    assert first == "note:    the first"
    assert second.startswith("note:    a line of words")
    assert third.startswith("         ")
    assert last == "warning: beware"


def test_a_page_in_markdown_has_the_same_blocks() -> None:
    table = Table(("name", "mm"), [("s1", "1.5")], title="where they are")
    assert markdown("The page", ["text", Words("a paragraph"), table, [("one", "first"), ("two", "second")]]) == (
        "# The page\n\ntext\n\na paragraph\n\n## Where they are\n\n| name | mm  |\n| ---- | --- |\n| s1   | 1.5 |\n\n"
        "```\none  first\ntwo  second\n```\n"
    )
