"""The configuration and the files that it includes: what is valid, and one line for what is not.

`docs/mistakes.md` has further errors, word for word.
"""

import asyncio
import json
import tomllib
from collections.abc import Callable
from pathlib import Path

import pytest
from pydantic import ValidationError

from beamtouch_daemon.config.file import load_config
from beamtouch_daemon.config.settings import Config, Surface
from beamtouch_daemon.config.sources import ModbusTcp
from beamtouch_daemon.processing.pipeline import Pipeline
from beamtouch_daemon.sources.reading import Reading
from support.surfaces import configs
from support.surfaces.wrong_numbers import numbers_in, with_value, with_wrong_numbers

from .conftest import Refused
from .devices import pymodbus_server
from .process import command

EXAMPLE = Path(__file__).parents[2] / "daemon" / "daemon.example.toml"
TABLES = Surface.model_json_schema()["properties"]
KINDS = [(table, kind) for table in ("source", "filter") for kind in TABLES[table]["discriminator"]["mapping"]]
"""Each kind that a table can have; the example shows all of them."""
EXTREMES = [sign * 10.0**power for sign in (-1, 1) for power in (-320, -300, -100, -12, -3, 3, 6, 12, 100, 300, 308)]
TRACKING = "# [surfaces.bench.zero_tracking]"
Complaint = Callable[[Path], str]


@pytest.fixture
def complaint(refused: Refused) -> Complaint:
    """A function from a configuration to what `check` says of it, behind its path."""
    return lambda path: refused("check", path).removeprefix(f"{path}: ")


def uncommented(block: str) -> str:
    return "\n".join(line.removeprefix("# ") for line in block.splitlines())


def choose(table: str, kind: str) -> str:
    """Return the example with another of the kinds that it shows in comments."""
    before, after = EXAMPLE.read_text().split(f"[surfaces.bench.{table}]\n")
    block, rest = after.split("\n# --- ", 1)
    (chosen,) = [part for part in map(uncommented, block.split("\n\n")) if part.startswith(f'kind = "{kind}"')]
    return f"{before}[surfaces.bench.{table}]\n{chosen}\n# --- {rest}"


def test_the_example_is_valid_with_its_zero_tracking_and_its_table_too(tmp_path: Path) -> None:
    surface = load_config(EXAMPLE).surfaces["bench"]
    assert isinstance(surface.source, ModbusTcp)
    filtered = {"kind": "growing-mean", "max_mean_ms": 1000, "window": 4, "spike_mm": 0.02}
    assert surface.filter.model_dump(exclude_unset=True) == filtered
    assert (surface.channel_names, surface.zero_tracking) == (["s1", "s2"], None)
    before, after = EXAMPLE.read_text().split(TRACKING)
    block, rest = after.split("\n\n", 1)
    line = "gain_mm_per_count = -0.0001            # gap = offset + gain x counts; of mm, 1 or -1\noffset_mm = 4.5\n"
    for key in ("table =", "counts_range", "stuck_after"):
        rest = rest.replace(f"# {key}", key)
    path = tmp_path / "daemon.toml"
    path.write_text(f"{before}{TRACKING[2:]}{uncommented(block)}\n\n{rest.replace(line, '')}")
    surface = load_config(path).surfaces["bench"]
    assert surface.zero_tracking is not None
    assert surface.zero_tracking.model_dump() == {"drift_um_per_min": 5, "max_mm": 0.1}
    first, second = surface.channels
    assert (first.table, second.table) == (((5000, 4.0), (20000, 2.4), (35000, 1.0)), None)
    assert (first.counts_range, first.stuck_after_ms) == ((-8388608, 8388607), 500)


@pytest.mark.parametrize(("table", "kind"), KINDS)
def test_every_kind_in_the_example_is_valid_and_only_a_number_is_a_number(table: str, kind: str) -> None:
    content, context = tomllib.loads(choose(table, kind)), {"directory": Path()}
    surface = Config.model_validate(content, context=context).surfaces["bench"]
    assert getattr(surface, table).kind == kind
    taken = []
    for what, wrong in with_wrong_numbers(content):
        try:
            Config.model_validate(wrong, context=context)
        except ValidationError:
            continue
        taken.append(what)
    assert not taken


@pytest.mark.parametrize("kind", [kind for table, kind in KINDS if table == "filter"])
def test_each_number_is_refused_or_makes_samples_without_overflow(kind: str) -> None:
    content, context = tomllib.loads(choose("filter", kind)), {"directory": Path()}
    accepted = 0
    for place in numbers_in(content["surfaces"]):
        for number in EXTREMES:
            changed = with_value(content, ("surfaces", *place), number)
            try:
                config = Config.model_validate(changed, context=context)
            except ValidationError:
                continue
            for surface in config.surfaces.values():
                rows = [tuple(4000.0 * step + 1000 for _ in surface.channels) for step in range(8)]
                readings = [Reading(index / max(surface.rate_hz, 1.0), row) for index, row in enumerate(rows)]
                taken = Pipeline(surface).process(readings, 1e9)
                assert taken, (place, number)
            accepted += 1
    assert accepted > len(EXTREMES)


