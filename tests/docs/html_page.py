"""Links, anchors and text of an HTML page."""

from html.parser import HTMLParser
from pathlib import Path


class HtmlPage(HTMLParser):
    """What a page refers to, and what others may refer to."""

    def __init__(self, path: Path) -> None:
        super().__init__()
        self.links: list[str] = []
        """Targets that a reader may follow."""
        self.loaded: list[str] = []
        """Targets that a browser loads by itself."""
        self.anchors: set[str] = set()
        self.text = ""
        self.feed(path.read_text())
        self.close()

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        """Note the targets and the anchor of an element."""
        found = {name: value or "" for name, value in attrs}
        self.anchors |= {found[name] for name in ("id", "name") if name in found}
        if tag in ("script", "img", "iframe", "source") and "src" in found:
            self.loaded.append(found["src"])
        elif tag == "link" and found.get("rel") in ("stylesheet", "icon", "preconnect", "preload"):
            self.loaded.append(found["href"])
        elif tag == "a" and "href" in found:
            self.links.append(found["href"])

    def handle_data(self, data: str) -> None:
        """Note the text."""
        self.text += data
