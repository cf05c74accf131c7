"""The configuration: what it is, and one clear line for everything that is wrong with it."""

import tomllib
from pathlib import Path

import pytest
from pydantic import ValidationError

from beamtouch_common.errors import FailedError, InputError
from beamtouch_daemon.config.file import load_config
from beamtouch_daemon.config.settings import Config
from beamtouch_daemon.config.signal import GrowingMean, MovingAverage, NoFilter, ZeroTracking
from beamtouch_daemon.config.sources import ModbusRtu, ModbusTcp, SerialLine
from wrong_numbers import with_wrong_numbers

from . import configs

EXAMPLE = Path(__file__).parents[2] / "daemon" / "daemon.example.toml"


def complaint(path: Path) -> str:
    with pytest.raises(InputError) as caught:
        load_config(path)
    text = str(caught.value)
    assert "\n" not in text
    return text.removeprefix(f"{path}: ")


def changed(folder: Path, old: str, new: str) -> str:
    """Return the complaint about a good configuration in which one thing was changed."""
    path = configs.write(folder, configs.surface())
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new, 1))
    return complaint(path)


def test_the_example_is_valid() -> None:
    config = load_config(EXAMPLE)
    surface = config.surfaces["bench"]
    assert isinstance(surface.source, ModbusTcp)
    assert surface.filter == GrowingMean(kind="growing-mean", max_mean_ms=1000, window=4, spike_mm=0.02)
    assert surface.channel_names == ["s1", "s2"]


@pytest.mark.parametrize(
    ("kind", "expected"), [("modbus-tcp", ModbusTcp), ("modbus-rtu", ModbusRtu), ("serial", SerialLine)]
)
def test_every_kind_of_source_in_the_example_is_valid(tmp_path: Path, kind: str, expected: type) -> None:
    config = load_config(choose(tmp_path, "source", kind))
    assert isinstance(config.surfaces["bench"].source, expected)


@pytest.mark.parametrize(
    ("kind", "expected"),
    [
        ("moving-average", MovingAverage),
        ("growing-mean", GrowingMean),
        ("none", NoFilter),
    ],
)
def test_every_kind_of_filter_in_the_example_is_valid(tmp_path: Path, kind: str, expected: type) -> None:
    path = choose(tmp_path, "filter", kind)
    assert isinstance(load_config(path).surfaces["bench"].filter, expected)


def test_the_zero_tracking_in_the_example_is_valid(tmp_path: Path) -> None:
    before, after = EXAMPLE.read_text().split("# [surfaces.bench.zero_tracking]")
    block, rest = after.split("\n\n", 1)
    lines = "\n".join(line.removeprefix("# ") for line in block.splitlines())
    path = tmp_path / "daemon.toml"
    path.write_text(f"{before}[surfaces.bench.zero_tracking]{lines}\n\n{rest}".replace("# stuck_after", "stuck_after"))
    surface = load_config(path).surfaces["bench"]
    assert surface.zero_tracking == ZeroTracking(band_mm=0.006, rate_mm_per_min=0.01, max_mm=0.05)
    assert [channel.stuck_after_ms for channel in surface.channels] == [500, None]
    assert load_config(EXAMPLE).surfaces["bench"].zero_tracking is None


def test_the_table_in_the_example_is_valid_instead_of_gain_and_offset(tmp_path: Path) -> None:
    text = EXAMPLE.read_text()
    line = "gain_mm_per_count = -0.0001            # gap = offset + gain x counts\noffset_mm = 4.5\n"
    assert line in text
    path = tmp_path / "daemon.toml"
    path.write_text(text.replace(line, "").replace("# table =", "table =").replace("# counts_range", "counts_range"))
    first, second = load_config(path).surfaces["bench"].channels
    assert first.table == ((5000, 4.0), (20000, 2.4), (35000, 1.0))
    assert first.counts_range == (-8388608, 8388607)
    assert second.table is None


