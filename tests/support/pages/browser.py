"""A real browser for tests of the page: Debian's Chromium, driven by Playwright."""

import os
import re
import shutil
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from playwright.sync_api import Browser, ConsoleMessage, Page, Route, sync_playwright

from support.running.debian_parts import require

TIMEOUT_MS = 60_000.0
"""Generous: test machines may be busy."""
_QUIET = [
    "--disable-gpu",
    "--disable-background-networking",
    "--no-first-run",
    "--disable-sync",
    "--disable-component-update",
]
_PATIENCES = re.compile(r"(?<=const )(SILENT|FIRST|ASK)_MS = [0-9_]+")
_PAUSE = re.compile(r"(?<=const AGAIN_MS = )[0-9_]+")
LEAST_CONTRAST = 4.5
SCREENS = [("desk", (1000, 900), "light"), ("panel", (800, 480), "dark"), ("phone", (390, 844), "light")]
"""Name, width and height [px], and colours."""
NO_FIGURE = "—"
SCREENSHOTS = Path(__file__).parents[3] / "build" / "screenshots"

OpenPage = Callable[..., "Watched"]

_WATCH = """() => {
  window.wrongs = [];
  window.states = [];
  new MutationObserver(() => states.push(document.body.dataset.state))
    .observe(document.body, {attributeFilter: ["data-state"]});
  setInterval(() => {
    const shown = document.querySelector("#position, #x")?.textContent;
    const force = document.getElementById("force")?.textContent;
    const state = document.body.dataset.state;
    const number = text => /^-?[0-9.]+$/.test(text);
    if ((state === "contact") !== number(shown)) window.wrongs.push([state, shown]);
    if (state !== "contact" && number(force)) window.wrongs.push([state, force]);
    const drawn = document.querySelector("#beam .touch, #beam .bar, #beam .here");
    if (state !== "contact" && drawn) window.wrongs.push([state, drawn.outerHTML]);
  }, 20);
}"""


_CONTRAST = """() => {
  const rgb = text => (text.match(/[\\d.]+/g) ?? []).map(Number);
  const luminance = ([r, g, b]) => [r, g, b].map(v => v / 255)
    .map(v => v <= 0.04045 ? v / 12.92 : ((v + 0.055) / 1.055) ** 2.4)
    .reduce((sum, v, i) => sum + v * [0.2126, 0.7152, 0.0722][i], 0);
  const ground = element => {
    for (let at = element; at; at = at.parentElement) {
      const colour = rgb(getComputedStyle(at).backgroundColor);
      if (colour.length === 3 || colour[3] === 1) return colour;
    }
    throw new Error("nothing behind " + element.outerHTML);
  };
  const found = [];
  const walker = document.createTreeWalker(document.body, NodeFilter.SHOW_TEXT);
  while (walker.nextNode()) {
    const element = walker.currentNode.parentElement;
    if (!walker.currentNode.data.trim() || !element.checkVisibility()) continue;
    const style = getComputedStyle(element);
    const ink = rgb(element.namespaceURI.endsWith("svg") ? style.fill : style.color);
    const [dark, light] = [luminance(ink), luminance(ground(element))].sort((a, b) => a - b);
    found.push([walker.currentNode.data.trim(), (light + 0.05) / (dark + 0.05)]);
  }
  return found;
}"""


