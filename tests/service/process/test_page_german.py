"""The page in German, and its times in another zone, in a real browser."""

import json
import re
from collections.abc import Callable, Iterator, Mapping
from functools import partial
from html.parser import HTMLParser
from importlib import resources

import numpy as np
import pytest

from beamtouch_models.runtime import State
from beamtouch_models.runtime.decision.wrong_channels import wiring_faults
from beamtouch_service.access import Access, Role
from beamtouch_service.api.context import Streams
from beamtouch_service.commissioning.pressing import Stage
from beamtouch_service.commissioning.report import Finding, PlaceResult
from beamtouch_service.commissioning.run import CommissioningRun
from beamtouch_service.commissioning.verdict import (
    SensorFinding,
    advise,
    advise_places,
    advise_unseen,
    judge_place,
    judge_sensors,
)
from beamtouch_service.commissioning.wiring import Explanation, Wiring
from beamtouch_service.problems import Kind, Problem, ProblemError
from beamtouch_service.samples import Quality
from beamtouch_service.surfaces import surface_problems
from beamtouch_service.surfaces.channels import ChannelHealth, ChannelOut
from beamtouch_service.surfaces.contact import UnusableEstimateError, figures_of
from service.process.beam_page import StartBench
from service.process.conftest import StartService
from support.pages.browser import OpenPage, Watched
from support.running.waiting import wait_until
from support.surfaces.small_model import PLATE_OUTPUTS, model_of

PAGE = resources.files("beamtouch_service") / "page"
NAMES = ("s1", "s2", "s3", "s4")
SINCE = "2026-11-20T23:40:46.000Z"
HEARD = "async texts => { const { heard } = await import('/say.js'); return texts.map(heard); }"
ENGLISH = re.compile(
    r"\b(the|is|it|of|or|and|that|this|are|has|have|check|give|go|press|wait|take|look|put|swap|measure|repeat|close|ask"
    r"|beam|plate|with|within|than|should|seems?|unexplained|saturated|out-of-range|too few|no usable)\b(?!-)",
    re.IGNORECASE,
)
UNSAID = {Kind.NOT_READY, Kind.UNKNOWN_EVENT, Kind.WRONG_REPLICA, Kind.SURFACE_REQUIRED, Kind.MISSING_CHANNELS}
UNSAID |= {Kind.MALFORMED_JSON, Kind.INVALID_REQUEST, Kind.MALFORMED_ENCODING, Kind.UNKNOWN_ENCODING, Kind.TOO_LARGE}
UNSAID |= {Kind.TOO_SLOW, Kind.NOT_FOUND, Kind.METHOD_NOT_ALLOWED, Kind.OTHER_NAME}
"""Answers to what the page never asks."""


def open_german(open_page: OpenPage, url: str, **options: object) -> Watched:
    return open_page(url, locale="de-AT", **options)


class Words(HTMLParser):
    """Texts of a document that a browser shows, and labels of its elements."""

    def __init__(self, document: str) -> None:
        super().__init__()
        self.found, self._within = set[str](), list[str]()
        self.feed(document)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self._within.append(tag)
        self.found |= {value for name, value in attrs if name == "aria-label" and value}

    def handle_endtag(self, tag: str) -> None:
        while self._within and self._within.pop() != tag:
            pass

    def handle_data(self, data: str) -> None:
        if data.strip() and not {"title", "noscript"} & set(self._within):
            self.found.add(" ".join(data.split()))


def said_in(script: str) -> Iterator[str]:
    """Yield the sentences of a script behind the tag `say`, with `{}` for each value."""
    for begin in re.finditer(r"\bsay`", script):
        at, text, depth = begin.end(), "", 0
        while depth or script[at] != "`":
            if script.startswith("${", at):
                text += "" if depth else "{}"
                depth, at = depth + 1, at + 2
            elif depth:
                depth += {"{": 1, "}": -1}.get(script[at], 0)
                at += 1
            else:
                text, at = text + script[at], at + 1
        yield text