def choose(folder: Path, table: str, kind: str) -> Path:
    """Write the example with another of the kinds that it shows in comments."""
    before, after = EXAMPLE.read_text().split(f"[surfaces.bench.{table}]\n")
    block, rest = after.split("\n# --- ", 1)
    paragraphs = [
        "\n".join(line.removeprefix("# ") for line in paragraph.splitlines()) for paragraph in block.split("\n\n")
    ]
    (chosen,) = [paragraph for paragraph in paragraphs if paragraph.startswith(f'kind = "{kind}"')]
    path = folder / "daemon.toml"
    path.write_text(f"{before}[surfaces.bench.{table}]\n{chosen}\n# --- {rest}")
    return path


def test_without_a_filter_table_every_reading_is_a_sample(tmp_path: Path) -> None:
    path = configs.write(tmp_path, configs.surface())
    path.write_text(path.read_text().replace('[surfaces.bench.filter]\nkind = "moving-average"\nwindow = 1\n', ""))
    assert load_config(path).surfaces["bench"].filter == NoFilter()


def test_paths_are_relative_to_the_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = configs.write(
        tmp_path, configs.surface(), configs.surface("press-7").replace("rate_hz", 'tare_file = "/t"\nrate_hz')
    )
    monkeypatch.chdir("/")
    config = load_config(path)
    assert config.tare_file("bench") == tmp_path / "bench.tare.json"
    assert config.tare_file("press-7") == Path("/t")
    assert config.read_token() == "swordfish-of-the-tests-and-longer"


@pytest.mark.parametrize(
    ("old", "new", "expected"),
    [
        ("window = 1", "windw = 1", "unknown key surfaces.bench.filter.windw; did you mean window?"),
        ("port = 502", "prt = 502", "unknown key surfaces.bench.source.prt; did you mean port?"),
        ("[publish]", "x = 1\n[publish]", "unknown key x; remove it or correct its spelling"),
        ("rest_gap_mm = 2.5\n", "", "surfaces.bench.channels[0].rest_gap_mm is missing; add it"),
        (
            "offset_mm = 4.5\n",
            "",
            "surfaces.bench.channels[0]: offset_mm missing; give gain_mm_per_count with offset_mm",
        ),
        ("rate_hz = 200.0", "rate_hz = -1.0", "surfaces.bench.rate_hz: must be more than 0"),
        ("rate_hz = 200.0", "rate_hz = nan", "surfaces.bench.rate_hz: must be a finite number"),
        ("rate_hz = 200.0", 'rate_hz = "fast"', "surfaces.bench.rate_hz: must be a number"),
        ("register = 0", "register = 65536", "channels[0].register: must be at most 65535"),
        ("register = 1", "register = 0", "surfaces.bench: two channels have the same register 0"),
        ("register = 0\n", "", "surfaces.bench: channel s1: state its register"),
        (
            "register = 0",
            "input = 0",
            "surfaces.bench: channel s1: input needs the source's module; state the register",
        ),
        ("port = 502", 'port = 502\nmodule = "x"', "surfaces.bench.source.module: there is no module x; choose one of"),
        ("port = 502", 'port = 502\nmodule = "waveshare-8ch"', "module waveshare-8ch speaks modbus-rtu"),
        (
            "port = 502",
            'port = 502\nmodule = "adam-6017"',
            "rate_hz: adam-6017 converts 12.5 times a second; a higher",
        ),
        ("port = 502", "port = 502\nfunction = 5", "surfaces.bench.source.function: must be 3 or 4"),
        ("register = 0", 'register = 0\ntype = "u8"', 'channels[0].type: must be "u16", "i16", "u32", "i32"'),
        ('name = "s2"', 'name = "s1"', "surfaces.bench: two channels have the same name s1"),
        ("[1.0, 4.0]", "[4.0, 1.0]", "channels[0]: range_mm must be [smaller, larger], not [4.0, 1.0]"),
        ("= -0.0001", "= 0", "channels[0].gain_mm_per_count: must not be 0"),
        ("http://127.0.0.1:8420", "127.0.0.1:8420", "publish.url: must look like http://127.0.0.1:8420"),
        ("http://127.0.0.1:8420", "http://127.0.0.1:84200", "publish.url: must look like http://127.0.0.1:8420"),
        ('"modbus-tcp"', '"modbus"', 'bench.source.kind: must be "modbus-tcp", "modbus-rtu" or'),
        (
            '"moving-average"',
            '"growing"',
            'surfaces.bench.filter.kind: must be "none", "moving-average" or "growing-mean"; '
            'did you mean "growing-mean"? (given: "growing")',
        ),
        ('kind = "moving-average"\n', "", "surfaces.bench.filter.kind is missing; add it"),
        ('"moving-average"', '"adaptive"', 'filter.kind: must be "none", "moving-average" or "growing-mean"'),
        ('"moving-average"\nwindow = 1', '"growing-mean"', 'filter.kind = "growing-mean" needs noise_mm'),
        (
            '"moving-average"\nwindow = 1',
            '"growing-mean"\nmax_mean_ms = 0',
            "filter.max_mean_ms: must be more than 0",
        ),
        (
            "[surfaces.bench.filter]",
            "[surfaces.bench.zero_tracking]\nband_mm = 1\nrate_mm_per_min = 1\nmax_mm = 0\n[surfaces.bench.filter]",
            "surfaces.bench.zero_tracking.max_mm: must be more than 0",
        ),
        ("[publish]", "[publish", "not valid TOML: "),
    ],
)
def test_an_error_is_one_line_with_the_key(tmp_path: Path, old: str, new: str, expected: str) -> None:
    assert expected in changed(tmp_path, old, new)