def test_without_a_filter_table_every_reading_is_a_sample(tmp_path: Path) -> None:
    text = configs.surface().replace('[surfaces.bench.filter]\nkind = "moving-average"\nwindow = 1\n', "")
    assert load_config(configs.write(tmp_path, text)).surfaces["bench"].filter.kind == "none"


@pytest.mark.promise("docs/reference/daemon-configuration.md", "default: NAME.tare.json beside the configuration.")
@pytest.mark.promise(
    "docs/how-to/several-surfaces.md",
    "Relative paths in a file start from that file; a tare file without `tare_file` stays beside `daemon.toml`.",
)
def test_paths_start_from_the_file_that_states_them(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    tared = configs.surface("one").replace("rate_hz", 'tare_file = "one.json"\nrate_hz', 1)
    path = including(tmp_path, configs.surface(), a=tared, b=configs.surface("two"))
    monkeypatch.chdir(tmp_path)
    for config in (load_config(path), load_config(Path("daemon.toml"))):
        assert config.tare_file("bench") == tmp_path / "bench.tare.json"
        assert config.tare_file("one") == tmp_path / "surfaces" / "one.json"
        assert config.tare_file("two") == tmp_path / "two.tare.json"  # as before the surface had a file of its own
        assert config.read_token() == "swordfish-of-the-tests-and-longer"


GROWING = '"growing-mean"\nmax_mean_ms = '
WINDOW = '"moving-average"\nwindow = 1'
SERIAL = configs.serial("/dev/x")


@pytest.mark.parametrize(
    ("source", "old", "new", "expected"),
    [
        ("", "register = 0\n", "", "surfaces.bench: channel s1: state its register"),
        ("", "register = 0", "input = 0", "channel s1: input needs the source's module; state the register"),
        (
            "",
            "port = 502",
            'port = 502\nmodule = "x"',
            "source.module: there is no module x; choose one of adam-6017, ",
        ),
        ("", "port = 502", 'port = 502\nmodule = "waveshare-8ch"', "module waveshare-8ch speaks modbus-rtu"),
        ("", "port = 502", 'port = 502\nmodule = "adam-6017"', "rate_hz: adam-6017 converts 12.5 times a second"),
        ("", 'name = "s2"', 'name = "s1"', "surfaces.bench: two channels have the same name s1"),
        (
            "",
            "register = 0",
            'register = 0\ntype = "f32"',
            "channels s1 and s2 overlap: a value of type f32 takes 2 registers; correct register, or type",
        ),
        (
            "",
            "register = 0",
            'register = 0\ntype = "i16"\nadc_bits = 16',
            "channel s1: adc_bits = 16: counts of i16 end at 32767; remove it, or correct type",
        ),
        (
            "",
            "register = 1",
            'register = 1\ntype = "f64"\nadc_bits = 12',
            "channel s2: adc_bits is for whole numbers, not f64; remove it, or state counts_range",
        ),
        ("", "[1.0, 4.0]", "[4.0, 1.0]", "range_mm must be [smaller, larger], not [4.0, 1.0]"),
        (
            "",
            f"rate_hz = 200.0\n[surfaces.bench.source]\n{configs.tcp(502)}\n[surfaces.bench.filter]\nkind = {WINDOW}",
            f"rate_hz = 200.0\nnoise_mm = 0.003\n[surfaces.bench.source]\n{configs.tcp(502)}\n"
            f"[surfaces.bench.filter]\nkind = {GROWING}60000",
            "surfaces.bench: filter.max_mean_ms: at most 50000, the time of 10000 readings",
        ),
        ("", "rate_hz", "slowest_period_ms = 20001\nrate_hz", "slowest_period_ms: at most 4000 readings, 20 s"),
        ("", "http://", "http://daemon:secret@", "publish.url: must name no user"),
        (SERIAL, "register = 0", "register = 0\nunit = 2", "unit, host and type are for Modbus"),
        (SERIAL, "rate_hz = 200.0", "rate_hz = 12.5", "rate_hz must be a whole number for a serial source"),
        (configs.rtu("/dev/x"), "register = 0", 'register = 0\nhost = "x"', "channel s1: host is for modbus-tcp"),
    ],
)
def test_an_error_is_one_line_with_the_key(
    tmp_path: Path, complaint: Complaint, source: str, old: str, new: str, expected: str
) -> None:
    path = configs.write(tmp_path, configs.surface(source=source or configs.tcp(502)))
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new, 1))
    assert expected in complaint(path)


