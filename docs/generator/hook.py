"""The hook of `mkdocs.yml`: fills in the generated parts of the site, and writes the schemas beside its pages."""

import json
import os
from pathlib import Path

from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files
from mkdocs.structure.pages import Page
from mkdocs.utils import get_relative_url

import facts
from links import rewritten
from pages import FILES, PAGES, SHOWN, filled, schema
from project import ROOT, addresses

ADDRESSES = addresses((ROOT / "pyproject.toml").read_text())
# Helps are as wide as the line of a page, and have no colours.
os.environ.update(COLUMNS="96", NO_COLOR="1")


def on_config(config: MkDocsConfig) -> MkDocsConfig:
    """Take the addresses from `pyproject.toml`, and list the files that patterns in the navigation stand for."""
    config.site_url = ADDRESSES.site
    config.repo_url = ADDRESSES.repository
    config.update(nav=with_files(config.nav, Path(config.docs_dir)))
    return config


def with_files(nav: object, docs: Path) -> object:
    """Return a navigation with the files below `docs` in place of patterns such as `decisions/*`."""
    if isinstance(nav, dict):
        return {title: with_files(part, docs) for title, part in nav.items()}
    if not isinstance(nav, list):
        return nav
    parts: list[object] = []
    for part in nav:
        is_pattern = isinstance(part, str) and "*" in part
        parts += (
            sorted(str(file.relative_to(docs)) for file in docs.glob(part)) if is_pattern else [with_files(part, docs)]
        )
    return parts


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Add the pages that show a file from outside `docs/`."""
    for page, file in SHOWN.items():
        files.append(File.generated(config, page.removeprefix("docs/"), content=(ROOT / file).read_text()))
    return files


def on_page_markdown(markdown: str, page: Page, **_: object) -> str:
    """Fill in the generated parts of a page, and let its links hold on the site."""
    path = f"docs/{page.file.src_uri}"
    source = SHOWN.get(path, path)
    return rewritten(filled(markdown), source, path, PAGES, ADDRESSES, lambda file: (ROOT / file).exists())


def on_page_content(html: str, page: Page, **_: object) -> str:
    """Resolve addresses of files that the build writes beside the pages: `site:schemas/scene.json`."""
    return html.replace('href="site:', f'href="{get_relative_url("", page.url)}/')


def on_post_build(config: MkDocsConfig) -> None:
    """Write the schemas of files, and the description of the HTTP interface."""
    folder = Path(config.site_dir) / "schemas"
    folder.mkdir(exist_ok=True)
    for name in FILES:
        _write(folder / f"{name}.json", schema(name, ADDRESSES.site))
    _write(folder / "openapi.json", facts.openapi())


def _write(path: Path, content: object) -> None:
    path.write_text(json.dumps(content, indent=1, ensure_ascii=False) + "\n")
