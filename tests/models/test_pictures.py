"""Pictures look right where CSS variables and media queries are unknown, and in a browser in light and dark."""

from pathlib import Path

import pytest
from playwright.sync_api import Browser

from beamtouch_models.design.building.report.beam_drawing import beam_drawing
from beamtouch_models.design.charts import DARK, LIGHT, SERIES_COLOURS, Chart, Series, draw, standalone
from beamtouch_models.design.scene import load_scene
from beamtouch_models.runtime import ModelFile
from models.pictures import decoded, drawn, share_of, share_of_black
from support.surfaces.example_scenes import SCENES

ROOT = Path(__file__).parents[2]
PICTURES = [*sorted((ROOT / "docs").glob("*.svg")), ROOT / "service/beamtouch_service/page/icon.svg"]


@pytest.fixture(scope="module")
def chart(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A file with eight series."""
    styles = ("line", "dashed", "points")
    series = [Series(f"{i}", [0, 1, 2], [i, i + 1, i + 0.5], i, styles[i % 3]) for i in range(8)]  # type: ignore[arg-type]
    path = tmp_path_factory.mktemp("chart") / "chart.svg"
    path.write_text(standalone(draw(Chart("a chart", "x, mm", "y, N", series))))
    return path


def test_a_chart_has_its_colours_without_a_browser(chart: Path) -> None:
    pixels = drawn(chart)
    assert share_of_black(pixels) < 0.01
    assert share_of(pixels, LIGHT["ground"]) > 0.8
    for name in ("ink", *SERIES_COLOURS):
        assert share_of(pixels, LIGHT[name]) > 1e-5, name
    assert len({LIGHT[name] for name in SERIES_COLOURS}) == len(SERIES_COLOURS)


def test_the_drawing_of_a_beam_has_its_colours_without_a_browser(bench: ModelFile, tmp_path: Path) -> None:
    scene, _ = load_scene(SCENES / "bench.toml")
    path = tmp_path / "beam.svg"
    path.write_text(standalone(beam_drawing(scene, bench.metadata)[0]))
    pixels = drawn(path)
    assert share_of_black(pixels) < 0.01
    for colour in (LIGHT["ground"], LIGHT["ink"], LIGHT["muted"], LIGHT["s0"], LIGHT["s1"]):
        assert share_of(pixels, colour) > 1e-5, colour


@pytest.mark.parametrize("path", PICTURES, ids=lambda path: path.name)
def test_the_pictures_of_the_project_are_not_black_without_a_browser(path: Path) -> None:
    assert "var(" not in path.read_text()
    assert share_of_black(drawn(path)) < 0.01


@pytest.mark.parametrize(("scheme", "colours"), [("light", LIGHT), ("dark", DARK)])
def test_a_browser_draws_a_chart_in_the_colours_of_its_screen(
    chart: Path, browser: Browser, scheme: str, colours: dict[str, str]
) -> None:
    page = browser.new_page(color_scheme=scheme, viewport={"width": 800, "height": 500})  # type: ignore[arg-type]
    page.goto(chart.as_uri())
    pixels = decoded(page.screenshot())
    page.close()
    for name in ("ground", "ink", *SERIES_COLOURS):
        assert share_of(pixels, colours[name]) > 1e-5, name