@pytest.mark.promise("docs/how-to/several-surfaces.md", "A port with the serial protocol serves one surface.")
@pytest.mark.promise(
    "docs/reference/daemon-configuration.md",
    "Surfaces may share a bus if they state the same line settings.",
)
@pytest.mark.parametrize(
    ("surfaces", "expected"),
    [
        ({"a": configs.rtu("/dev/x"), "b": configs.rtu("/dev/x")}, ""),
        ({"a": configs.rtu("/dev/x"), "b": SERIAL}, "2 surfaces use /dev/x (a, b); a serial port serves one surface"),
        (
            {"a": configs.rtu("/dev/x"), "b": f"{configs.rtu('/dev/x')}\nbaud = 9600"},
            "surfaces on /dev/x (a, b) state different baud, parity, stop_bits or silence_ms; make them equal",
        ),
        ({}, "surfaces is missing; add it"),
    ],
)
def test_surfaces_share_a_bus_only_if_they_agree_on_its_line(
    tmp_path: Path, complaint: Complaint, surfaces: dict[str, str], expected: str
) -> None:
    path = configs.write(tmp_path, *(configs.surface(name, source) for name, source in surfaces.items()))
    assert expected == (complaint(path) if expected else "")
    assert expected or load_config(path).surfaces.keys() == surfaces.keys()


@pytest.mark.promise(
    "docs/reference/daemon-configuration.md",
    "its channels may then state `input` instead of `register`.",
)
def test_a_channel_may_be_of_unit_0(tmp_path: Path) -> None:
    source = f"{configs.tcp(502)}\nunit = 7"
    text = configs.surface(source=source, registers=(3, 3)).replace("register = 3", "register = 3\nunit = 0", 1)
    surface = load_config(configs.write(tmp_path, text)).surfaces["bench"]
    assert [surface.place_of(channel)[1:] for channel in surface.channels] == [(0, 3), (7, 3)]


def test_an_input_of_a_module_has_its_register_and_its_limits(tmp_path: Path, complaint: Complaint) -> None:
    source = f'{configs.tcp(502)}\nmodule = "iologik-e1240"'
    text = configs.surface(source=source, rate_hz=10.0).replace("register = ", "input = ")
    surface = load_config(configs.write(tmp_path, text)).surfaces["bench"]
    assert [surface.place_of(channel) for channel in surface.channels] == [("127.0.0.1", 1, n) for n in (0, 1)]
    assert isinstance(surface.source, ModbusTcp)
    assert (surface.source.function_code, surface.source.max_request_registers) == (4, 8)
    beyond = configs.write(tmp_path, text.replace("input = 1", "input = 8"))
    assert complaint(beyond) == "surfaces.bench: channel s2: the module has inputs 0 to 7"


@pytest.mark.parametrize(
    "host",
    [
        "plc..plant",
        "plc" * 30,
        "a b",
        "plc\\u0000",
        "plc,other",
        "192.168.0.20:502",
        "[::1]",
        "tcp://plc",
        "daemon@plc",
    ],
)
def test_a_host_that_cannot_be_is_refused_wherever_one_is_stated(
    tmp_path: Path, complaint: Complaint, host: str
) -> None:
    path = configs.write(tmp_path, configs.surface(source=configs.tcp(502, host)))
    assert complaint(path).startswith("surfaces.bench.source.host: must be the name or address of a host")
    channel = configs.surface().replace("register = 1", f'register = 1\nhost = "{host}"')
    assert complaint(configs.write(tmp_path, channel)).startswith("surfaces.bench.channels[1].host: must be the name")
    if ":" not in host:
        assert "publish.url: must " in complaint(configs.write(tmp_path, configs.surface(), url=f"http://{host}:8420"))


@pytest.mark.parametrize("path", ["/../beams", "/./", "//", "/two words", "/beams?x=1", "/beams#x", "/a%2", "/contact"])
def test_a_path_that_cannot_be_one_of_a_service_is_refused(tmp_path: Path, complaint: Complaint, path: str) -> None:
    config = configs.write(tmp_path, configs.surface(), url=f"http://127.0.0.1:8420{path}")
    assert complaint(config).startswith("publish.url: must ")


@pytest.mark.parametrize("path", ["", "/", "/beams", "/beams/", "/hall-1/press%207/..x"])
def test_the_service_may_be_below_a_path_of_a_proxy(tmp_path: Path, path: str) -> None:
    config = load_config(configs.write(tmp_path, configs.surface(), url=f"https://plant.example{path}"))
    assert config.publish.url == f"https://plant.example{path}".rstrip("/")


