"""The settings of surfaces, channels and sources: each limit and each message with its numbers, and what follows."""

import math
from collections.abc import Mapping
from pathlib import Path

import pytest
from pydantic import ValidationError

from beamtouch_common.errors import InputError
from beamtouch_daemon.config import value_types
from beamtouch_daemon.config.publish import Publish
from beamtouch_daemon.config.settings import Config, Loads, Surface
from beamtouch_daemon.config.signal import Channel, GrowingMean, MovingAverage, NoFilter
from beamtouch_daemon.config.sources import ModbusRtu, ModbusTcp, SerialLine, Strict

from .surfaces import CHANNEL, surface_of

TABLED: dict[str, object] = {"gain_mm_per_count": None, "offset_mm": None}


def channel(**changes: object) -> Channel:
    return Channel.model_validate(CHANNEL | {"name": "s1", "register": 0} | changes)


def complaint(error: ValidationError) -> str:
    (one,) = error.errors()
    return one["msg"].removeprefix("Value error, ")


def refusal(**changes: object) -> str:
    """Return what is said of a surface of three channels with these keys."""
    with pytest.raises(ValidationError) as raised:
        surface_of(3, **changes)
    return complaint(raised.value)


@pytest.mark.parametrize(
    ("value_type", "words", "ends", "spacing"),
    [
        ("u16", 1, (0.0, 65_535.0), 1.0),
        ("i16", 1, (-32_768.0, 32_767.0), 1.0),
        ("u32", 2, (0.0, 4_294_967_295.0), 1.0),
        ("i32", 2, (-2_147_483_648.0, 2_147_483_647.0), 1.0),
        ("f32", 2, (-math.inf, math.inf), 2.0**-13),  # 24 bits of a value from 1024 on
        ("f64", 4, (-math.inf, math.inf), 2.0**-42),  # 53 bits
    ],
)
def test_a_type_has_its_registers_its_ends_and_its_smallest_change(
    value_type: value_types.ValueType, words: int, ends: tuple[float, float], spacing: float
) -> None:
    assert (value_types.words_of(value_type), value_types.ends_of(value_type)) == (words, ends)
    assert value_types.spacing_of(value_type, 1500.0) == spacing
    assert value_types.has_fractions(value_type) == value_type.startswith("f")


@pytest.mark.parametrize(
    ("points", "gap_mm", "count"),
    [
        ([[100, 4.0], [300, 3.0], [800, 1.0]], 3.5, 200.0),
        ([[100, 4.0], [300, 3.0], [800, 1.0]], 3.0, 300.0),
        ([[100, 4.0], [300, 3.0], [800, 1.0]], 2.0, 550.0),
        ([[100, 4.0], [300, 3.0], [800, 1.0]], 5.0, -100.0),
        ([[100, 4.0], [300, 3.0], [800, 1.0]], 0.6, 900.0),
        ([[100, 1.0], [300, 2.0], [800, 4.0]], 1.5, 200.0),
        ([[100, 1.0], [300, 2.0], [800, 4.0]], 3.0, 550.0),
        ([[100, 1.0], [300, 2.0], [800, 4.0]], 0.5, 0.0),
        ([[100, 1.0], [300, 2.0], [800, 4.0]], 4.4, 900.0),
        (None, 2.5, 20_000.0),
        (None, 4.7, -2000.0),
    ],
)
def test_the_counts_of_a_gap_are_those_of_its_piece(
    points: list[list[float]] | None, gap_mm: float, count: float
) -> None:
    one = channel() if points is None else channel(table=points, **TABLED)
    assert one.count_at(gap_mm) == pytest.approx(count)


