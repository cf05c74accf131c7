"""The blocks of README, tutorial and guides run as they stand there, pasted whole and in order.

Each starts a rig, a service and a daemon, and waits for them as its reader does. So they are of the soak;
`test_commands_in_pages.py` holds their commands and files to the programs in each run.
"""

import json
import re
import shutil
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest

from support.pages.pasted import COMMANDS, ROOT, blocks_of, is_part_of, paste, shown_in
from support.programs.toolchain import made_once, need

pytestmark = [pytest.mark.long, pytest.mark.timeout(900)]

TUTORIAL = "docs/tutorial/index.md"
OF_A_PLATE = "docs/tutorial/plate.md"
GUIDES = {
    # The gains that were put in: +3, -3, -2 and +2 %.
    "docs/how-to/calibrate.md": [
        r"gain +s1 \+[23]\.\S+ \+- \S+ s2 -[23]\.\S+ \+- \S+ s3 -[12]\.\S+ \+- \S+ s4 \+[12]\."
    ],
    "docs/how-to/commissioning.md": [r"\nposition_mm 1[23]\d\.", r"\nposition_mm 2[67]\d\."],
    "docs/how-to/design.md": ["zero drift", "checked  the graph gives the 9 answers"],
    "docs/how-to/several-surfaces.md": ['"surface":"left"', '"surface":"right"'],
    "docs/how-to/two-hosts.md": ['"surface":"strip"', "urn:beamtouch:problem:unauthorized"],
    "docs/how-to/plc.md": [r"\| `identity` ", r"old: contact.*\nposition .* to .*\nforce .* to .*\ngate [iu]"],
    "docs/how-to/plates.md": ["heat from one side", r"the plate rings at 2\d"],
    "docs/how-to/zones.md": [r"gate +120 ", '"gate": "inside"'],
    "docs/how-to/python.md": ["( N at 1|nothing touches)"],
    "docs/how-to/drift.md": [
        "all zeros have moved together by",
        r"drift_um_per_min = 60",
        r"its zeros have drifted by up to \S+ um since the last tare",
        "hall: not tared: s1 -0",
    ],
    "docs/how-to/spare-part.md": [
        "channels-out",
        r"not tared: s2 \S+ mm from the last tare",
        r"gain +s1 \S+ \+- \S+ s2 \+[345]\.",
    ],
    "docs/how-to/backup.md": [r"(?s)folder/events\.db\n.*\"lifted_at\".*\"state\":\"contact\""],
    "docs/how-to/rollout.md": [
        r"strip +candidate +[0-9a-f]{12} ",
        '"is_worse":false',
        r"(?s)surface strip: (strip@\S+) \S+ \S+ instead of (strip@\S+) .*surface strip: \2 \S+ \S+ instead of \1 ",
    ],
    "docs/how-to/upgrade.md": ["checked  the graph gives the 9 answers", "posterior"],
}
"""What the guides print, among other things; patterns."""
SAMPLES = ("json", "text")
"""Words of the fences of what commands print."""
EXACT = re.compile(r"(sensors|error|answer|gate) .*\d")
"""Lines whose figures follow from the scene and the seed: a sample has them as they are printed."""
NUMBER = re.compile(r"\d+(?:\.\d+)?")
TROUBLES = "docs/how-to/troubleshooting.md"
NEED_A_DEVICE = {
    "the port is open, but not a byte came": "tests/daemon/test_resets.py",
    "none of them a frame": "tests/daemon/test_resets.py",
    "the device prints text: 'optiboot": "tests/daemon/test_resets.py",
    "is a serial converter": "tests/daemon/test_converters.py",
    "requests to unit 1 fail: exception 6, device busy": "tests/daemon/test_failing_requests.py",
    "beamtouch_requests_failed_total": "tests/daemon/test_failing_requests.py",
    "its zeros have drifted by up to": "tests/daemon/test_warm_hall.py",
    "all zeros have moved together": "tests/service/test_alarms.py",
    "times what is stated": "tests/daemon/test_warm_hall.py",
    "no intact frame has come since the port was opened": "tests/daemon/test_debug_log.py",
    "other units answer, so the line works": "tests/daemon/test_debug_log.py",
    "the late answer of unit 1 to the request before, read ": "tests/daemon/test_debug_log.py",
    "the request itself, which an adapter echoes": "tests/daemon/test_debug_log.py",
    "the beginning of an answer of unit 1, which breaks off": "tests/daemon/test_debug_log.py",
    "an answer of unit 1 with a wrong checksum, and none was intact": "tests/daemon/test_debug_log.py",
    "an answer of unit 1 with a wrong checksum, where others were intact": "tests/daemon/test_debug_log.py",
    "a second answer of unit 1 to one request, unlike the first": "tests/daemon/test_debug_log.py",
    "a second answer of unit 1 to one request, equal to the first": "tests/daemon/test_debug_log.py",
    "another master is on the line, at another baud rate or parity": "tests/daemon/test_debug_log.py",
    "an intact answer of unit 1, to an earlier request": "tests/daemon/test_debug_log.py",
    "a request of another master to unit 1": "tests/daemon/test_debug_log.py",
    "an intact frame with function 6": "tests/daemon/test_debug_log.py",
}
"""Words of quoted sentences that the rig does not cause: of devices that fail, or of hours. Others hold them."""
ON_A_SLOW_MACHINE = {"the line to the service is thin": "tests/daemon/test_thin_line.py"}
"""The same for those that depend on how quickly this machine answers."""
PROGRAMS = "curl|sudo|systemctl|journalctl|beamtouch-|design-"
"""What commands begin with."""
RUN_ELSEWHERE = {"docs/how-to/calibrate-without-loads.md": "tests/system/test_self_calibration.py"}
CONSOLE = {
    "README.md": 1,  # installation
    "docs/how-to/adc-module.md": 4,  # a device
    "docs/how-to/backup.md": 1,  # packages, systemd and root
    "docs/how-to/calibrate.md": 1,  # a person puts weights on the beam
    "docs/how-to/containers.md": 8,
    "docs/how-to/debian.md": 9,  # packages, systemd and root
    "docs/how-to/design.md": 1,  # minutes on all cores
    "docs/how-to/drift.md": 1,  # a line that is not that of the guide
    "docs/how-to/measured.md": 4,  # a person puts loads on the structure
    "docs/how-to/plates.md": 2,  # it takes a minute, and known loads
    "docs/how-to/mqtt.md": 3,  # a broker
    "docs/how-to/micropython-board.md": 2,  # a board
    "docs/how-to/opcua.md": 1,  # the name of a host
    "docs/how-to/rollout.md": 3,  # hosts, a repository and a broker
    "docs/how-to/sweeps.md": 1,  # a cluster
    "docs/how-to/time-series.md": 1,  # another database
    "docs/how-to/troubleshooting.md": 2,  # systemd, a serial line
    "docs/how-to/two-hosts.md": 5,  # systemd and root
    "docs/how-to/upgrade.md": 1,  # systemd and root
    "docs/reference/rig.md": 2,  # they run until a person stops them
    "docs/reference/schemas.md": 1,  # a file for an editor
}
"""Numbers of blocks that cannot run in a test."""


