"""Outputs of a command are checked before it works for minutes."""

from pathlib import Path
from tempfile import TemporaryDirectory

import pytest

from beamtouch_common.errors import InputError
from beamtouch_common.files import require_writable
from unprivileged import without_root


def complaint(outputs: list[Path | None], inputs: list[Path | None]) -> str:
    with pytest.raises(InputError) as caught:
        require_writable(outputs, inputs)
    return str(caught.value)


def test_files_in_folders_that_exist_can_be_written(tmp_path: Path) -> None:
    (tmp_path / "old.onnx").write_text("old")
    require_writable([tmp_path / "new.onnx", None, tmp_path / "old.onnx"], [tmp_path / "scene.toml", None])
    require_writable([Path("/dev/null")])


def test_a_place_where_no_file_can_be_is_refused(tmp_path: Path) -> None:
    absent = tmp_path / "absent"
    assert complaint([absent / "model.onnx"], []) == f"{absent}: no such folder; create it first"
    assert complaint([tmp_path], []) == f"{tmp_path}: is a folder; name a file in it"


def test_a_file_for_two_purposes_is_refused(tmp_path: Path) -> None:
    scene, model = tmp_path / "scene.toml", tmp_path / "model.onnx"
    assert complaint([model, scene], [scene]) == f"{scene}: the command reads this file as well; name another one"
    again = tmp_path / ".." / tmp_path.name / "model.onnx"
    assert complaint([model, again], [scene]) == f"{again}: the command would write this file twice; name another one"


def test_a_folder_that_this_user_may_not_write_to_is_refused() -> None:
    with TemporaryDirectory() as name, without_root(Path(name)):
        folder = Path(name) / "kept"
        folder.mkdir(mode=0o500)
        said = f"{folder}: this user may not write there; choose another folder"
        assert complaint([folder / "model.onnx"], []) == said
        (Path(name) / "closed").mkdir(mode=0)
        inside = Path(name) / "closed" / "deep" / "model.onnx"
        assert complaint([inside], []) == f"{inside}: Permission denied"