def test_the_linear_counts_are_the_smaller_first() -> None:
    assert channel().linear_counts == pytest.approx((5000.0, 35_000.0))  # 4 mm and 1 mm
    assert channel(gain_mm_per_count=0.0001, offset_mm=0.0).linear_counts == pytest.approx((10_000.0, 40_000.0))


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"range_mm": [4.0, 4.0]}, "range_mm must be [smaller, larger], not [4.0, 4.0]"),
        ({"counts_range": [7.0, 3.0]}, "counts_range must be [smaller, larger], not [7.0, 3.0]"),
        ({"table": [[1, 2.0], [2, 3.0]]}, "give a table, or gain_mm_per_count with offset_mm, not both"),
        (
            {"table": [[1, 2.0], [2, 3.0]], "offset_mm": None},
            "give a table, or gain_mm_per_count with offset_mm, not both",
        ),
        ({"offset_mm": None}, "offset_mm missing; give gain_mm_per_count with offset_mm, or a table"),
        (TABLED, "gain_mm_per_count and offset_mm missing; give gain_mm_per_count with offset_mm, or a table"),
        (TABLED | {"table": [[1, 2.0]]}, "table needs at least 2 points [counts, gap_mm], not 1"),
        (TABLED | {"table": [[1, 2.0], [1, 3.0]]}, "table: counts must increase, but 1 follows 1"),
        (TABLED | {"table": [[1, 2.0], [5, 3.0], [4, 4.0]]}, "table: counts must increase, but 4 follows 5"),
        (
            TABLED | {"table": [[1, 2.0], [5, 3.0], [7, 2.5]]},
            "table: gaps must all increase or all decrease, but 2.5 mm follows 3 mm",
        ),
        (
            TABLED | {"table": [[1, 2.0], [5, 1.0], [7, 1.0]], "value_unit": "uT"},
            "table: gaps must all increase or all decrease, but 1 uT follows 1 uT",
        ),
        (
            TABLED | {"table": [[0, 1.0], [1e12, 1.9]]},
            "table: the slope from 0 to 1e+12 counts is not within 1e-12 to 1e+09 mm per count",
        ),
        (
            TABLED | {"table": [[0, 1.0], [1e-9, 2.5]]},
            "table: the slope from 0 to 1e-09 counts is not within 1e-12 to 1e+09 mm per count",
        ),
        (
            {"gain_mm_per_count": -0.9e-12},
            "must be at least 1e-12, with either sign: every count would give the same gap",
        ),
    ],
)
def test_a_characteristic_that_cannot_be_is_said(changes: dict[str, object], said: str) -> None:
    with pytest.raises(ValidationError) as raised:
        channel(**changes)
    assert complaint(raised.value) == said


def test_a_characteristic_at_its_limits_is_taken() -> None:
    assert channel(gain_mm_per_count=-1e-12).slopes == (-1e-12,)
    assert channel(gain_mm_per_count=1e-12).slopes == (1e-12,)
    assert channel(table=[[0, 1.0], [1e-9, 2.0]], **TABLED).slopes == pytest.approx((1e9, 1e9))
    assert channel(table=[[0, 1.0], [1e12, 2.0]], **TABLED).points == ((0.0, 1.0), (1e12, 2.0))


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        (
            {"filter": {"kind": "growing-mean"}},
            'filter.kind = "growing-mean" needs noise_mm; `beamtouch-daemon noise` measures it',
        ),
        (
            {"zero_tracking": {"drift_um_per_min": 4.0, "max_mm": 0.05}},
            "zero_tracking needs noise_mm; `beamtouch-daemon noise` measures it",
        ),
        (
            {"filter": {"kind": "growing-mean", "max_mean_ms": 60_000.0}, "noise_mm": 0.002, "rate_hz": 250.0},
            "filter.max_mean_ms: at most 40000, the time of 10000 readings",
        ),
        (
            {"slowest_period_ms": 16_001.0, "rate_hz": 250.0},
            "slowest_period_ms: at most 4000 readings, 16 s",
        ),
        (
            {"source": {"kind": "serial", "port": "/dev/x"}, "rate_hz": 0.5},
            "rate_hz must be a whole number for a serial source",
        ),
        (
            {"source": {"kind": "serial", "port": "/dev/x"}, "rate_hz": 2.5},
            "rate_hz must be a whole number for a serial source",
        ),
        (
            {"noise_mm": 1.5},
            "noise_mm = 1.5 is half the range of a sensor or more; if it is in um, write 0.0015",
        ),
    ],
)
def test_a_rate_a_time_or_a_noise_that_cannot_be_is_said(changes: dict[str, object], said: str) -> None:
    assert refusal(**changes) == said