class Watched:
    """A page, with everything that it asked for and complained of."""

    def __init__(self, page: Page, base: str) -> None:
        self.page, self.base = page, base
        self.requests: list[str] = []
        self.complaints: list[str] = []
        page.on("request", lambda request: self.requests.append(request.url))
        page.on("console", self._hear)
        page.on("pageerror", lambda error: self.complaints.append(str(error)))

    def _hear(self, message: ConsoleMessage) -> None:
        # A service that keeps no events answers 404, and the browser notes that by itself.
        url = str(message.location.get("url", ""))
        if message.type in {"error", "warning"} and "/events?" not in url:
            self.complaints.append(f"{message.text} {url}")

    def wait_for_state(self, state: str) -> None:
        """Wait until the page says that it is in a state."""
        self.page.wait_for_selector(f'body[data-state="{state}"]')

    def wait_for_text(self, element: str, part: str) -> None:
        """Wait until the element of that id contains a text."""
        script = "([id, part]) => document.getElementById(id).innerText.includes(part)"
        self.page.wait_for_function(script, arg=[element, part])

    def text(self, element: str) -> str:
        """Return the text of the element of that id."""
        return self.page.inner_text(f"#{element}")

    def texts_in(self, state: str, *elements: str) -> list[str]:
        """The title of the window, and what elements say, at one instant at which the page is in a state."""
        script = """([state, ids]) => document.body.dataset.state === state
          && [document.title, ...ids.map(id => document.getElementById(id).innerText)]"""
        found: list[str] = self.page.wait_for_function(script, arg=[state, elements]).json_value()
        return found

    def figures(self) -> dict[str, Any]:
        """State and figures as they stand at one instant, with that instant [s since 1970]."""
        script = """() => Object.fromEntries([["state", document.body.dataset.state], ["unix_s", Date.now() / 1000],
          ...["position", "position-interval", "force", "detail"]
            .map(id => [id, document.getElementById(id).innerText])])"""
        found: dict[str, Any] = self.page.evaluate(script)
        return found

    def tab_through(self) -> list[str]:
        """Return what the Tab key reaches: each control that is to be seen, in order, with a frame that shows it."""
        name = "one.id || one.tagName + one.textContent"
        controls: list[str] = self.page.evaluate(
            "() => [...document.querySelectorAll('select, summary, a[href], button, input, [tabindex]')]"
            f".filter(one => one.checkVisibility()).map(one => {name})"
        )
        # The body has the focus for once, so that the first Tab leads to the first control.
        self.page.evaluate("() => { const {body} = document; body.tabIndex = -1; body.focus(); }")
        self.page.evaluate("() => document.body.removeAttribute('tabindex')")
        reached = []
        for _ in controls:
            self.page.keyboard.press("Tab")
            where, outline = self.page.evaluate(
                "() => { const one = document.activeElement; const style = getComputedStyle(one);"
                f" return [{name}, style.outlineStyle + parseInt(style.outlineWidth)]; }}"
            )
            reached.append(where)
            assert outline == "solid3", where
        assert reached == controls
        return reached

    def unreadable(self, least_texts: int = 6) -> list[tuple[str, float]]:
        """Every text that is to be seen whose contrast to what is behind it is below that of WCAG, level AA."""
        found: list[tuple[str, float]] = self.page.evaluate(_CONTRAST)
        assert len(found) >= least_texts
        return [(text, contrast) for text, contrast in found if contrast < LEAST_CONTRAST]

    def outside(self, *elements: str) -> list[str]:
        """Those of the elements of these ids that the window does not show whole."""
        script = """ids => ids.filter(id => { const box = document.getElementById(id).getBoundingClientRect();
          return box.left < 0 || box.top < 0 || box.right > innerWidth || box.bottom > innerHeight; })"""
        found: list[str] = self.page.evaluate(script, elements)
        return found

    def picture(self, name: str) -> None:
        """Save what the window shows among the screenshots."""
        SCREENSHOTS.mkdir(parents=True, exist_ok=True)
        self.page.screenshot(path=SCREENSHOTS / f"{name}.png")

    def overflow(self) -> int:
        """By how many px the page is wider than the window."""
        found: int = self.page.evaluate("() => document.documentElement.scrollWidth - innerWidth")
        return found

    def watch(self) -> None:
        """From now on note whenever a contact stands there in a state that has none, or its position is missing."""
        self.page.evaluate(_WATCH)

    def wrongs(self) -> list[list[str]]:
        """Return what `watch` noted."""
        found: list[list[str]] = self.page.evaluate("() => window.wrongs")
        return found

    def states(self) -> list[str]:
        """The states since `watch`, one after the other."""
        found: list[str] = self.page.evaluate("() => window.states")
        return found

    def beside(self) -> "Watched":
        """Open the same address in another window of the same browser."""
        watched = Watched(self.page.context.new_page(), self.base)
        watched.page.goto(self.page.url)
        return watched

    def strangers(self) -> list[str]:
        """Requests that left the origin."""
        return [url for url in self.requests if not url.startswith((self.base + "/", "data:"))]


@contextmanager
def chromium() -> Iterator[Browser]:
    """Start a browser, and end it."""
    # This is the same browser without its desktop parts; it takes half the processor time.
    path = shutil.which("chromium-headless-shell") or require("chromium", "chromium-headless-shell")
    sandbox = ["--no-sandbox"] if os.geteuid() == 0 else []
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=path, args=[*sandbox, *_QUIET], timeout=TIMEOUT_MS)
        yield browser
        browser.close()


def _be_patient(route: Route) -> None:
    """Pass a script on, with a minute in place of the seconds after which the page gives the service up."""
    answer = route.fetch()
    route.fulfill(response=answer, body=_PATIENCES.sub(r"\1_MS = 60_000", answer.text()))


def _ask_often(route: Route) -> None:
    """Pass a script on, with a fraction of a second in place of those after which the page asks again."""
    answer = route.fetch()
    route.fulfill(response=answer, body=_PAUSE.sub("200", answer.text()))


@contextmanager
def pages(browser: Browser) -> Iterator[OpenPage]:
    """Give a function that opens an address in a window of its own; all are closed at the end.

    A service on a starved machine may say nothing for seconds. Pages wait for it, unless they are told not to. The
    scripts `often` ask again after a fraction of a second.
    """
    contexts = []

    def open_page(
        base: str,
        path: str = "/",
        size: tuple[int, int] = (1000, 900),
        *,
        is_patient: bool = True,
        often: Sequence[str] = (),
        **emulated: object,
    ) -> Watched:
        options: dict[str, Any] = {"viewport": {"width": size[0], "height": size[1]}, **emulated}
        context = browser.new_context(**options)
        contexts.append(context)
        context.set_default_timeout(TIMEOUT_MS)
        if is_patient:
            for script in ("feed", "token"):
                context.route(f"**/{script}.js", _be_patient)
        for script in often:
            context.route(f"**/{script}.js", _ask_often)
        watched = Watched(context.new_page(), base)
        watched.page.goto(base + path)
        return watched

    yield open_page
    for context in contexts:
        context.close()
