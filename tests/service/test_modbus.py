"""Modbus: the registers of surfaces at moments that a test chooses, and their map."""

import json
from pathlib import Path

import pytest

from beamtouch_common.zones import Zone
from beamtouch_models.runtime import State
from beamtouch_service import cli
from beamtouch_service.outputs.modbus.blocks import Blocks, NoSuchRegisterError
from beamtouch_service.outputs.modbus.registers import BLOCK, REGISTERS, STATES
from beamtouch_service.problems import Kind, ProblemError
from beamtouch_service.samples import Note, Quality
from beamtouch_service.sections import SurfaceSection
from beamtouch_service.surfaces.surface import Surface
from service.bench import Row, parsed, surface_of, surface_with
from service.contact_registers import FIGURES, number
from support.surfaces.small_model import PLATE_OUTPUTS, write_model

NOW_S = 1000.0


def block(surface: Surface, now_s: float = NOW_S) -> list[int]:
    return Blocks([surface], "big").read(0, 50, now_s)


def have_figures(words: list[int]) -> bool:
    return {number(words[offset : offset + 2], ">f") for offset in FIGURES.values()} != {None}


@pytest.mark.promise(
    "docs/reference/registers.md",
    "The first channel of the model is bit 0 (the lowest) of the first register, channel 17 is bit 0 of the second.",
    "only with state 3",
)
def test_each_quality_and_the_channel_to_check_have_bits_in_the_order_of_the_model() -> None:
    surface = surface_of(channels=40, min_channels=1)
    bad = {0: "out-of-range", 15: "saturated", 16: "stuck", 39: "missing"}
    names = [f"s{place + 1}" for place in range(40)]
    row: Row = [*[0.01] * 39, None]
    # The batch has another order than the model.
    quality = [bad.get(place, "good") for place in range(40)]
    surface.receive(parsed(row[::-1], channels=names[::-1], quality=quality[::-1]), NOW_S)
    assert block(surface)[26:42] == [1, 0, 0, 0, 1 << 15, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1 << 7, 0]
    surface = surface_of(channels=4)
    surface.receive(parsed([0.0] * 4, *[[0.5, 0.25, 0.75, 0.125]] * 60), NOW_S)
    assert surface.view(NOW_S).notes == ["check-s3"]
    words = block(surface)
    assert (words[2], words[3], words[22:26]) == (3, 0, [0b100, 0, 0, 0])


@pytest.mark.promise(
    "docs/reference/registers.md",
    "see below; 0 from state 16 on",
    "age of the newest sample, rounded up; 65535: more, or no sample",
    "All six figures are NaN unless the state is 2.",
)
def test_a_surface_that_is_stale_gives_no_figure_and_no_bit() -> None:
    surface = surface_of()
    surface.receive(parsed(*[[0.2, None, 0.3]] * 3, quality=["good", "missing", "good"]), NOW_S)
    assert block(surface, NOW_S + 0.0123)[4] == 13, "not younger than the sample"
    fresh, at_limit, stale = block(surface), block(surface, NOW_S + 0.5), block(surface, NOW_S + 0.5001)
    assert fresh[2] == at_limit[2] == 2
    assert (at_limit[4], at_limit[8:20]) == (500, fresh[8:20])
    assert (stale[2], stale[3], stale[5], have_figures(stale), stale[22:]) == (18, 0, 0, False, [0] * 28)
    assert block(surface, NOW_S + 1e6)[4] == 65_535


@pytest.mark.promise(
    "docs/reference/registers.md",
    "number of the newest sample, its lower 32 bits; 0 before the first",
)
@pytest.mark.parametrize(
    ("rows", "state", "age_ms", "sequence", "missing"),
    [
        ([], 17, 65_535, 0, 0),
        ([[0.2, None, None]], 19, 0, 1, 0b110),
        ([[0.5, 1.0, 0.5]], 20, 0, 1, 0),
        ([[0.5, 1.0, 0.5, None]], 20, 0, 1, 0b1000),
    ],
    ids=["no samples", "too few channels", "no usable estimate", "none although three are good"],
)
def test_a_surface_without_an_answer_says_why(
    rows: list[Row], state: int, age_ms: int, sequence: int, missing: int
) -> None:
    surface = surface_of(channels=max(map(len, rows), default=3))
    for row in rows:
        quality = ["missing" if value is None else "good" for value in row]
        surface.receive(parsed(row, quality=quality), NOW_S)
    words = block(surface)
    assert (words[2], words[4], words[7], words[38]) == (state, age_ms, sequence, missing)
    assert not have_figures(words)


