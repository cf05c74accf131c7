"""Files that people write, read with errors in one line; and files written whole or not at all, where they can be.

`docs/mistakes.md` has further errors, word for word.
"""

import os
import resource
import stat
import subprocess
import sys
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Annotated, Literal

import pytest
from pydantic import BaseModel, ConfigDict, Field

from beamtouch_common.errors import InputError
from beamtouch_common.files import load_toml, require_writable, write_atomically
from common.unprivileged import without_root

CROSSES = "x" * 76


class Strict(BaseModel):
    model_config = ConfigDict(extra="forbid", strict=True)


class Round(Strict):
    kind: Literal["round"]
    radius_mm: Annotated[float, Field(gt=0)]


class Square(Strict):
    kind: Literal["square"]
    side_mm: float


class Drawing(Strict):
    shape: Annotated[Round | Square, Field(discriminator="kind")] = Round(kind="round", radius_mm=1.0)
    count: int | Literal["auto"] = "auto"
    holes: list[Round] = Field(default_factory=list)
    named: dict[Annotated[str, Field(pattern="^[a-z]+$")], Square] = Field(default_factory=dict)
    max_mm: float = 1.0
    pair: float | Annotated[tuple[float, float], Field(strict=False)] = 1.0


def complaint(path: Path) -> str:
    with pytest.raises(InputError) as caught:
        load_toml(Drawing, path)
    said = str(caught.value)
    assert "\n" not in said
    return said.removeprefix(f"{path}: ")


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (
            "shape = {kind = 'round', radius_mm = 1.0, side_mm = 1.0}",
            "unknown key shape.side_mm; it belongs to another kind; remove it",
        ),
        (
            "shape = {kind = 'round', radius_mm = 1.0, count = 1}",
            "unknown key shape.count; it belongs in the file before all tables",
        ),
        ("pair = [1.0, 'a']", 'pair[1]: must be a number (given: "a")'),
        ("[[holes]]\nkind = 'round'", "holes[0].radius_mm is missing; add it"),
        (
            "[named.square]\nkind = 'square'\nside_mm = 'a'",
            'named.square.side_mm: must be a number (given: "a")',
        ),
        (
            "[named.A1]\nkind = 'square'\nside_mm = 1.0",
            "named.A1: must match the pattern '^[a-z]+$' (given: \"A1\")",
        ),
        (f"max_mm = '{'x' * 1000}'", f'max_mm: must be a number (given: "{CROSSES}...)'),
        (f"max_mm = '{'x' * 79}'", f'max_mm: must be a number (given: "{CROSSES}...)'),
        (f"max_mm = '{'x' * 78}'", f'max_mm: must be a number (given: "{"x" * 78}")'),
        ("shape = {radius_mm = 1.0}", "shape.kind is missing; add it"),
        (
            "shape = {kind = 'squar', side_mm = 1.0}",
            'shape.kind: must be "round" or "square"; did you mean "square"? (given: "squar")',
        ),
        ("shape = {kind = 'line'}", 'shape.kind: must be "round" or "square" (given: "line")'),
        ("count = 'many'", 'count: must be a whole number or "auto" (given: "many")'),
        ("pair = [1.0]", "pair: must have 2 entries, not 1 (given: [1.0])"),
        ("holes = 1", "holes: must be a list, as [1, 2] (given: 1)"),
        ("named = 1", "named: must be one table, as { key = 1 } (given: 1)"),
        ("max_m = 1.0", "unknown key max_m; did you mean max_mm?"),
        ("mm = 1.0", "unknown key mm; did you mean max_mm?"),
        ("max = 1.0\nmm = 2.0", "unknown key max; did you mean max_mm? (and 1 more)"),
        ("side_mm = 1.0", "unknown key side_mm; it belongs in [shape]"),
        ("wholly = 1.0", "unknown key wholly; remove it or correct its spelling"),
        ("[beam]", "unknown key beam; it belongs in a scene; is this the right file?"),
        ("[publish]", "unknown key publish; it belongs in a configuration of the daemon; is this the right file?"),
        ("[[step]]", "unknown key step; it belongs in a script of the rig; is this the right file?"),
        (
            "max_mm = 1,5",
            "not valid TOML: Expected newline or end of document after a statement (at line 1, column 11); one key per "
            "line, text in quotes, decimals with a point, and no unit behind a number",
        ),
        (
            "max_mm = True",
            "not valid TOML: Invalid value (at line 1, column 10); text needs quotes, and true and false are in lower "
            "case",
        ),
        (
            "max_mm = 1\nmax_mm = 2",
            "not valid TOML: Cannot overwrite a value (at end of document); the key is there twice",
        ),
    ],
)
def test_an_error_is_one_line_with_the_key_as_in_the_file(tmp_path: Path, text: str, said: str) -> None:
    path = tmp_path / "drawing.toml"
    path.write_text(text)
    assert complaint(path) == said


@pytest.mark.parametrize("text", ["x = " + "[" * 100_000, "x = " + "9" * 5000], ids=["nesting", "digits"])
def test_what_the_parser_cannot_take_is_not_valid(tmp_path: Path, text: str) -> None:
    (tmp_path / "drawing.toml").write_text(text)
    assert complaint(tmp_path / "drawing.toml").startswith("not valid TOML: ")


def test_a_file_that_cannot_be_read_is_an_error(tmp_path: Path) -> None:
    assert complaint(tmp_path / "absent.toml") == "No such file or directory"
    assert complaint(tmp_path) == "Is a directory"
    (tmp_path / "large").write_text("#" * (2**20 + 1))
    (tmp_path / "binary").write_bytes(b"\xff\xfe")
    assert complaint(tmp_path / "binary") == "not a text file in UTF-8"
    assert complaint(tmp_path / "large") == "larger than 1 MiB; is it the right file?"


