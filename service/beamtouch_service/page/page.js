// The page of the service: follows one surface, and shows what is known of it now.

import { Alarms } from "./alarms.js";
import { BeamView } from "./beam.js";
import { Candidate } from "./candidate.js";
import { Commissioning } from "./commissioning.js";
import { byId, html, setText, sign } from "./dom.js";
import { Drawing } from "./drawing.js";
import { Events } from "./events.js";
import { Feed } from "./feed.js";
import { Figures } from "./figures.js";
import { Health } from "./health.js";
import { axesShown, inWords, isPlate, placeOf } from "./places.js";
import { PlateView } from "./plate.js";
import { say } from "./say.js";
import { ANSWERS, describe, figures, hasMoved, misfit, RELOAD, words } from "./state.js";
import { History } from "./strip.js";
import { drawChannels } from "./tables.js";
import { offerSettings, translate } from "./static_words.js";
import { Token } from "./token.js";
import { TokenForm } from "./token_form.js";
import { bands, listZones } from "./zones.js";

translate();
offerSettings();

const SIGNS = { problem: "warning", silent: "warning", lost: "warning" }; // others are called as their state
const STEPS_PER_STRIP = 4;
const SPEECH_MS = 3000; // between two places of the same contact: a screen reader takes about that long for one
const FAILED_MS = 2000; // between attempts of a page that fails
const calm = window.matchMedia("(prefers-reduced-motion: reduce)");

const history = new History();
const token = new Token();
const events = new Events(token);
const health = new Health(token);
const alarms = new Alarms(token);
const candidate = new Candidate(token);
const commissioning = new Commissioning(token);
const captioned = [byId("beam"), (text) => setText(byId("beam-words"), text)];
const [beamView, plateView] = [new BeamView(...captioned), new PlateView(...captioned)];
const drawing = new Drawing(token);
const largeFigures = new Figures();
const feed = new Feed(token, remember, surfacesKnown);
const form = new TokenForm(token, otherToken);
let said = "";
let spoken = { at: -Infinity, place: null }; // the place of the contact that was announced last
let heard = new Set(); // passing notes that were announced in this state
let model = null; // that the newest contact comes from, or that the surface had when the stream began
let steps = 0;
let size = [100, 100]; // of the surface along each axis in mm, kept for the charts while nothing is known of it

/** Each message goes into the strip charts, drawn or not. */
function remember() {
  history.add(describe(feed));
}

function surfacesKnown() {
  const names = feed.surfaces.map((surface) => surface.name);
  const several = names.length > 1 || !feed.surface;
  const chooser = byId("chooser");
  const options = feed.surface || !feed.chosen ? names : [feed.chosen, ...names];
  if (options.join() !== [...chooser.options].map((option) => option.value).join()) {
    chooser.replaceChildren(...options.map((name) => html("option", { value: name }, name)));
  }
  chooser.value = feed.chosen ?? "";
  chooser.hidden = !several || names.length === 0;
  setText(byId("surface"), chooser.hidden ? (feed.chosen ?? "") : "");
  nameModel(feed.surface?.model ?? null);
  drawing.forget(); // a service that was restarted may have other zones
  byId("contact-link").href = feed.chosen ? `contact?surface=${encodeURIComponent(feed.chosen)}` : "contact";
  events.follow(feed.surface?.name);
  health.follow(feed.surface?.name);
  candidate.follow(feed.surface?.name);
  alarms.follow(feed.isShared);
  commissioning.follow(feed.surface?.name ?? null);
}

/** At once, not with the next step: nothing of a surface outlives the token that it was read with. */
function nameModel(name) {
  model = name;
  setText(byId("model"), model ? say`Model ${model}` : "");
}

/** The surface that the address names; null if it names none. */
const addressed = () => new URLSearchParams(location.search).get("surface");

function follow(name) {
  history.forget();
  beamView.forget();
  drawing.forget();
  nameModel(null);
  said = ""; // the other one may be in the same state
  feed.choose(name);
}

function otherToken() {
  feed.forget();
  alarms.show([]);
  follow(addressed());
}

function step() {
  let wait = calm.matches ? 500 : 100;
  try {
    show();
  } catch (error) {
    console.error(error);
    fail();
    wait = FAILED_MS;
  }
  setTimeout(step, wait);
}

/** Figures must not outlive a page that cannot change them. */
function fail() {
  const shown = { kind: "problem", title: say`This page has failed`, detail: RELOAD, contact: null, age: null };
  drawNow(shown);
  speak(shown);
  said = ""; // so that all of the next state is shown again
  document.body.dataset.state = shown.kind;
  for (const id of ["beam", "sign", "zones"]) byId(id).textContent = "";
}

function show() {
  feed.check();
  const shown = describe(feed);
  if (shown.kind === "locked") history.forget();
  else if (!ANSWERS.includes(shown.kind)) history.add(shown);
  form.draw(shown.kind === "locked");
  drawNow(shown);
  announce(shown);
  drawChannels(shown.channels, shown.suspect);
  nameModel(shown.contact?.model ?? model);
  if (feed.link === "open") drawing.want(feed.chosen, model);
  const beam = drawing.of(model, shown.length, shown.width);
  const under = (scale) => bands(beam, shown.contact, scale);
  document.body.dataset.axes = axesShown(shown).length;
  (isPlate(shown) ? plateView : beamView).draw(shown, beam?.drawn ?? null, under, (scale) => commissioning.aim(scale));
  listZones(byId("zones"), beam, shown.contact);
  if (steps++ % (calm.matches ? 1 : STEPS_PER_STRIP) === 0) drawStrips(shown);
}

function drawNow(shown) {
  setText(byId("headline"), shown.title);
  setText(byId("detail"), shown.detail);
  largeFigures.shape(axesShown(shown).length);
  largeFigures.write(figures(shown, largeFigures.all, feed.surface?.stale_ms));
  setText(byId("misfit"), misfit(shown));
}

/** Change what is said once per state: the sign, the title of the window, and the words for those who listen. */
function announce(shown) {
  const text = words(shown);
  if (text !== said) {
    if (shown.kind !== "waiting") events.mark(shown.kind === "contact" || shown.kind === "unexplained");
    if (ANSWERS.includes(shown.kind) || shown.kind === "problem") events.follow(feed.surface?.name);
    said = text;
    heard = new Set();
    document.body.dataset.state = shown.kind;
    document.title = [shown.title, feed.chosen, "Beamtouch"].filter(Boolean).join(" · ");
    byId("sign").replaceChildren(sign(SIGNS[shown.kind] ?? shown.kind));
    speak(shown);
  } else if (performance.now() - spoken.at > SPEECH_MS) {
    const news = shown.passing?.some((note) => !heard.has(note));
    if (news || hasMoved(shown.contact, spoken.place)) speak(shown);
  }
}

function speak(shown) {
  const { passing = [] } = shown;
  const place = shown.kind === "contact" ? placeOf(shown.contact) : null;
  spoken = { at: performance.now(), place };
  passing.forEach((note) => heard.add(note));
  setText(byId("status"), [words(shown, place && say` at ${inWords(place, 0)} mm`), ...passing].join(". "));
}

function drawStrips(shown) {
  if (shown.length) size = [shown.length, shown.width];
  largeFigures.drawCharts(history, size);
}

byId("chooser").addEventListener("change", (event) => {
  const name = event.target.value;
  window.history.pushState(null, "", `?surface=${encodeURIComponent(name)}`);
  follow(name);
});
window.addEventListener("popstate", () => follow(addressed()));

follow(addressed());
step();
