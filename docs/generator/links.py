"""Links of a Markdown file, so that they hold on the site."""

import posixpath
import re
from collections.abc import Callable, Mapping

from project import Addresses

_FENCES = re.compile(r"(^ *```.*?^ *```[ ]*$)", re.MULTILINE | re.DOTALL)
_LINK = re.compile(r"(\]\()([^()\s]+)(\))")


def rewritten(
    text: str,
    source: str,
    page: str,
    pages: Mapping[str, str],
    addresses: Addresses,
    exists: Callable[[str], bool],
) -> str:
    """Return the text of a file with its links as they must stand on a page of the site.

    Parameters
    ----------
    text, source : the Markdown, and the path of its file in the repository
    page : path of the page in the repository, below `docs/`
    pages : pages that show files from outside `docs/`: path of the file to path of the page, both in the repository
    addresses : addresses of the project; other files of the repository are linked there
    exists : whether the repository has a file or folder of a path
    """

    def link(match: re.Match[str]) -> str:
        before, target, after = match.groups()
        path, mark, anchor = target.partition("#")
        if ":" in target or not path:
            return match[0]
        file = posixpath.normpath(posixpath.join(posixpath.dirname(source), path))
        shown = pages.get(file, file)
        if shown.startswith("docs/"):
            shown = posixpath.relpath(shown, posixpath.dirname(page))
        elif exists(file):
            shown = addresses.of_file(file)
        return f"{before}{shown}{mark}{anchor}{after}"

    return _outside_fences(link, text)


def absolute(text: str, addresses: Addresses) -> str:
    """Return the text of a file in the project's folder with links that hold anywhere: to the site and repository."""

    def link(match: re.Match[str]) -> str:
        before, target, after = match.groups()
        path, mark, anchor = target.partition("#")
        if ":" in target or not path:
            return match[0]
        page = path.removeprefix("docs/")
        if page == path:
            return f"{before}{addresses.of_file(path)}{mark}{anchor}{after}"
        shown = page.removesuffix(".md").removesuffix("index") + "/" if page.endswith(".md") else page
        return f"{before}{addresses.site}{shown.replace('//', '/')}{mark}{anchor}{after}"

    return _outside_fences(link, text)


def _outside_fences(link: Callable[[re.Match[str]], str], text: str) -> str:
    """Return a text with each of its links replaced; a fenced block stays as it is."""
    parts = _FENCES.split(text)
    parts[::2] = [_LINK.sub(link, part) for part in parts[::2]]
    return "".join(parts)
