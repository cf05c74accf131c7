"""The hook of `mkdocs.yml`: addresses, the pages from outside `docs/`, and links that hold on the site."""

from pathlib import Path

from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files
from mkdocs.structure.pages import Page

from links import rewritten
from project import ROOT, addresses

ADDRESSES = addresses((ROOT / "pyproject.toml").read_text())
SHOWN = {
    "docs/index.md": "README.md",
    "docs/changelog.md": "CHANGELOG.md",
    "docs/contributing.md": "CONTRIBUTING.md",
    "docs/how-to/several-services.md": "deploy/README.md",
    "docs/reference/device.md": "firmware_protocol/README.md",
    "docs/reference/protocol.md": "firmware_protocol/PROTOCOL.md",
}
"""Pages that show a file from outside `docs/`, by their path."""
PAGES = {file: page for page, file in SHOWN.items()}


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
    """Let the links of a page hold on the site."""
    path = f"docs/{page.file.src_uri}"
    return rewritten(markdown, SHOWN.get(path, path), path, PAGES, ADDRESSES, lambda file: (ROOT / file).exists())