def test_a_file_is_replaced_whole_with_the_permissions_that_were_asked_for(tmp_path: Path) -> None:
    before = os.umask(0o027)
    try:
        for name, mode in (("by umask", None), ("for all", 0o644), ("secret", 0o600)):
            (tmp_path / name).write_bytes(b"old")
            write_atomically(tmp_path / name, b"new", mode=mode)
    finally:
        os.umask(before)
    assert {path.name: stat.S_IMODE(path.stat().st_mode) for path in tmp_path.iterdir()} == {
        "by umask": 0o640,
        "for all": 0o644,
        "secret": 0o600,
    }
    assert {path.read_bytes() for path in tmp_path.iterdir()} == {b"new"}


WITHOUT_ROOM = """
import resource, sys
from pathlib import Path
from beamtouch_common.files import write_atomically
resource.setrlimit(resource.RLIMIT_FSIZE, (1000, 1000))
try:
    write_atomically(Path(sys.argv[1]), bytes(2000))
except OSError as error:
    print(error.strerror)
"""


def test_a_write_that_fails_leaves_the_old_file_and_nothing_else(tmp_path: Path) -> None:
    assert resource.getrlimit(resource.RLIMIT_FSIZE)[0] == resource.RLIM_INFINITY
    (tmp_path / "file").write_bytes(b"old")
    command = [sys.executable, "-c", WITHOUT_ROOM, str(tmp_path / "file")]
    done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=60)
    assert (done.returncode, done.stdout, done.stderr) == (0, "File too large\n", "")
    assert [path.name for path in tmp_path.iterdir()] == ["file"]
    assert (tmp_path / "file").read_bytes() == b"old"


def test_a_file_that_cannot_be_replaced_leaves_nothing_behind(tmp_path: Path) -> None:
    (tmp_path / "folder").mkdir()
    with pytest.raises(IsADirectoryError) as caught:
        write_atomically(tmp_path / "folder", b"new")
    assert caught.value.filename == str(tmp_path / "folder")  # not the partial file, which the user never named
    assert [path.name for path in tmp_path.iterdir()] == ["folder"]


@pytest.mark.parametrize("value", ["0x" + "f" * 4000, "[{" + ".".join("b" * 900) + " = 1}]"], ids=["long", "deep"])
def test_a_value_that_cannot_be_shown_is_refused_all_the_same(tmp_path: Path, value: str) -> None:
    path = tmp_path / "drawing.toml"
    path.write_text(f"max_mm = {value}\n")
    assert complaint(path).startswith("max_mm: ")


def test_a_byte_order_mark_is_no_part_of_a_file(tmp_path: Path) -> None:
    path = tmp_path / "drawing.toml"
    path.write_text("max_mm = 2.0\n", encoding="utf-8-sig")
    assert load_toml(Drawing, path).max_mm == 2.0


def test_a_pipe_and_a_device_are_written_to_and_stay(tmp_path: Path) -> None:
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    reader = os.open(pipe, os.O_RDONLY | os.O_NONBLOCK)
    write_atomically(pipe, b"new")
    assert os.read(reader, 9) == b"new"
    os.close(reader)
    assert [path.is_fifo() for path in tmp_path.iterdir()] == [True]
    write_atomically(Path("/dev/null"), b"new")
    assert Path("/dev/null").is_char_device()
    full = tmp_path / "full"
    full.symlink_to("/dev/full")
    with pytest.raises(OSError, match="No space left") as caught:
        write_atomically(full, b"new")
    assert caught.value.filename == str(full)


def test_a_link_stays_and_the_file_that_it_leads_to_is_replaced(tmp_path: Path) -> None:
    link, there = tmp_path / "link", tmp_path / "there"
    link.symlink_to("there")
    for content in (b"first", b"second"):
        write_atomically(link, content)
        assert (link.is_symlink(), there.read_bytes()) == (True, content)


def test_a_new_file_an_old_one_and_a_device_are_writable(tmp_path: Path) -> None:
    (tmp_path / "old.onnx").write_text("old")
    require_writable([tmp_path / "new.onnx", None, tmp_path / "old.onnx", Path("/dev/null")], [tmp_path / "scene.toml"])


def test_a_link_to_an_input_or_to_another_output_is_refused(tmp_path: Path) -> None:
    scene, model, link = tmp_path / "scene.toml", tmp_path / "model.onnx", tmp_path / "link"
    for target, outputs, inputs, said in (
        (scene, [link], [scene], "reads this file as well"),
        (scene, [scene], [link], "reads this file as well"),
        (model, [model, link], [scene], "would write this file twice"),
    ):
        link.unlink(missing_ok=True)
        link.symlink_to(target)
        with pytest.raises(InputError, match=f"{said}; name another one"):
            require_writable(outputs, inputs)


def test_a_folder_that_this_user_may_not_write_to_is_refused() -> None:
    with TemporaryDirectory() as name, without_root(Path(name)):
        folder, inside = Path(name) / "kept", Path(name) / "closed" / "deep" / "model.onnx"
        folder.mkdir(mode=0o500)
        (Path(name) / "closed").mkdir(mode=0)
        for path, said in (
            (folder / "model.onnx", f"{folder}: this user may not write there; choose another folder"),
            (inside, f"{inside}: Permission denied"),
        ):
            with pytest.raises(InputError) as caught:
                require_writable([path])
            assert str(caught.value) == said