def test_a_growing_mean_has_a_largest_number_of_readings(tmp_path: Path) -> None:
    text = configs.surface().replace("rate_hz = 200.0", "rate_hz = 200.0\nnoise_mm = 0.003")
    text = text.replace('"moving-average"\nwindow = 1', '"growing-mean"\nmax_mean_ms = 60000')
    said = complaint(configs.write(tmp_path, text))
    assert said == "surfaces.bench: filter.max_mean_ms: at most 50000, the time of 10000 readings"


def test_the_number_of_further_errors_is_stated(tmp_path: Path) -> None:
    assert complaint(configs.write(tmp_path, configs.surface().replace("_mm", "_um"))).endswith(" more)")


def test_a_file_that_cannot_be_read_is_an_error(tmp_path: Path) -> None:
    assert complaint(tmp_path / "absent.toml") == "No such file or directory"
    assert complaint(tmp_path) == "Is a directory"
    binary = tmp_path / "binary.toml"
    binary.write_bytes(b"\xff\xfe")
    assert complaint(binary) == "not a text file in UTF-8"


def test_a_configuration_without_a_surface_is_refused(tmp_path: Path) -> None:
    assert complaint(configs.write(tmp_path, "[surfaces]")).startswith("surfaces: must have at least 1 item, not 0")


def test_a_serial_port_serves_one_surface(tmp_path: Path) -> None:
    path = configs.write(
        tmp_path, configs.surface("a", configs.rtu("/dev/x")), configs.surface("b", configs.serial("/dev/x"))
    )
    assert complaint(path) == "2 surfaces use /dev/x (a, b); a serial port serves one surface"


def test_surfaces_on_one_bus_agree_on_its_line(tmp_path: Path) -> None:
    rtu = configs.rtu("/dev/x")
    both = load_config(configs.write(tmp_path, configs.surface("a", rtu), configs.surface("b", rtu)))
    assert both.surfaces.keys() == {"a", "b"}
    path = configs.write(tmp_path, configs.surface("a", rtu), configs.surface("b", f"{rtu}\nbaud = 9600"))
    assert complaint(path) == (
        "surfaces on /dev/x (a, b) state different baud, parity, stop_bits or silence_ms; make them equal"
    )


def test_keys_of_modbus_are_refused_for_a_serial_device(tmp_path: Path) -> None:
    text = configs.surface(source=configs.serial("/dev/x")).replace("register = 0", "register = 0\nunit = 2", 1)
    assert "unit, host and type are for Modbus" in complaint(configs.write(tmp_path, text))
    text = configs.surface(source=configs.rtu("/dev/x")).replace("register = 0", 'register = 0\nhost = "x"', 1)
    assert complaint(configs.write(tmp_path, text)) == "surfaces.bench: channel s1: host is for modbus-tcp"