def test_each_sentence_of_the_page_has_a_german_one(start_service: StartService, open_page: OpenPage) -> None:
    seen = open_page(start_service().url)
    words: dict[str, dict[str, str]] = seen.page.evaluate("import('/german.js').then(one => ({...one}))")
    scripts = {entry.name: entry.read_text() for entry in PAGE.iterdir() if entry.name.endswith(".js")}
    wanted = {text for script in scripts.values() for text in said_in(script)}
    wanted |= Words((PAGE / "index.html").read_text()).found
    wanted |= {json.loads(label) for label in re.findall(r'"label": ("[^"]*")', scripts["fields.js"])}
    assert wanted - words["PAGE"].keys() == set()
    assert words["PAGE"].keys() - wanted == set(), "nobody says these"
    for listed in words.values():
        for english, german in listed.items():
            numbers = [int(number) for number in re.findall(r"\{(\d)\}", german)]
            blanks = len(re.findall(r"\{(?:word)?\}", english))
            assert len(re.findall(r"\{\d?\}", german)) <= blanks, german
            assert all(1 <= number <= blanks for number in numbers), german
            assert "{}" not in german or german.count("{}") == blanks, german


def prompts(plate: bool) -> Iterator[str]:
    model = model_of(outputs=PLATE_OUTPUTS) if plate else model_of()
    run = CommissioningRun("1", "press-7", model, 500.0, 0)
    for _ in range(run.steps):
        for run._finder.stage in Stage:  # each takes many samples
            yield run.prompt
        run.skip()
    yield run.prompt
    yield from run.report.verdict
    yield from (one.says for one in run.report.sensors)
    yield from (one.says for one in run.report.places)


def explained(
    sensors: tuple[int, ...] = (0, 1, 2, 3),
    signs: tuple[int, ...] = (1, 1, 1, 1),
    shares: tuple[float, ...] = (1.0, 1.0, 1.0, 1.0),
    *rivals: Wiring,
    fits: bool = True,
) -> Explanation:
    return Explanation(Wiring(sensors, signs), list(rivals), fits, [8.0] * 4, np.array(shares))


def verdicts(kind: str) -> Iterator[str]:
    bad: Mapping[str, Quality] = {"s3": Quality.STUCK}
    each = [
        explained(signs=(1, -1, 0, 0), shares=(1.0, -1.0, 0.0, 0.0)),
        explained(signs=(-1, -1, 0, 1), shares=(-1.0, -1.0, 0.3, 0.5)),
        explained((1, 0, 2, 3), (1, -1, 1, 1)),
        explained((1, 2, 0, 3)),
        explained((3, 2, 1, 0)),
        explained(shares=(float("nan"), 1.0, 1.0, 1.0)),
        explained(shares=(1.0, 0.3, 0.4, 1.0), fits=False),
        explained((0, 1, 2, 3), (1, 1, 1, 1), (1.0, 1.0, 1.0, 1.0), Wiring((1, 0, 2, 3), (1, 1, 1, 1))),
    ]
    for one in each:
        findings: list[SensorFinding] = judge_sensors(one, NAMES, bad)
        assert {finding.finding for finding in findings} <= set(Finding)
        yield from (finding.says for finding in findings)
        yield from advise(one, NAMES, findings, kind)
    yield from advise_unseen(["s1", "s2", "s4"], kind)


def places() -> Iterator[str]:
    for off_mm in ((11.0, 10.0, 10.5), (-11.0, -10.0, -10.5), (0.5, 0.0, 30.0), (0.0, 1.0, 0.5)):
        for axes in (("position",), ("x", "y")):
            each = [
                judge_place(
                    PlaceResult(
                        at_mm=dict.fromkeys(axes, 100.0),
                        state=State.CONTACT,
                        stated_mm=dict.fromkeys(axes, (100 + one, 99 + one, 101 + one)),
                    )
                )
                for one in off_mm
            ]
            each.append(judge_place(PlaceResult(at_mm=dict.fromkeys(axes, 100.0), state=State.UNEXPLAINED)))
            for kind in (Kind.TOO_FEW_CHANNELS, Kind.UNUSABLE_ESTIMATE):
                reason = f"no position: {kind.title.lower()}"
                each.append(judge_place(PlaceResult(at_mm=dict.fromkeys(axes, 100.0)), reason))
            yield from (part for one in each if one.error_mm is not None for part in one.says.split("; "))
            for is_wired in (True, False):
                yield from advise_places(each, is_wired=is_wired)


