"""Model files in stages: the commands `models`, `take` and `take-back`."""

import errno
import json
import os
from hashlib import sha256
from pathlib import Path

import pytest

from beamtouch_models.runtime.metadata import POSITION_OUTPUTS
from beamtouch_service import cli
from service.staged_files import BAD, NEW, NEWER, OLD, Files
from support.programs.in_process import Command, command_of
from support.running.debian_parts import give_up
from support.surfaces.small_model import content_of, model_of


@pytest.fixture
def command(capsys: pytest.CaptureFixture[str]) -> Command:
    return command_of(cli.main, capsys)


@pytest.fixture
def files(tmp_path: Path, command: Command) -> Files:
    return Files(tmp_path, command)


def test_a_candidate_is_taken_and_taken_back(files: Files) -> None:
    files.candidate.write_bytes(NEW)
    code, said = files.take()
    assert (code, files.contents) == (0, {"model": NEW, "previous": OLD})
    new, old = model_of("new").identity, model_of("old").identity
    assert said.startswith(f"surface press-7: {new} (sha256 ")
    assert f" instead of {old} (sha256 " in said
    assert said.count("\n") == 1
    code, said = files.take_back()
    assert (code, files.contents) == (0, {"model": OLD, "candidate": NEW})
    assert said.startswith(f"surface press-7: {old} (sha256 ")
    assert files.take()[0] == 0
    assert files.contents == {"model": NEW, "previous": OLD}


def test_a_candidate_that_came_meanwhile_stays_and_no_model_is_lost(files: Files) -> None:
    files.candidate.write_bytes(NEW)
    files.take()
    files.candidate.write_bytes(NEWER)
    assert files.take_back()[0] == 0
    assert files.contents == {"model": OLD, "candidate": NEWER, "previous": NEW}


def test_a_candidate_that_comes_while_another_one_is_taken_stays(files: Files, monkeypatch: pytest.MonkeyPatch) -> None:
    files.candidate.write_bytes(NEW)
    replace = Path.replace

    def bring_another_first(self: Path, target: Path) -> Path:
        files.candidate.write_bytes(NEWER)
        return replace(self, target)

    monkeypatch.setattr(Path, "replace", bring_another_first)
    assert files.take()[0] == 0
    assert files.contents == {"model": NEW, "candidate": NEWER, "previous": OLD}


@pytest.mark.promise("docs/how-to/rollout.md", "A tool that copies the same candidate again after it was taken")
def test_a_model_that_was_taken_back_is_not_put_back_by_the_same_command_again(files: Files) -> None:
    """Who takes back on many gateways, and then on all of them again because one was off, takes back once."""
    files.candidate.write_bytes(NEW)
    files.take()
    files.candidate.write_bytes(NEW)
    assert files.take_back()[0] == 0
    assert files.contents == {"model": OLD, "candidate": NEW}
    assert files.take_back()[0] == 2
    assert files.contents == {"model": OLD, "candidate": NEW}


def test_a_candidate_that_cannot_be_read_keeps_nothing_from_being_taken_back(files: Files) -> None:
    files.previous.write_bytes(NEW)
    files.candidate.mkdir()
    assert files.take_back()[0] == 0
    assert (files.model.read_bytes(), files.previous.read_bytes()) == (NEW, OLD)


def test_the_files_keep_the_permissions_of_the_model(files: Files) -> None:
    """A service of another user reads them: a copy that only its owner may read would leave it without a model."""
    files.model.chmod(0o644)
    files.candidate.write_bytes(NEW)
    files.candidate.chmod(0o600)
    files.take()
    assert {one.stat().st_mode & 0o777 for one in (files.model, files.previous)} == {0o644}


def test_the_files_belong_to_whom_the_model_belongs(files: Files) -> None:
    """`take` is typed by root, and a model may be readable by the group of the service only."""
    if os.geteuid() != 0:
        give_up("only root may give a file to another user")
    files.model.chmod(0o640)
    os.chown(files.model, 0, 4711)
    files.candidate.write_bytes(NEW)
    files.take()
    files.take_back()
    for path in (files.model, files.candidate):
        status = path.stat()
        assert (status.st_gid, status.st_mode & 0o777) == (4711, 0o640)


def test_a_user_who_may_give_nothing_away_takes_all_the_same(files: Files, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: object) -> None:
        raise PermissionError(1, "Operation not permitted")

    monkeypatch.setattr(os, "fchown", refuse)
    files.candidate.write_bytes(NEW)
    assert files.take()[0] == 0
    assert files.contents == {"model": NEW, "previous": OLD}


