"""Every mistake of the list is answered by its line, and docs/mistakes.md shows them as they are."""

import re
from collections.abc import Callable
from pathlib import Path

import pytest

from beamtouch_daemon import cli as daemon_cli
from beamtouch_models import cli as models_cli
from beamtouch_service import cli as service_cli
from common import mistakes
from common.mistakes import Mistake
from support.programs.in_process import command_of

MAINS: dict[str, Callable[[list[str]], int]] = {
    "design-sensors": models_cli.main,
    "beamtouch-daemon": daemon_cli.main,
    "beamtouch-service": service_cli.main,
}
PYTHON = re.compile(
    r"\b(None|True|False|str|dict|tuple|float|int|instance|valid (string|number|integer|dictionary|list))\b|_type|"
    r"Input should|Field required|Traceback|datetime|pydantic"
)


@pytest.mark.parametrize("mistake", mistakes.mistakes(), ids=lambda one: f"{one.kind}-{one.typed[:60]!r}")
def test_a_mistake_is_answered_in_one_line(
    mistake: Mistake, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    mistake.write(tmp_path)
    monkeypatch.chdir(tmp_path)
    program, *arguments = mistake.command
    done = command_of(MAINS[program], capsys)(*arguments)
    assert (done.returncode, done.stdout, done.stderr) == (2, "", f"{mistake.answer}\n")


def test_no_answer_speaks_python() -> None:
    for mistake in mistakes.mistakes():
        spoken = PYTHON.search(mistake.answer.replace("text needs quotes, and true and false are in lower case", ""))
        assert spoken is None, mistake.answer


def test_there_are_many_and_the_document_shows_them() -> None:
    assert len(mistakes.mistakes()) >= 40
    assert mistakes.DOCUMENT.read_text() == mistakes.document(), "run: make reference"