def test_a_surface_whose_samples_are_of_another_beam_or_that_has_no_model_says_so() -> None:
    surface = surface_of()
    with pytest.raises(ProblemError):
        surface.receive(parsed().model_copy(update={"beam": "beam-2"}), NOW_S)
    assert block(surface)[2] == 21
    assert block(surface_with(None))[2] == 16


@pytest.mark.promise("docs/reference/registers.md", "readings in the sample; 65535: or more; 0: not known")
@pytest.mark.parametrize(("stated", "shown"), [(None, 0), (1, 1), (65_535, 65_535), (70_000, 65_535)])
def test_readings_end_at_the_largest_number_of_a_register(stated: int | None, shown: int) -> None:
    surface, batch = surface_of(), parsed([0.5, 0.25, 0.125])
    sample = batch.samples[0].model_copy(update={"readings": stated})
    surface.receive(batch.model_copy(update={"samples": [sample]}), NOW_S)
    assert block(surface)[5] == shown


@pytest.mark.promise("docs/reference/registers.md", "counts up 10 times a second and wraps to 0 after 65535")
def test_the_heartbeat_counts_tenths_of_a_second() -> None:
    found = [block(surface_with(None), second)[1] for second in (12.3, 12.4, 6553.5, 6553.6)]
    assert found == [123, 124, 65_535, 0]


@pytest.mark.parametrize(
    ("row", "bits"),
    [
        ([0.5, 0.25, 0.125], 0b01_11),  # at 150 mm
        ([0.5, 0.2, 0.0], 0b01_10),  # at the edge
        ([0.5, 0.0, 0.0], 0b01_01),  # at 100 mm
        ([0.5, 0.75, 0.5], 0b11_01),  # at 275 mm
        ([0.0, 0.0, 0.0], 0b01_01),
        ([0.5, 0.25, 0.75], 0b00_00),  # unexplained
    ],
)
def test_two_bits_of_each_zone_say_whether_the_contact_is_inside(row: Row, bits: int) -> None:
    zones = {"gate": Zone(from_mm=120, to_mm=200), "far": Zone(from_mm=250, to_mm=300)}
    surface = surface_of(section=SurfaceSection(zones=zones))
    surface.receive(parsed(*[row] * 5), NOW_S)
    assert block(surface)[42] == bits
    assert block(surface_of(section=SurfaceSection(zones=zones)))[42] == 0


@pytest.mark.promise(
    "docs/reference/registers.md", "entries into zone 1 since the service started; wraps to 0 after 65535"
)
def test_the_entries_into_a_zone_wrap() -> None:
    surface = surface_of(section=SurfaceSection(zones={"gate": Zone(from_mm=120, to_mm=200)}))
    surface.zone_entries = {"gate": 65_534}
    found = []
    for sequence, row in enumerate([[0.5, 0.25, 0.125], [0.0] * 3] * 2, 1):
        surface.receive(parsed(*[row] * 5, sequence=5 * sequence), NOW_S)
        found.append(block(surface)[43])
    assert found == [65_535, 65_535, 0, 0]


def test_the_map_is_complete_and_no_two_registers_share_an_address() -> None:
    taken = [place for one in REGISTERS for place in range(one.offset, one.offset + one.type.count)]
    assert len(set(taken)) == len(taken)
    assert max(taken) < BLOCK
    problems = {Kind.STALE, Kind.NO_SAMPLES, Kind.OTHER_BEAM, Kind.NO_MODEL, Kind.TOO_FEW_CHANNELS}
    assert set(STATES) == {*State, *problems, Kind.UNUSABLE_ESTIMATE}
    assert len({code for code, _ in STATES.values()}) == len(STATES)
    assert [note.bit for note in Note] == list(range(len(Note)))
    named = {one.name.replace("_", "-") for one in REGISTERS}
    assert named >= {quality.value for quality in Quality if quality is not Quality.GOOD}


CONFIG = """
[modbus_server]
word_order = "little"
[surfaces.press-7]
model = "press-7.onnx"
[surfaces.a-press]
"""


