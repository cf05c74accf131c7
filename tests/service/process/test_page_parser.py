"""The page's parser of server-sent events, in a real browser, against that browser's own EventSource."""

from typing import Any

from service.process.conftest import StartService
from support.pages.browser import OpenPage, Watched

_PARSE = """async ({bytes, sizes}) => {
  const {EventParser} = await import("/sse.js");
  return sizes.map(size => {
    const parser = new EventParser();
    const found = [];
    for (let at = 0; at < bytes.length; at += size) {
      found.push(...parser.push(new Uint8Array(bytes.slice(at, at + size))));
    }
    return found.map(({type, data}) => [type, data]);
  });
}"""
_ORACLE = """() => new Promise(done => {
  const source = new EventSource("/oracle");
  const found = [];
  for (const type of ["message", "state", "other"]) {
    source.addEventListener(type, event => { if (event instanceof MessageEvent) found.push([type, event.data]); });
  }
  source.addEventListener("error", () => { source.close(); done(found); });
})"""

STREAMS = {
    "as the service sends": 'event: state\ndata: {"age_ms": 1.5}\n\nevent: state\ndata: {"age_ms": 2}\n\n',
    "carriage returns": "event: state\r\ndata: 1\r\n\r\nevent: state\rdata: 2\r\rdata: 3\n\r\n",
    "mixed ends in a row": "data: 1\r\r\ndata: 2\n\ndata: 3\n\r\ndata: 4\r\n\n",
    "characters of one to four bytes": "event: state\ndata: aä€😀 — “press”\n\ndata: 😀😀\n\n",
    "comments and fields that mean nothing here": ": hello\n\n:\ndata: 1\n: between\nid: 7\nretry\nnothing: x\n\n",
    "several lines of data, and empty ones": "data: 1\ndata\ndata:\ndata:  2: 3\n\ndata\n\ndata:\n\n",
    "no data is no event": "event: state\n\nevent: other\ndata: 1\n\ndata: 2\n\nevent:\ndata: 3\n\n",
    "a type is that of its own event": "event: state\nevent: other\ndata: 1\n\ndata: 2\n\n",
    "a byte order mark": "\ufeffdata: 1\n\ndata: \ufeff2\n\n",
    "what is not complete is not there": "data: 1\n\nevent: state\ndata: 2\n",
    "other separators are none": "data: 1\u2028\u0085\x0b2\n\n",
}


def by_browser(seen: Watched, content: bytes) -> list[Any]:
    """Return what the EventSource of the browser makes of a stream."""
    headers = {"Content-Type": "text/event-stream", "Cache-Control": "no-store"}
    seen.page.route("**/oracle", lambda route: route.fulfill(body=content, headers=headers))
    found: list[Any] = seen.page.evaluate(_ORACLE)
    seen.page.unroute("**/oracle")
    return found


def test_wherever_it_is_cut_it_finds_what_the_browser_finds(start_service: StartService, open_page: OpenPage) -> None:
    seen = open_page(start_service().url)
    for name, text in STREAMS.items():
        content = text.encode()
        wanted = by_browser(seen, content)
        assert wanted, name
        sizes = [1, 2, 3, 5, 7, len(content)]
        assert seen.page.evaluate(_PARSE, {"bytes": list(content), "sizes": sizes}) == [wanted] * len(sizes), name
