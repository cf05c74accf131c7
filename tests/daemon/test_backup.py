"""`beamtouch-daemon backup` and `restore`: the configuration with what it includes, and the tares that there are."""

from pathlib import Path

import pytest

from beamtouch_daemon.cli import main
from daemon.conftest import Refused
from support.surfaces import configs


@pytest.fixture
def config(tmp_path: Path) -> Path:
    """A configuration with a surface of its own and an included one, of which the first has a tare."""
    folder = tmp_path / "gateway"
    (folder / "surfaces").mkdir(parents=True)
    path = configs.write(folder, 'include = ["surfaces/*.toml"]\n', configs.surface())
    path.write_text('include = ["surfaces/*.toml"]\n' + path.read_text().replace('include = ["surfaces/*.toml"]\n', ""))
    (folder / "surfaces" / "more.toml").write_text(configs.surface().replace("surfaces.bench", "surfaces.more"))
    (folder / "bench.tare.json").write_text("{}")
    return path


def found(folder: Path) -> dict[str, str]:
    return {str(path.relative_to(folder)): path.read_text() for path in folder.rglob("*") if path.is_file()}


@pytest.mark.parametrize("with_secrets", [False, True])
def test_a_gateway_is_backed_up_and_restored_elsewhere(
    config: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], with_secrets: bool
) -> None:
    archive, new = str(tmp_path / "a.tar.gz"), tmp_path / "new"
    option = ["--with-secrets"] if with_secrets else []
    assert main(["backup", str(config), "-o", archive, *option]) == 0
    left_out = "" if with_secrets else f"left out: {config.parent}/beamtouch.token (--with-secrets)"
    assert capsys.readouterr().out.splitlines()[-1] == (left_out or "folder/beamtouch.token")
    assert main(["restore", archive, str(new)]) == 0
    wanted = found(config.parent)
    if not with_secrets:
        del wanted["beamtouch.token"]
    assert found(new) == wanted
    assert sorted(wanted)[-3:] == ["bench.tare.json", "daemon.toml", "surfaces/more.toml"]


def test_what_cannot_be_backed_up_or_restored_is_said_in_one_line(
    config: Path, tmp_path: Path, refused: Refused
) -> None:
    (tmp_path / "a").write_text("no archive")
    assert "is there already" in refused("backup", config, "-o", tmp_path / "a")
    assert "not a whole archive of `backup`" in refused("restore", tmp_path / "a", tmp_path / "new")
    assert "No such file or directory" in refused("restore", tmp_path / "none", tmp_path / "new")