@pytest.mark.promise(
    "docs/how-to/plc.md",
    "The command prints the map, with the addresses of your surfaces and zones, and the `identity` of each surface.",
)
@pytest.mark.promise(
    "docs/reference/registers.md",
    (
        "The first surface of the configuration has addresses 0 to 59, the second 60 to 119, and so on, in the order "
        "of the sections `[surfaces.NAME]` in the file."
    ),
)
def test_the_command_lists_the_blocks_of_a_configuration(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "service.toml"
    path.write_text(CONFIG)
    assert cli.main(["registers", "--config", str(path)]) == 0
    text = capsys.readouterr().out
    assert cli.main(["registers", "--config", str(path), "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["surfaces"] == [
        {"surface": "press-7", "address": 0, "identity": 7881, "axes": ["position"]},
        {"surface": "a-press", "address": 60, "identity": 41422, "axes": ["position"]},
    ]
    assert (found["function"], found["registers_per_surface"], found["word_order"]) == (4, 60, "little")
    assert [one["name"] for one in found["registers"]] == [one.name for one in REGISTERS]
    assert (found["states"]["contact"], found["states"]["stale"], found["notes"]["rate"]) == (2, 18, 3)
    assert "| `a-press` | 60 to 119 | 41422    | position |\n\nWord order: little." in text
    assert "`x_mm`" not in text


@pytest.mark.promise(
    "docs/reference/registers.md",
    "Of a plate it names registers 8 to 13 after its first axis; of beams and plates together it has both names.",
)
def test_the_command_names_the_registers_of_a_plate_after_its_axes(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    plate = write_model(tmp_path, "top", outputs=PLATE_OUTPUTS, channels=4)
    write_model(tmp_path, "press-7")

    def printed(*options: str) -> str:
        assert cli.main(["registers", *options]) == 0
        return capsys.readouterr().out

    alone = printed("--model", str(plate))
    assert "| 8 to 9   | `x_mm` " in alone
    assert "| `top`   | 0 to 59   | " in alone
    assert "`position_mm`" not in alone
    path = tmp_path / "service.toml"
    path.write_text('[surfaces.press-7]\nmodel = "press-7.onnx"\n[surfaces.press-8]\nmodel = "top.onnx"\n')
    for both in (printed("--config", str(path)), printed()):
        assert "| 8 to 9   | `position_mm` " in both
        assert "| 8 to 9   | `x_mm` " in both
    found = json.loads(printed("--config", str(path), "--json"))
    assert [one["axes"] for one in found["surfaces"]] == [["position"], ["x", "y"]]
    assert [(one["offset"], one["name"]) for one in found["registers_of_plates"]] == [
        (8, "x_mm"),
        (10, "x_low_mm"),
        (12, "x_high_mm"),
    ]


def test_the_map_of_a_model_that_cannot_be_read_is_refused_in_one_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert cli.main(["registers", "--model", str(tmp_path / "none.onnx")]) == 2
    assert capsys.readouterr().err.count("\n") == 1


def test_the_command_refuses_a_model_that_it_cannot_read(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Its blocks would have the axes of a beam, and the model may be of a plate."""
    path, model = tmp_path / "service.toml", tmp_path / "plate.onnx"
    path.write_text(f'[surfaces.plate]\nmodel = "{model}"\n')
    model.write_bytes(b"no model")
    assert cli.main(["registers", "--config", str(path)]) == 2
    printed = capsys.readouterr()
    assert printed.out == ""
    assert f"model {model}" in printed.err


@pytest.mark.promise(
    "docs/reference/registers.md", "Each surface has a block of 60; offsets count from its first register."
)
def test_a_range_of_addresses_is_that_part_of_the_blocks_one_after_the_other() -> None:
    surfaces = [surface_of(), surface_with(None), surface_of()]
    surfaces[0].receive(parsed([0.5, 0.25, 0.125]), NOW_S)
    surfaces[2].receive(parsed([0.25, 0.5, 0.375]), NOW_S)
    blocks = Blocks(surfaces, "big")
    whole = [word for surface in surfaces for word in Blocks([surface], "big").read(0, BLOCK, NOW_S)]
    assert blocks.read(0, 3 * BLOCK, NOW_S) == whole
    for address, count in ((0, 1), (8, 12), (BLOCK - 1, 1), (BLOCK - 1, 2), (BLOCK, 3), (BLOCK + 2, BLOCK + 20)):
        assert blocks.read(address, count, NOW_S) == whole[address : address + count]
    assert blocks.read(2 * BLOCK + 8, 2, NOW_S) == whole[2 * BLOCK + 8 : 2 * BLOCK + 10]
    assert blocks.read(3 * BLOCK - 3, 3, NOW_S) == whole[-3:]
    with pytest.raises(NoSuchRegisterError, match=f"^address {3 * BLOCK} belongs to no surface$"):
        blocks.read(3 * BLOCK - 3, 4, NOW_S)