def test_a_link_stays_a_link(files: Files) -> None:
    files.model.rename(files.folder / "press-7-of-may.onnx.1")
    files.model.symlink_to("press-7-of-may.onnx.1")
    files.candidate.write_bytes(NEW)
    files.take()
    assert files.model.is_symlink()
    assert files.contents == {"model": NEW, "previous": OLD, "press-7-of-may.onnx.1": NEW}


@pytest.mark.promise("docs/how-to/rollout.md", "if its digest begins otherwise, nothing changes")
def test_a_candidate_of_another_digest_is_not_taken(files: Files) -> None:
    files.candidate.write_bytes(NEW)
    digest = sha256(NEW).hexdigest()
    for wrong in ("0" * 64, digest[:-1] + ("0" if digest[-1] != "0" else "1"), digest[:5], "press-7", ""):
        code, said = files.take("--digest", wrong)
        assert (code, said.count("\n"), files.contents) == (2, 1, {"model": OLD, "candidate": NEW}), wrong
    assert digest in files.take("--digest", "0" * 64)[1]
    assert files.take("--digest", digest[:6].upper())[0] == 0
    assert files.contents == {"model": NEW, "previous": OLD}


@pytest.mark.promise("docs/how-to/rollout.md", "Otherwise it says so in one line, exits with 2, and changes nothing.")
@pytest.mark.parametrize("complaint", BAD)
def test_a_file_that_a_service_would_not_use_is_neither_taken_nor_taken_back(files: Files, complaint: str) -> None:
    for path, take in ((files.candidate, files.take), (files.previous, files.take_back)):
        path.write_bytes(BAD[complaint])
        before = files.contents
        code, said = take()
        assert (code, said.count("\n"), files.contents) == (2, 1, before)
        assert complaint in said
        path.unlink()


def test_a_zone_that_the_candidate_cannot_have_is_named(files: Files) -> None:
    files.config.write_text(
        "[surfaces.press-7]\nmodel = 'press-7.onnx'\nzones.gate = {from_mm = 1, to_mm = 9, least_force_n = 5}\n"
    )
    files.candidate.write_bytes(content_of("new", outputs=POSITION_OUTPUTS))
    code, said = files.take()
    assert (code, sorted(files.contents)) == (2, ["candidate", "model"])
    assert "surfaces.press-7.zones.gate: a bound of the force needs a scene" in said


def test_a_zone_of_another_surface_with_the_same_model_is_named(files: Files) -> None:
    """A service would not start with it."""
    (files.folder / "same.onnx").symlink_to("press-7.onnx")
    zone = "zones.gate = {from_mm = 1, to_mm = 9, least_force_n = 5}"
    for other in ("press-7.onnx", "same.onnx"):
        files.config.write_text(
            f"[surfaces.press-7]\nmodel = 'press-7.onnx'\n[surfaces.press-8]\nmodel = '{other}'\n{zone}\n"
        )
        files.candidate.write_bytes(content_of("new", outputs=POSITION_OUTPUTS))
        code, said = files.take()
        assert (code, files.model.read_bytes()) == (2, OLD)
        assert "surfaces.press-8.zones.gate: a bound of the force needs a scene" in said


def test_where_there_is_nothing_to_take_it_says_where_a_file_would_be(files: Files, command: Command) -> None:
    assert files.take() == (
        2,
        f"beamtouch-service: surface press-7: nothing to take: there is no {files.candidate}\n",
    )
    assert files.take_back() == (
        2,
        f"beamtouch-service: surface press-7: nothing to take back: there is no {files.previous}\n",
    )
    outcome = command("take", "--config", files.config, "press-8")
    assert outcome.stderr == "beamtouch-service: no surface is called 'press-8'; the surfaces are press-7\n"
    files.config.write_text("[surfaces.press-7]\n")
    assert "surface press-7 has no model; set surfaces.press-7.model" in files.take()[1]


def test_a_damaged_model_gives_way_and_is_kept_nowhere(files: Files) -> None:
    for name in ("candidate", "previous"):
        files.model.write_bytes(b"damaged")
        (files.candidate if name == "candidate" else files.previous).write_bytes(NEW)
        assert (files.take() if name == "candidate" else files.take_back())[0] == 0
        assert files.contents == {"model": NEW}
    files.model.unlink()
    files.candidate.write_bytes(NEW)
    assert files.take()[0] == 0
    assert files.contents == {"model": NEW}


class KilledError(BaseException):
    """Stands for the end of the process, or of the power, before a step."""


STEPS = ("replace", "unlink")