def test_all_values_of_a_module_have_its_type_unless_a_channel_states_another() -> None:
    channels = [CHANNEL | {"name": "s1", "input": 0}, CHANNEL | {"name": "s2", "register": 900, "type": "f32"}]
    surface = surface_of(source=TCP | {"module": "iologik-e1240"}, rate_hz=10.0, channels=channels)
    assert (surface.value_types, surface.has_fractions) == (["u16", "f32"], [False, True])


def test_rates_times_and_noise_at_their_limits_are_taken() -> None:
    surface_of(slowest_period_ms=16_000.0, rate_hz=250.0)
    surface_of(filter={"kind": "growing-mean", "max_mean_ms": 40_000.0}, noise_mm=0.002, rate_hz=250.0)
    surface_of(source={"kind": "serial", "port": "/dev/x"}, rate_hz=1.0)
    surface_of(noise_mm=1.49)


def test_a_module_gives_no_more_readings_than_it_converts() -> None:
    source = {"kind": "modbus-tcp", "host": "plc", "module": "adam-6017"}
    assert refusal(source=source, rate_hz=12.6) == (
        "rate_hz: adam-6017 converts 12.5 times a second; a higher rate would read old values again"
    )
    assert surface_of(source=source, rate_hz=12.5).module is not None


def test_a_noise_in_another_unit_is_told_in_a_thousandth_of_it() -> None:
    channels = [CHANNEL | {"name": "s1", "register": 0, "value_unit": "uT"}]
    assert refusal(channels=channels, noise_mm=3.0).endswith("if it is in another unit, write 0.003")
    channels.append(CHANNEL | {"name": "s2", "register": 1})
    assert refusal(channels=channels) == (
        "s1 has the value_unit uT and s2 has mm; the channels of a surface have one, as noise_mm is that of all"
    )


def at(**place: float) -> dict[str, object]:
    return CHANNEL | {"name": f"s{len(place)}", "register": len(place)} | place


ON_BEAM, ON_PLATE = (
    {"position_mm": [0.0, 400.0], "max_force_n": 20.0},
    {"x_mm": [0.0, 9.0], "y_mm": [0.0, 9.0], "max_force_n": 2.0},
)
MIXED = "places have position_mm on a beam, x_mm and y_mm on a plate, in loads and all channels alike"


@pytest.mark.parametrize(
    ("channels", "loads", "axes"),
    [
        ([at(position_mm=3.0), at()], None, ("position",)),
        ([at(position_mm=3.0)], ON_BEAM, ("position",)),
        ([at(x_mm=3.0, y_mm=4.0), at()], None, ("x", "y")),
        ([at()], ON_PLATE, ("x", "y")),
        ([at()], None, ("position",)),
        ([at(position_mm=3.0), at(x_mm=3.0, y_mm=4.0)], None, None),
        ([at(position_mm=3.0)], ON_PLATE, None),
        ([at(x_mm=3.0)], None, None),
    ],
)
def test_places_are_all_on_a_beam_or_all_on_a_plate(
    channels: list[dict[str, object]], loads: Mapping[str, object] | None, axes: tuple[str, ...] | None
) -> None:
    if axes is None:
        assert refusal(channels=channels, loads=loads) == MIXED
    else:
        assert surface_of(channels=channels, loads=loads).axes == axes


@pytest.mark.parametrize(
    ("loads", "said"),
    [
        ({"max_force_n": 20.0}, "give position_mm of a beam, or x_mm and y_mm of a plate"),
        ({"max_force_n": 20.0, "x_mm": [0.0, 9.0]}, "give position_mm of a beam, or x_mm and y_mm of a plate"),
        (ON_BEAM | ON_PLATE, "give position_mm of a beam, or x_mm and y_mm of a plate"),
        (ON_BEAM | {"position_mm": [9.0, 8.5]}, "position_mm = [9, 8.5]: the first must not exceed the second"),
        (ON_PLATE | {"y_mm": [9.0, 8.5]}, "y_mm = [9, 8.5]: the first must not exceed the second"),
        (ON_BEAM | {"max_force_n": 0.0}, "Input should be greater than 0"),
    ],
)
def test_the_loads_of_a_model_have_ranges_and_a_force(loads: dict[str, object], said: str) -> None:
    with pytest.raises(ValidationError) as raised:
        Loads.model_validate(loads)
    assert complaint(raised.value) == said
    assert Loads.model_validate(ON_BEAM | {"position_mm": [9.0, 9.0]}).ranges_mm == {"position": (9.0, 9.0)}