@pytest.fixture
def followed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder in which somebody has followed the tutorial, and the file `printed`."""
    need("curl")
    return made_once(tmp_path_factory, "tutorial", _follow_tutorial)


@pytest.fixture
def strip(followed: Path, tmp_path: Path) -> Path:
    """A copy of the folder that the tutorial has left."""
    return Path(shutil.copytree(followed / "strip", tmp_path / "strip", ignore=shutil.ignore_patterns("*.samples*")))


def _follow_tutorial(folder: Path) -> None:
    (folder / "printed").write_text(paste(TUTORIAL, folder))


@pytest.mark.soak
def test_the_readme_ends_in_a_contact(tmp_path: Path) -> None:
    need("curl")

    printed = paste("README.md", tmp_path)

    assert_samples_are_like(printed, "README.md")


@pytest.mark.soak
def test_the_tutorial_ends_in_the_contact_that_it_shows(followed: Path) -> None:
    printed = (followed / "printed").read_text()

    assert_samples_are_like(printed, TUTORIAL)
    (contact,) = [one for one in answers_in(printed) if "position_mm" in one][-1:]
    assert contact["state"] == "contact"
    assert contact["position_low_mm"] <= contact["position_mm"] <= contact["position_high_mm"]
    assert abs(contact["position_mm"] - 150) < 20


@pytest.mark.soak
def test_the_tutorial_of_a_plate_ends_in_a_contact_where_the_load_lies(tmp_path: Path) -> None:
    need("curl")

    contact = [one for one in answers_in(paste(OF_A_PLATE, tmp_path)) if "x_mm" in one][-1]

    assert contact["state"] == "contact"
    assert abs(contact["x_mm"] - 300) < 3
    assert abs(contact["y_mm"] - 80) < 3


@pytest.mark.soak
def test_the_tutorial_shows_the_figures_that_build_prints(followed: Path) -> None:
    printed = (followed / "printed").read_text().splitlines()
    (sample,) = [block.text for block in blocks_of(TUTORIAL) if block.word == "text"]

    for line in sample.splitlines():
        (same,) = [one for one in printed if NUMBER.sub("#", one) == NUMBER.sub("#", line)]
        shown = figures_in(line)
        near = pytest.approx(shown, abs=1.0) if line.startswith("sensors") else pytest.approx(shown, rel=0.2)
        assert figures_in(same) == near, "\n".join(printed)


@pytest.mark.soak
@pytest.mark.parametrize("page", GUIDES)
def test_a_guide_runs_after_the_tutorial(page: str, strip: Path) -> None:
    need("openssl")

    printed = paste(page, strip)

    assert all(re.search(words, printed) for words in GUIDES[page]), printed
    assert_samples_are_like(printed, page)

    if page == "docs/how-to/calibrate.md":
        assert_gains_are_found(printed)


def assert_gains_are_found(printed: str) -> None:
    """Check that the gains which the guide gives to the rig are found within the errors that the fit states."""
    (line,) = re.findall(r"^gain .* %$", printed, re.MULTILINE)
    found = [(float(gain), float(error)) for gain, error in re.findall(r" s\d (\S+) \+- ([\d.]+)", line)]
    for (gain, error), real in zip(found, (3.0, -3.0, -2.0, 2.0), strict=True):
        assert abs(gain - real) < 5 * error < 5, line


@pytest.mark.soak
def test_the_programs_say_what_troubleshooting_quotes(strip: Path) -> None:
    text = "".join((ROOT / TROUBLES).read_text().split("```")[::2])
    quoted = [" ".join(words.split()) for words in re.findall(r"`([^`]+)`", text)]
    sentences = [words for words in quoted if len(words) > 30 and " " in words and not re.match(PROGRAMS, words)]

    printed = paste(TROUBLES, strip)

    line = " ".join(printed.split())
    assert len(sentences) > 10
    silent = [one for one in sentences if not re.search(any_figures(one), line)]
    elsewhere = NEED_A_DEVICE | ON_A_SLOW_MACHINE
    assert [one for one in silent if not any(words in one for words in elsewhere)] == [], printed
    assert [words for words in NEED_A_DEVICE if not any(words in one for one in silent)] == []
    for words, file in elsewhere.items():
        assert words in (ROOT / file).read_text(), (words, file)
    assert_samples_are_like(printed, TROUBLES)


def any_figures(sentence: str) -> str:
    """Return the pattern of a sentence with other figures, addresses and times."""
    return " ".join(r"\S+" if re.search(r"\d", word) else re.escape(word) for word in sentence.split())


def test_every_page_with_commands_is_run_by_a_test() -> None:
    pages = [ROOT / "README.md", *(ROOT / "docs").rglob("*.md")]
    names = [str(page.relative_to(ROOT)) for page in pages]
    with_commands = {name for name in names if any(block.word == COMMANDS for block in blocks_of(name))}
    console = {name: sum(block.word == "console" for block in blocks_of(name)) for name in names}

    assert with_commands == {"README.md", TUTORIAL, OF_A_PLATE, TROUBLES, *GUIDES, *RUN_ELSEWHERE}
    assert {name: number for name, number in console.items() if number} == CONSOLE
    for name in (name for name in names if name.startswith(("README", "docs/tutorial", "docs/how-to"))):
        assert all(block.word for block in blocks_of(name)), f"{name}: a block without a word"


def figures_in(line: str) -> list[float]:
    return [float(number) for number in NUMBER.findall(line)]


def answers_in(printed: str) -> list[dict[str, Any]]:
    """Return the JSON objects that commands have printed, which may follow each other in one line."""
    found, decoder, start = [], json.JSONDecoder(), printed.find('{"')
    while start >= 0:
        answer, end = decoder.raw_decode(printed, start)
        found.append(answer)
        start = printed.find('{"', end)
    return found


def assert_samples_are_like(printed: str, page: str) -> None:
    """Check samples after commands.

    JSON has members of something that they printed, a problem also its words; lines have its first words, or are
    exact.
    """
    pairs = list(pairwise(blocks_of(page)))
    samples = {word: [one for before, one in pairs if (before.word, one.word) == (COMMANDS, word)] for word in SAMPLES}
    answers, expected = answers_in(printed), [shown_in(sample.text) for sample in samples["json"]]
    assert all(any(is_part_of(sample, answer) for answer in answers) for sample in expected), printed
    assert all(sample in answers for sample in expected if "detail" in sample), printed
    begun = first_words(printed)
    assert all(first_words(sample.text) <= begun for sample in samples["text"]), printed
    exact = [line for sample in samples["text"] for line in lines_of(sample.text) if EXACT.match(line)]
    assert [line for line in exact if line not in lines_of(printed)] == []


def lines_of(text: str) -> list[str]:
    """Return the lines of a text with one space between two words."""
    return [" ".join(line.split()) for line in text.splitlines()]


def first_words(text: str) -> set[str]:
    """Return the words that lines begin with; any day is the same."""
    return {re.sub(r"^\d{4}-\d\d-\d\d$", "DAY", line.split()[0]) for line in text.splitlines() if line.strip()}
