"""Surfaces in files of their own: what is read, what is refused with the name of the file, and reloading."""

import asyncio
import json
from pathlib import Path
from tempfile import TemporaryDirectory

import pytest

from beamtouch_common.errors import InputError
from beamtouch_daemon.config.file import load_config
from unprivileged import without_root

from . import configs
from .devices import pymodbus_server
from .process import command

pytestmark = pytest.mark.anyio


def including(folder: Path, *own: str, url: str = "http://127.0.0.1:8420", **files: str) -> Path:
    """Write a configuration that includes `surfaces/*.toml`, with these files in the folder."""
    path = configs.write(folder, *own, url=url)
    path.write_text(f'include = ["surfaces/*.toml"]\n{path.read_text()}')
    (folder / "surfaces").mkdir(exist_ok=True)
    for name, text in files.items():
        (folder / "surfaces" / f"{name}.toml").write_text(text)
    return path


def complaint(path: Path) -> str:
    with pytest.raises(InputError) as caught:
        load_config(path)
    assert "\n" not in str(caught.value)
    return str(caught.value)


def test_the_surfaces_of_all_files_are_read_and_each_knows_its_file(tmp_path: Path) -> None:
    path = including(tmp_path, configs.surface("bench"), b=configs.surface("two"), a=configs.surface("one"))
    (tmp_path / "surfaces" / ".c.toml.swp.toml").write_text("unfinished [")  # an editor's
    (tmp_path / "surfaces" / "notes.txt").write_text("not a surface")
    config = load_config(path)
    assert list(config.surfaces) == ["bench", "one", "two"]
    assert [config.file_of(name) for name in config.surfaces] == [
        path,
        tmp_path / "surfaces" / "a.toml",
        tmp_path / "surfaces" / "b.toml",
    ]


def test_a_configuration_may_have_all_its_surfaces_in_other_files(tmp_path: Path) -> None:
    assert list(load_config(including(tmp_path, a=configs.surface("one"))).surfaces) == ["one"]


def test_paths_start_from_the_file_that_states_them(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    tared = configs.surface("one").replace("rate_hz", 'tare_file = "one.json"\nrate_hz', 1)
    path = including(tmp_path, a=tared, b=configs.surface("two"))
    monkeypatch.chdir(tmp_path)
    for config in (load_config(path), load_config(Path("daemon.toml"))):
        assert config.tare_file("one") == tmp_path / "surfaces" / "one.json"
        assert config.tare_file("two") == tmp_path / "two.tare.json"  # as before the surface had a file of its own


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("[surfaces", "{file}: not valid TOML: "),
        (
            configs.surface("one").replace("window", "windw"),
            "{file}: unknown key surfaces.one.filter.windw; did you mean window?",
        ),
        (configs.PUBLISH, "{file}: publish belongs in {path}; a file that is included has only [surfaces.NAME] tables"),
        ("", "{file}: surfaces is missing; add it"),
        ("surfaces = 3", "{file}: surfaces: must be"),
        (configs.surface("bench"), "{file}: surfaces.bench is also in {path}; remove one of the two"),
        (configs.surface("other"), "{file}: surfaces.other is also in {other}; remove one of the two"),
    ],
)
def test_what_is_wrong_is_said_with_the_file_and_the_key(tmp_path: Path, text: str, said: str) -> None:
    path = including(tmp_path, configs.surface("bench"), a=configs.surface("other"), z=text)
    surfaces = tmp_path / "surfaces"
    assert complaint(path).startswith(said.format(file=surfaces / "z.toml", path=path, other=surfaces / "a.toml"))


@pytest.mark.parametrize(
    ("include", "said"),
    [
        ('["surfacs/*.toml"]', "include: no file matches 'surfacs/*.toml'; correct it, for example to surfaces/*.toml"),
        ('[""]', "include[0]: must be the path of a file"),
        (f'["{"x" * 300}"]', f"include: no file matches '{'x' * 300}'; correct it"),
        ('[".."]', "include: no file matches '..'; correct it"),
        ('["surfaces/"]', "include: no file matches 'surfaces/'; correct it, for example to surfaces/*.toml"),
        ('["a\\u0000b"]', "include[0]: must be the path of a file"),
        ('"surfaces/*.toml"', "include: must be "),
        ("[3]", "include[0]: must be "),
    ],
)
def test_a_wrong_pattern_is_said(tmp_path: Path, include: str, said: str) -> None:
    path = including(tmp_path, configs.surface("bench"), a=configs.surface("other"))
    path.write_text(path.read_text().replace('["surfaces/*.toml"]', include))
    assert complaint(path).startswith(f"{path}: {said}")