def problems() -> Iterator[str]:
    beam, plate = model_of().metadata, model_of(outputs=PLATE_OUTPUTS).metadata
    out = {"s2": ChannelOut(quality=Quality.MISSING, since=SINCE), "s3": ChannelOut(quality=Quality.STUCK, since=SINCE)}
    change = dict.fromkeys(("gain_percent", "gain_low_percent", "gain_high_percent"), -4.0)
    zero = dict.fromkeys(("zero_mm", "zero_low_mm", "zero_high_mm"))
    health = ChannelHealth(**change, **zero, since=SINCE, contacts=20, changed=True, changes=["gain"])
    bad = {"s1": Quality.SATURATED, "s2": Quality.OUT_OF_RANGE}
    each: list[Problem] = [
        surface_problems.no_model("press-7", None),
        surface_problems.no_model("press-7", "/models/press-7.onnx"),
        surface_problems.no_samples("press-7"),
        surface_problems.other_beam("press-7", beam, "beam-1"),
        surface_problems.other_beam("press-7", plate, "plate-1"),
        surface_problems.stale("press-7", 812.5, 500, SINCE),
        surface_problems.too_few_channels("press-7", 1, 2, bad),
        surface_problems.too_few_channels("press-7", 0, 2, bad),
        surface_problems.channels_out("press-7", out),
        surface_problems.changed_channels("press-7", {"s2": health, "s4": health}),
        surface_problems.zeros_moved("press-7"),
        surface_problems.unexplained("press-7", "beam", 5.0, None, "s2"),
        surface_problems.unexplained("press-7", "beam", 5.0, None, None),
        surface_problems.unexplained("press-7", "plate", 5.0, None, None),
    ]
    for position_mm in (712.0, float("nan")):
        with pytest.raises(UnusableEstimateError) as unusable:
            figures_of(dict.fromkeys(("position_mm", "position_low_mm", "position_high_mm"), position_mm), beam.outline)
        each.append(surface_problems.unusable_estimate("press-7", f"For the newest sample, {unusable.value}."))
    yield from (one.detail for one in each)
    yield from (kind.title for kind in Kind if kind not in UNSAID)


def refusals() -> Iterator[str]:
    access = Access.of(write="w", read="r", admin="a")
    calls: list[Callable[[], object]] = [
        lambda: access.require(Role.ADMIN, b"Bearer r"),
        lambda: access.require(Role.ADMIN, b"Bearer w"),
        lambda: access.require(Role.ADMIN, b"Bearer unknown"),
        lambda: Access().require(Role.ADMIN, b"Bearer w"),
        Streams(max_open=0).admit,
        Streams(is_stopping=True).admit,
    ]
    for call in calls:
        with pytest.raises(ProblemError) as refusal:
            call()
        yield refusal.value.problem.detail