@pytest.mark.parametrize(
    ("settings", "words", "longest"),
    [
        (NoFilter(), "single readings", None),
        (MovingAverage(kind="moving-average", window=7), "the mean of 7 readings", None),
        (GrowingMean(kind="growing-mean", max_mean_ms=250.0), "a growing mean", 50),
        (GrowingMean(kind="growing-mean", max_mean_ms=1.0), "a growing mean", 1),
    ],
)
def test_a_filter_has_its_words(
    settings: NoFilter | MovingAverage | GrowingMean, words: str, longest: int | None
) -> None:
    assert settings.in_words == words
    assert longest is None or (isinstance(settings, GrowingMean) and settings.longest(200.0) == longest)


def test_sources_have_their_timeouts_and_their_conversions() -> None:
    tcp, rtu = ModbusTcp(kind="modbus-tcp", host="plc"), ModbusRtu(kind="modbus-rtu", port="/dev/x", timeout_ms=70.0)
    board = SerialLine(kind="serial", port="/dev/x", oversampling=7)
    assert [(one.timeout_s, one.conversions, one.is_polled) for one in (tcp, rtu, board)] == [
        (0.2, 1, True),
        (0.07, 1, True),
        (0.0, 7, False),
    ]
    assert (tcp.port, tcp.unit, rtu.unit, rtu.line) == (502, 1, 1, (115_200, "none", 1, None))
    assert (board.baud, SerialLine(kind="serial", port="/dev/x").oversampling) == (1_000_000, 1)
    assert (tcp.function_code, tcp.max_request_registers) == (4, 125)
    stated = ModbusTcp(kind="modbus-tcp", host="plc", function=3, max_registers=9)
    assert (stated.function_code, stated.max_request_registers) == (3, 9)


TCP, RTU, BOARD = (
    {"kind": "modbus-tcp", "host": "plc"},
    {"kind": "modbus-rtu", "port": "/dev/x"},
    {"kind": "serial", "port": "/dev/x"},
)


@pytest.mark.parametrize(
    ("model", "keys", "key", "ends", "beyond"),
    [
        (ModbusTcp, TCP, "timeout_ms", (1.0, 60_000.0), (0.999, 60_000.5)),
        (ModbusTcp, TCP, "port", (1, 65_535), (0, 65_536)),
        (ModbusTcp, TCP, "unit", (0, 255), (-1, 256)),
        (ModbusTcp, TCP, "max_registers", (1, 125), (0, 126)),
        (ModbusTcp, TCP, "bridge_registers", (0, 124), (-1, 125)),
        (ModbusTcp, TCP, "host", ("p",), ("",)),
        (ModbusRtu, RTU, "timeout_ms", (1.0, 60_000.0), (0.999, 60_000.5)),
        (ModbusRtu, RTU, "baud", (300, 12_000_000), (299, 12_000_001)),
        (ModbusRtu, RTU, "unit", (1, 247), (0, 248)),
        (ModbusRtu, RTU, "stop_bits", (1, 2), (0, 3)),
        (ModbusRtu, RTU, "silence_ms", (0.0, 1000.0), (-0.1, 1000.1)),
        (ModbusRtu, RTU, "port", ("p",), ("",)),
        (SerialLine, BOARD, "oversampling", (1, 255), (0, 256)),
        (NoFilter, {}, "spike_mm", (1e-9, 1e9), (0.0, 1.000001e9)),
        (MovingAverage, {"kind": "moving-average"}, "window", (1, 10_000), (0, 10_001)),
        (GrowingMean, {"kind": "growing-mean"}, "max_mean_ms", (1e-9, 60_000.0), (0.0, 60_000.1)),
        (Channel, CHANNEL | {"name": "s1"}, "stuck_after_ms", (1e-9, 86_400_000.0), (0.0, 86_400_000.5)),
        (Channel, CHANNEL | {"name": "s1"}, "position_mm", (-1e9, 1e9), (-1.000001e9, 1.000001e9)),
        (Channel, CHANNEL | {"name": "s1"}, "counts_range", ((-1e12, 1e12),), ((-1.01e12, 5.0), (5.0, 1.01e12))),
        (Channel, CHANNEL | {"name": "s1"}, "register", (0, 65_535), (-1, 65_536)),
        (Channel, CHANNEL | {"name": "s1"}, "adc_bits", (1, 32), (0, 33)),
    ],
)
def test_a_key_is_taken_at_its_limits_and_refused_beyond_them(
    model: type[Strict], keys: dict[str, object], key: str, ends: tuple[object, ...], beyond: tuple[object, ...]
) -> None:
    for value in ends:
        model.model_validate(keys | {key: value})
    for value in beyond:
        with pytest.raises(ValidationError):
            model.model_validate(keys | {key: value})