def test_folders_among_the_files_are_left_out(tmp_path: Path) -> None:
    path = including(tmp_path, a=configs.surface("one"))
    (tmp_path / "surfaces" / "old.toml").mkdir()
    assert list(load_config(path).surfaces) == ["one"]


def test_a_link_to_itself_and_a_link_to_nothing_are_said(tmp_path: Path) -> None:
    path = including(tmp_path, a=configs.surface("one"))
    link = tmp_path / "surfaces" / "b.toml"
    link.symlink_to(link.name)
    assert complaint(path).startswith(f"{link}: ")
    link.unlink()
    link.symlink_to("absent")
    assert complaint(path) == f"{link}: No such file or directory"


def test_a_folder_that_this_user_may_not_read_is_said() -> None:
    with TemporaryDirectory() as name, without_root(Path(name)):
        path = including(Path(name), a=configs.surface("one"))
        surfaces = path.parent / "surfaces"
        surfaces.chmod(0)
        assert complaint(path).startswith(f"{path}: include: no file matches 'surfaces/*.toml'; ")
        assert complaint(path).endswith("let this user read the folder")
        surfaces.chmod(0o700)


def test_files_anywhere_may_be_included(tmp_path: Path) -> None:
    path = including(tmp_path, configs.surface("bench"), a=configs.surface("one"))
    pattern = f'["{tmp_path}/surf*/**/*.toml"]'
    path.write_text(path.read_text().replace('["surfaces/*.toml"]', pattern))
    assert list(load_config(path).surfaces) == ["bench", "one"]


def test_a_file_that_this_user_may_not_reach_is_told() -> None:
    with TemporaryDirectory() as name, without_root(Path(name)):
        path = including(Path(name), a=configs.surface("one"))
        surfaces = path.parent / "surfaces"
        surfaces.chmod(0o400)  # its names may be read, and nothing in it
        assert complaint(path) == f"{surfaces / 'a.toml'}: Permission denied"
        surfaces.chmod(0o700)
        (surfaces / "b.toml").symlink_to("../closed/b.toml")
        (path.parent / "closed").mkdir(mode=0)
        assert complaint(path) == f"{surfaces / 'b.toml'}: Permission denied"


def test_a_file_that_two_patterns_match_is_read_once(tmp_path: Path) -> None:
    path = including(tmp_path, a=configs.surface("one"))
    path.write_text(path.read_text().replace('"surfaces/*.toml"', '"surfaces/*.toml", "*/a.toml", "surfaces/a.toml"'))
    assert list(load_config(path).surfaces) == ["one"]


def test_surfaces_that_cannot_share_a_port_are_named_with_their_files(tmp_path: Path) -> None:
    a, b = (configs.surface(name, configs.serial("/dev/x")) for name in ("one", "two"))
    path = including(tmp_path, a=a, b=b)
    surfaces = tmp_path / "surfaces"
    assert complaint(path) == (
        f"{path}: 2 surfaces use /dev/x (one in {surfaces / 'a.toml'}, two in {surfaces / 'b.toml'}); "
        "a serial port serves one surface"
    )


async def test_check_shows_the_file_of_each_surface(tmp_path: Path) -> None:
    async with pymodbus_server([20_000, 21_000]) as port:
        bench, one = (configs.surface(name, configs.tcp(port)) for name in ("bench", "one"))
        path = including(tmp_path, bench, a=one)
        table, report = await asyncio.gather(command("check", path), command("check", path, "--json"))
    assert (table.code, report.code) == (0, 0)
    assert [line.split()[-1] for line in table.out.splitlines()[:-1]] == [
        "file",
        *[str(path)] * 2,
        *[str(tmp_path / "surfaces" / "a.toml")] * 2,
    ]
    files = {name: found["file"] for name, found in json.loads(report.out)["surfaces"].items()}
    assert files == {"bench": str(path), "one": str(tmp_path / "surfaces" / "a.toml")}