@pytest.mark.parametrize("host", ["192.168.0.20", "::1", "fe80::1%eth0", "plc", "plc.plant.", "prüfstand.example"])
def test_a_host_that_can_be_is_taken(tmp_path: Path, host: str) -> None:
    config = load_config(configs.write(tmp_path, configs.surface(source=configs.tcp(502, host))))
    assert getattr(config.surfaces["bench"].source, "host", None) == host


def including(folder: Path, *own: str, **files: str) -> Path:
    """Write a configuration that includes `surfaces/*.toml`, with these files in the folder."""
    path = configs.write(folder, *own)
    path.write_text(f'include = ["surfaces/*.toml"]\n{path.read_text()}')
    (folder / "surfaces").mkdir(exist_ok=True)
    for name, text in files.items():
        (folder / "surfaces" / f"{name}.toml").write_text(text)
    return path


@pytest.mark.promise(
    "docs/how-to/several-surfaces.md",
    "A surface in two files, a pattern that matches no file, and a wrong key are refused with the name of the file.",
)
@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("[surfaces", "{file}: not valid TOML: "),
        (configs.PUBLISH, "{file}: publish belongs in {path}; a file that is included has only [surfaces.NAME] tables"),
        ("", "{file}: surfaces is missing; add it"),
        ("surfaces = 3", "{file}: surfaces: must be"),
        (configs.surface("bench"), "{file}: surfaces.bench is also in {path}; remove one of the two"),
        (configs.surface("other"), "{file}: surfaces.other is also in {other}; remove one of the two"),
        (
            configs.surface("late", SERIAL),
            "{path}: 2 surfaces use /dev/x (other in {other}, late in {file}); a serial port serves one surface",
        ),
    ],
)
def test_what_is_wrong_is_said_with_the_file_and_the_key(
    tmp_path: Path, complaint: Complaint, text: str, said: str
) -> None:
    path = including(tmp_path, configs.surface("bench"), a=configs.surface("other", SERIAL), z=text)
    expected = said.format(file=tmp_path / "surfaces" / "z.toml", path=path, other=tmp_path / "surfaces" / "a.toml")
    assert complaint(path).startswith(expected.removeprefix(f"{path}: "))


@pytest.mark.promise("docs/how-to/several-surfaces.md", "a pattern that matches no file")
@pytest.mark.parametrize(
    ("include", "said"),
    [
        ('["surfacs/*.toml"]', "include: no file matches 'surfacs/*.toml'; correct it, for example to surfaces/*.toml"),
        ('[""]', "include[0]: must be the path of a file"),
        (f'["{"x" * 300}"]', f"include: no file matches '{'x' * 300}'; correct it"),
        ('["surfaces/"]', "include: no file matches 'surfaces/'; correct it, for example to surfaces/*.toml"),
        ('["a\\u0000b"]', "include[0]: must be the path of a file"),
        ('"surfaces/*.toml"', "include: must be "),
        ("[3]", "include[0]: must be "),
    ],
)
def test_a_wrong_pattern_is_said(tmp_path: Path, complaint: Complaint, include: str, said: str) -> None:
    path = including(tmp_path, configs.surface("bench"), a=configs.surface("other"))
    path.write_text(path.read_text().replace('["surfaces/*.toml"]', include))
    assert complaint(path).startswith(said)


@pytest.mark.promise(
    "docs/how-to/several-surfaces.md",
    "Hidden files are left out.",
    "`beamtouch-daemon check daemon.toml` shows the file of each surface.",
)
@pytest.mark.anyio
async def test_the_surfaces_of_all_files_are_read_once_and_check_shows_the_file_of_each(tmp_path: Path) -> None:
    async with pymodbus_server([20_000, 21_000]) as port:
        bench, one, two = (configs.surface(name, configs.tcp(port)) for name in ("bench", "one", "two"))
        path = including(tmp_path, bench, b=two, a=one)
        surfaces = tmp_path / "surfaces"
        (surfaces / ".c.toml.swp.toml").write_text("unfinished [")  # an editor's
        (surfaces / "notes.txt").write_text("not a surface")
        (surfaces / "old.toml").mkdir()
        patterns = f'"surfaces/*.toml", "*/a.toml", "{tmp_path}/surf*/**/*.toml"'
        path.write_text(path.read_text().replace('"surfaces/*.toml"', patterns))
        table, report = await asyncio.gather(command("check", path), command("check", path, "--json"))
    assert (table.code, report.code) == (0, 0)
    files = {"bench": str(path), "one": str(surfaces / "a.toml"), "two": str(surfaces / "b.toml")}
    shown = [line.split()[-1] for line in table.out.splitlines() if " good " in line]
    assert shown == [file for file in files.values() for _channel in range(2)]
    assert {name: found["file"] for name, found in json.loads(report.out)["surfaces"].items()} == files