ADAM, TWO_UNITS = {"module": "adam-6017", "unit": 9}, {"unit": 5, "host": "other"}


@pytest.mark.parametrize(
    ("source", "channel", "place"),
    [
        (TCP | {"unit": 9}, {"register": 7}, ("plc", 9, 7)),
        (TCP | {"unit": 9}, {"register": 7} | TWO_UNITS, ("other", 5, 7)),
        (TCP, {"register": 0, "unit": 0}, ("plc", 0, 0)),
        (TCP | ADAM, {"input": 7}, ("plc", 9, 7)),
        (TCP | ADAM, {"register": 3}, ("plc", 9, 3)),  # a module has other registers, too
        (RTU | {"unit": 9}, {"register": 7}, ("", 9, 7)),
        (RTU | {"unit": 9}, {"register": 7, "unit": 4}, ("", 4, 7)),
        (TCP, {}, "channel s1: state its register"),
        (TCP | ADAM, {}, "channel s1: state its register or its input"),
        (TCP | ADAM, {"input": 7, "register": 7}, "channel s1: state its register or its input"),
        (TCP | ADAM, {"input": 8}, "channel s1: the module has inputs 0 to 7"),
        (TCP, {"input": 7}, "channel s1: input needs the source's module; state the register"),
        (RTU, {"register": 7, "host": "plc"}, "channel s1: host is for modbus-tcp"),
        *(
            (
                BOARD,
                {"register": 7} | key,
                "channel s1: input, unit, host and type are for Modbus; a serial channel has a register",
            )
            for key in ({"input": 1}, {"unit": 1}, {"host": "plc"}, {"type": "u16"})
        ),
        (
            TCP,
            {"register": 7, "type": "i16", "adc_bits": 16},
            "channel s1: adc_bits = 16: counts of i16 end at 32767; remove it, or correct type",
        ),
    ],
)
def test_a_channel_has_its_place_or_the_reason_why_it_has_none(
    source: dict[str, object], channel: dict[str, object], place: tuple[str, int, int] | str
) -> None:
    channels = [CHANNEL | {"name": "s1"} | channel]
    if isinstance(place, str):
        assert refusal(source=source, channels=channels, rate_hz=10.0) == place
    else:
        surface = surface_of(source=source, channels=channels, rate_hz=10.0)
        assert surface.place_of(surface.channels[0]) == place


@pytest.mark.parametrize(
    ("second", "said"),
    [
        (
            {"register": 8},
            "channels s1 and s2 overlap: a value of type f32 takes 2 registers; correct register, or type",
        ),
        ({"register": 7}, "two channels have the same register 7"),
        (
            {"register": 6, "type": "u32"},
            "channels s2 and s1 overlap: a value of type u32 takes 2 registers; correct register, or type",
        ),
        ({"register": 9, "name": "s1"}, "two channels have the same name s1"),
        ({"register": 9}, ""),
        ({"register": 6}, ""),
        ({"register": 7, "unit": 2}, ""),
        ({"register": 7, "host": "other"}, ""),
    ],
)
def test_values_of_one_unit_do_not_overlap(second: dict[str, object], said: str) -> None:
    first = CHANNEL | {"name": "s1", "register": 7, "type": "f32"}
    channels = [first, CHANNEL | {"name": "s2"} | second, CHANNEL | {"name": "s3", "register": 90}]
    if said:
        assert refusal(channels=channels) == said
    else:
        assert surface_of(channels=channels).channel_names == ["s1", "s2", "s3"]