def test_an_input_of_a_module_has_its_register_and_its_limits(tmp_path: Path) -> None:
    source = f'{configs.tcp(502)}\nmodule = "iologik-e1240"'
    text = configs.surface(source=source, rate_hz=10.0).replace("register = ", "input = ")
    surface = load_config(configs.write(tmp_path, text)).surfaces["bench"]
    assert [surface.place_of(channel) for channel in surface.channels] == [("127.0.0.1", 1, n) for n in (0, 1)]
    assert isinstance(surface.source, ModbusTcp)
    assert (surface.source.function_code, surface.source.max_request_registers) == (4, 8)
    beyond = configs.write(tmp_path, text.replace("input = 1", "input = 8"))
    assert complaint(beyond) == "surfaces.bench: channel s2: the module has inputs 0 to 7"


def test_a_device_of_ours_takes_whole_rates_only(tmp_path: Path) -> None:
    path = configs.write(tmp_path, configs.surface(source=configs.serial("/dev/x"), rate_hz=12.5))
    assert complaint(path) == "surfaces.bench: rate_hz must be a whole number for a serial source"


@pytest.mark.parametrize(
    "content", [None, b"", b"two words\n", b"\xff"], ids=["absent", "empty", "two words", "binary"]
)
def test_an_invalid_token_is_refused_with_a_remedy(tmp_path: Path, content: bytes | None) -> None:
    config: Config = load_config(configs.write(tmp_path, configs.surface()))
    token = tmp_path / "beamtouch.token"
    token.unlink()
    if content is not None:
        token.write_bytes(content)
    with pytest.raises(FailedError if content is None else InputError, match=r"publish\.token_file .*'s token"):
        config.read_token()


NUMBERS = """
[publish]
url = "http://127.0.0.1:8420"
token_file = "beamtouch.token"
batch_ms = 4
log_samples = 1000
log_mb = 10
[surfaces.a]
rate_hz = 200
noise_mm = 0.005
slowest_period_ms = 30
[surfaces.a.source]
kind = "modbus-tcp"
host = "127.0.0.1"
port = 502
unit = 1
timeout_ms = 200
max_registers = 20
bridge_registers = 2
function = 3
[surfaces.a.filter]
kind = "moving-average"
window = 4
spike_mm = 0.1
[surfaces.a.zero_tracking]
band_mm = 0.02
rate_mm_per_min = 0.01
max_mm = 0.1
[[surfaces.a.channels]]
name = "s1"
register = 0
unit = 2
gain_mm_per_count = -0.0001
offset_mm = 4.5
rest_gap_mm = 2.5
range_mm = [1, 4]
adc_bits = 16
counts_range = [0, 65535]
stuck_after_ms = 100
[surfaces.b]
rate_hz = 100
[surfaces.b.source]
kind = "modbus-rtu"
port = "/dev/ttyS0"
baud = 9600
stop_bits = 2
unit = 1
timeout_ms = 100
silence_ms = 2
[surfaces.b.filter]
kind = "none"
[[surfaces.b.channels]]
name = "s1"
register = 0
table = [[0, 1], [65535, 4]]
rest_gap_mm = 2.5
range_mm = [1, 4]
[surfaces.c]
rate_hz = 100
[surfaces.c.source]
kind = "serial"
port = "/dev/ttyS1"
baud = 1000000
oversampling = 2
[surfaces.c.filter]
kind = "moving-average"
window = 4
[[surfaces.c.channels]]
name = "s1"
register = 0
gain_mm_per_count = -0.0001
offset_mm = 4.5
rest_gap_mm = 2.5
range_mm = [1, 4]
"""


def test_only_a_number_is_a_number() -> None:
    content, context = tomllib.loads(NUMBERS), {"directory": Path()}
    Config.model_validate(content, context=context)
    taken = []
    for what, wrong in with_wrong_numbers(content):
        try:
            Config.model_validate(wrong, context=context)
        except ValidationError:
            continue
        taken.append(what)
    assert not taken


@pytest.mark.parametrize("key", ["token_file", "certificate_file", "log_file"])
def test_a_path_that_no_file_can_have_is_refused(tmp_path: Path, key: str) -> None:
    path = configs.write(tmp_path, configs.surface())
    lines = [line for line in path.read_text().splitlines() if not line.startswith(key)]
    path.write_text("\n".join(lines).replace("[publish]", f'[publish]\n{key} = "a\\u0000b"'))
    assert complaint(path) == f'publish.{key}: must be the path of a file (given: "a\\u0000b")'