@pytest.mark.promise(
    "docs/how-to/rollout.md", "Whatever ends the command, the model file is the old one or the new one"
)
@pytest.mark.parametrize("word", ["take", "take-back", "take-back beside another candidate"])
def test_at_each_moment_there_is_a_whole_model_and_the_command_can_be_typed_again(
    files: Files, monkeypatch: pytest.MonkeyPatch, word: str
) -> None:
    """Each step that changes the folder is the last one once."""
    is_take, ends = word == "take", 0
    while True:
        for path in files.folder.glob("*onnx*"):
            path.unlink()
        files.model.write_bytes(OLD)
        (files.candidate if is_take else files.previous).write_bytes(NEW)
        if word.endswith("candidate"):
            files.candidate.write_bytes(NEWER)
        left = [ends]

        def end_before(step: str, left: list[int] = left) -> None:
            original = getattr(Path, step)

            def do(self: Path, *arguments: object, **options: object) -> object:
                if self.suffix == ".partial" and step == "unlink":
                    return original(self, *arguments, **options)  # a process that is killed leaves it there
                if not left[0]:
                    raise KilledError
                left[0] -= 1
                return original(self, *arguments, **options)

            patched.setattr(Path, step, do)

        with monkeypatch.context() as patched:
            for step in STEPS:
                end_before(step)
            try:
                assert (files.take() if is_take else files.take_back())[0] == 0
                break
            except KilledError:
                pass
        assert files.model.read_bytes() in (OLD, NEW)
        # Beside another candidate, the model that was taken back has no name of its own for a moment.
        assert ({NEW} if word.endswith("candidate") else {OLD, NEW}) <= set(files.contents.values())
        code, said = files.take() if is_take else files.take_back()
        assert (code == 0) != ("is the model in use already" in said)
        assert files.model.read_bytes() == NEW
        ends += 1
    assert ends >= 2


def test_the_names_survive_a_loss_of_power_in_their_order(files: Files, monkeypatch: pytest.MonkeyPatch) -> None:
    """The folder is written to the disk after each name that changes, before the next one does."""
    files.candidate.write_bytes(NEW)
    seen, sync = list[dict[str, bytes]](), os.fsync

    def note(descriptor: int) -> None:
        sync(descriptor)
        if Path(f"/proc/self/fd/{descriptor}").is_dir():
            seen.append({name: content for name, content in files.contents.items() if not name.startswith(".")})

    monkeypatch.setattr(os, "fsync", note)
    files.take()
    assert seen == [
        {"model": OLD, "candidate": NEW, "previous": OLD},
        {"model": NEW, "candidate": NEW, "previous": OLD},
        {"model": NEW, "previous": OLD},
    ]


@pytest.mark.parametrize(
    ("number", "told"),
    [
        (errno.ENOSPC, "No space left on device; type the command again"),
        (errno.EROFS, "Read-only file system; the command must be able to write there"),
        (errno.EACCES, "Permission denied; the command must be able to write there"),
    ],
    ids=["full", "read-only", "forbidden"],
)
def test_a_folder_that_cannot_be_written_is_named_and_nothing_changes(
    files: Files, monkeypatch: pytest.MonkeyPatch, number: int, told: str
) -> None:
    files.candidate.write_bytes(NEW)

    def fail(_self: Path, _target: object) -> None:
        raise OSError(number, os.strerror(number))

    monkeypatch.setattr(Path, "replace", fail)
    code, said = files.take()
    assert (code, files.contents) == (1, {"model": OLD, "candidate": NEW})
    assert said == f"beamtouch-service: {files.previous}: {told}\n"


def test_the_list_has_each_file_with_its_digest(files: Files, command: Command) -> None:
    files.candidate.write_bytes(b"hello")
    files.previous.write_bytes(NEW)
    outcome = command("models", "--config", files.config)
    lines = outcome.stdout.splitlines()
    digests = [sha256(one).hexdigest() for one in (OLD, b"hello", NEW)]
    assert [line.split()[:3] for line in lines] == [
        ["surface", "file", "sha256"],
        ["press-7", "model", digests[0][:12]],
        ["press-7", "candidate", digests[1][:12]],
        ["press-7", "previous", digests[2][:12]],
    ]
    assert lines[1].endswith(model_of("old").identity)
    assert "damaged or not an ONNX file" in lines[2]
    listed = json.loads(command("models", "--config", files.config, "--json").stdout)["surfaces"]["press-7"]
    assert [listed[kind]["sha256"] for kind in ("model", "candidate", "previous")] == digests
    files.candidate.unlink()
    files.previous.unlink()
    assert len(command("models", "--config", files.config).stdout.splitlines()) == 2
    listed = json.loads(command("models", "--config", files.config, "--json").stdout)["surfaces"]["press-7"]
    assert (listed["candidate"], listed["previous"]) == (None, None)
    files.config.write_text("[surfaces.press-7]\n")
    assert command("models", "--config", files.config).stdout == "no model files\n"