def test_what_is_not_stated_has_its_default() -> None:
    surface = surface_of()
    assert (surface.zero_drift_mm, surface.slowest_period_ms, surface.conversions) == (0.0, None, 1)
    assert surface.value_types == ["u16", "u16"]
    rtu = ModbusRtu.model_validate(RTU)
    assert (rtu.timeout_s, rtu.bridge_registers, rtu.byte_order) == (0.1, 0, "ABCD")
    growing = GrowingMean(kind="growing-mean")
    assert (MovingAverage(kind="moving-average").window, growing.window, growing.max_mean_ms) == (4, 4, 1000.0)


@pytest.mark.parametrize("port", ["tcp://plc", "tcp://", "udp://plc:7"])
def test_a_line_is_a_device_or_the_address_of_a_converter_with_its_port(port: str) -> None:
    with pytest.raises(ValidationError) as raised:
        ModbusRtu(kind="modbus-rtu", port=port)
    assert complaint(raised.value) == "give the path of a serial device, or tcp://HOST:PORT of a serial converter"
    assert ModbusRtu(kind="modbus-rtu", port="tcp://plc:7").port == "tcp://plc:7"


@pytest.mark.parametrize(
    ("url", "said"),
    [
        *(
            (url, "must look like http://127.0.0.1:8420")
            for url in (
                "ftp://plc",
                "plc:8420",
                "http://",
                "http://plc?x=1",
                "http://plc#x",
                "http://plc:0",
                "http://plc:99999",
            )
        ),
        ("http://me@plc", "must name no user; the service knows the daemon by its token"),
        ("http://plc/../x", "must have a path like /beamtouch, or none"),
        ("http://plc/x/events/", "must be the address of the whole service: leave out /events and what belongs to it"),
    ],
)
def test_an_address_that_is_none_of_a_service_is_said(url: str, said: str) -> None:
    with pytest.raises(ValidationError) as raised:
        Publish.model_validate({"url": url, "token_file": "token"})
    assert complaint(raised.value) == said


def test_a_service_has_its_defaults() -> None:
    publish = Publish.model_validate({"url": "https://plc/", "token_file": "token"})
    assert publish.url == "https://plc"
    assert (publish.batch_ms, publish.rest_ms, publish.log_samples, publish.log_mb) == (4.0, 100.0, 20_000, 200.0)


def config(folder: Path) -> Config:
    publish = {"url": "http://plc", "token_file": "token", "certificate_file": "plc.pem", "log_file": "logs/x"}
    surfaces = {name: surface_of() for name in ("bench", "press")}
    return Config.model_validate(
        {"publish": publish, "surfaces": surfaces},
        context={"directory": folder, "files": dict.fromkeys(surfaces, folder / "daemon.toml")},
    )


def test_the_files_of_a_daemon_are_those_of_its_configuration_and_what_it_keeps(tmp_path: Path) -> None:
    files = [file.relative_to(tmp_path).as_posix() for file in config(tmp_path).files]
    assert sorted(set(files)) == sorted(
        ["daemon.toml", "token", "plc.pem", "logs/x", "logs/x.zeros.json", "bench.tare.json", "press.tare.json"]
    )


def test_a_surface_is_chosen_by_its_name(tmp_path: Path) -> None:
    both = config(tmp_path)
    assert (both.choose_surfaces(None), both.choose_surfaces("press")) == (["bench", "press"], ["press"])
    with pytest.raises(InputError) as raised:
        both.choose_surfaces("hall")
    assert str(raised.value) == "--surface: there is no surface hall; choose one of bench, press"
    assert isinstance(both.surfaces["bench"], Surface)