@pytest.mark.promise("docs/reference/page.md", "in English or in German, also what the service says")
def test_what_the_service_says_is_said_in_german(start_service: StartService, open_page: OpenPage) -> None:
    seen = open_german(open_page, start_service().url)
    wirings = (wiring.text for wiring in wiring_faults(list(NAMES)))
    told = [*prompts(plate=False), *prompts(plate=True), *verdicts("beam"), *verdicts("plate"), *places()]
    texts = [text for text in dict.fromkeys([*problems(), *refusals(), *wirings, *told]) if text]
    german: list[str] = seen.page.evaluate(HEARD, texts)
    assert [text for text, other in zip(texts, german, strict=True) if text == other or ENGLISH.search(other)] == []
    unknown, silent = "A press and a beam. Of mine.", f"{Kind.NO_SAMPLES.title}. Go on once samples come again."
    said = seen.page.evaluate(HEARD, [unknown, silent])
    wanted = "Die Oberfläche hat noch keine Messwerte. Machen Sie weiter, sobald wieder Messwerte kommen."
    assert said == [unknown, wanted], "what is not known stays whole"
    named = surface_problems.too_few_channels("press-7", 0, 2, {"clear": Quality.STUCK, "Check": Quality.MISSING})
    wanted = "Nur 0 Kanäle funktionieren; das Modell braucht 2. Prüfen Sie clear (hängt), Check (fehlt)."
    assert seen.page.evaluate(HEARD, [named.detail]) == [wanted], "names stay, whatever they are"
    both = "s1 and s2 seem to be swapped, or s3 and s4 seem to be swapped"
    words = seen.page.evaluate("async both => (await import('/health.js')).faultsOf(both)", both)
    assert words == "Verdrahtung: s1 und s2 scheinen vertauscht zu sein oder s3 und s4 scheinen vertauscht zu sein."
    seen.page.route("**/german.js", lambda route: route.abort())
    seen.page.reload()
    seen.wait_for_text("headline", "The service has no surface")
    assert seen.page.get_attribute("html", "lang") == "en", "the page works without the German words"


def test_names_stay_as_they_are_whatever_they_are(start_bench: StartBench, open_page: OpenPage) -> None:
    sections = "degraded_after_s = 0.2\n[surfaces.press-7.zones.Contact]\nfrom_mm = 100\nto_mm = 200"
    bench = start_bench(sections=sections)
    bench.load((150.0, 10.0))
    seen = open_german(open_page, bench.service.url, size=(390, 844))
    seen.wait_for_state("contact")
    assert seen.page.get_attribute("html", "lang") == "de"
    assert seen.text("headline") == "Kontakt"
    seen.wait_for_text("zones", "Contact, 100 … 200 mm: ")
    assert seen.text("channels-title") == "Sensoren"
    assert seen.page.title() == "Kontakt · press-7 · Beamtouch"
    assert seen.unreadable() == []
    assert seen.complaints == []
    bench.send([0.0, None, 0.0, 0.0])
    seen.wait_for_text("channels", "fehlt")
    seen.page.click("summary")
    assert seen.overflow() == 0, "German words are longer"
    seen.picture("page-german")


@pytest.mark.soak
@pytest.mark.promise("docs/reference/page.md", "Below the page stand its language and the zone of its times.")
def test_language_and_zone_are_chosen_below_and_stay_for_the_next_time(
    start_bench: StartBench, open_page: OpenPage
) -> None:
    bench = start_bench(sections="degraded_after_s = 0.2")
    bench.load()
    bench.send([0.0, None, 0.0, 0.0])
    seen = open_page(bench.service.url, timezone_id="Europe/Berlin")
    seen.wait_for_text("events-title", "Recent events")

    def heading() -> str:
        return seen.page.inner_text("#events-head th >> nth=0")

    def shows(wanted: str) -> bool:
        return re.fullmatch(wanted, heading()) is not None

    bench.load((150.0, 10.0))
    seen.wait_for_state("contact")
    seen.page.wait_for_selector("#events tr")
    for at, zone in (("2026-12-01T12:00Z", "GMT+1|CET"), ("2027-07-01T12:00Z", "GMT+2|CEST")):
        seen.page.clock.set_fixed_time(at)
        wait_until(partial(shows, f"Began at, ({zone})"), pause_s=0.1)
    seen.page.select_option("#zone", "utc")
    seen.page.wait_for_function("() => document.querySelector('#events-head th')?.innerText === 'Began at, UTC'")
    seen.page.select_option("#language", "de")
    seen.wait_for_text("headline", "Kontakt")
    assert heading() == "Beginn, UTC"
    again = seen.beside()
    again.wait_for_text("headline", "Kontakt")
    assert again.page.input_value("#zone") == "utc"
    again.page.add_init_script("Object.defineProperty(window, 'localStorage', { get() { throw new Error(); } })")
    again.page.reload()
    again.wait_for_text("headline", "Contact")
    again.page.select_option("#language", "de")
    assert again.page.input_value("#language") == "en", "a choice that cannot be kept is not shown as taken"
