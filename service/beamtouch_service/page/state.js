// From what the feed knows to what the page says. No document here.

import { noted } from "./notes.js";
import { axesOf, inWords, placeOf } from "./places.js";
import { heard, say } from "./say.js";
import { inZone } from "./times.js";

// Of these problems the channels are as new as ever.
const CURRENT = ["too-few-channels", "unusable-estimate"];
/** Kinds that are an answer of the service. */
export const ANSWERS = ["contact", "clear", "unexplained"];
const ASK = say`The service gives its data only to those who have one. Ask whoever runs the service.`;
export const RELOAD = say`Load it again.`;
const PREFIX = "urn:beamtouch:problem:";

const known = (value, digits) => (value === null || value === undefined ? "—" : value.toFixed(digits));

/**
 * Return what to show at this moment.
 *
 * kind: "contact", "clear", "unexplained", "problem", "silent", "lost", "locked" or "waiting"; title and detail in
 * words; contact: only if it is fresh, with `lasting`, `passing` and `suspect` from its notes; channels: with their
 * deflections only if these are fresh; age in ms or null.
 */
export function describe(feed) {
  const { message } = feed;
  const { shape } = feed;
  const size = { length: shape?.length_mm ?? null, width: shape?.width_mm ?? null };
  const nothing = { contact: null, channels: stripped(shape), ...size, age: null };
  if (feed.link === "lost") {
    return { ...nothing, kind: "lost", title: say`No connection since ${inZone(feed.since)}`, detail: `${feed.why} ${say`Trying again.`}`.trim() };
  }
  if (feed.link === "locked") return { ...nothing, kind: "locked", title: say`A reading token is needed`, detail: ASK };
  if (!message) return { ...nothing, kind: "waiting", title: say`Connecting`, detail: "" };
  const age = message.age_ms === null ? null : message.age_ms + feed.silence;
  if (message.problem) return { ...nothing, age, ...problem(message) };
  // The page's own clock: what was fresh when it was sent is not fresh for ever.
  if (feed.surface && age > feed.surface.stale_ms) {
    const seconds = (feed.silence / 1000).toFixed(1);
    return { ...nothing, kind: "silent", title: say`No news from the service`, detail: say`None for ${seconds} s.`, age };
  }
  return { ...nothing, ...answer(message), channels: message.channels, age };
}

function problem(message) {
  const { title, detail, type } = message.problem;
  const slug = (type ?? "").replace(PREFIX, "");
  const said = heard(title);
  const words = slug === "stale" ? say`Stale: ${`${said[0].toLowerCase()}${said.slice(1)}`}` : said;
  return { kind: "problem", title: words, detail: heard(detail), ...(CURRENT.includes(slug) && { channels: message.channels }) };
}

const TITLES = { contact: say`Contact`, clear: say`Clear`, unexplained: say`Unexplained` };

function answer({ contact, misfit_limit: misfitLimit }) {
  // A page that was opened before an update of the service.
  if (!TITLES[contact.state]) return { kind: "problem", title: say`This page is older than the service`, detail: RELOAD };
  return { kind: contact.state, title: TITLES[contact.state], ...noted(contact), contact, misfitLimit };
}

/** The channels without what they measured, for times at which that is old. */
function stripped(shape) {
  return (shape?.channels ?? []).map((channel) => ({ ...channel, deflection_mm: null, quality: "unknown" }));
}

/**
 * Return the large figures by id, each as the text of its value and the text below it; "—" for all that is not known.
 *
 * table: the figures of the surface; staleMs: its limit of the age, or undefined.
 */
export function figures(shown, table, staleMs) {
  return Object.fromEntries(table.map((figure) => [figure.id, figure.id === "age" ? age(shown, staleMs) : text(shown, figure)]));
}

function text({ kind, contact: found }, { name, ends }) {
  const below = ends ? interval(...ends.map((end) => found?.[end])) : "";
  return { value: known(found?.[name], 1), below: kind === "contact" && found[name] === null ? say`not estimated` : below };
}

/** The age by the clock of the page, which goes on while nothing comes. */
function age(shown, staleMs) {
  const value = shown.age === null ? "—" : shown.age < 100_000 ? shown.age.toFixed(0) : "> 99999";
  return { value, below: staleMs === undefined ? "" : say`at most ${staleMs} ms` };
}

/** Return the misfit beside its scale: a figure alone says nothing. */
export function misfit({ contact: found, misfitLimit: limit }) {
  if (!found || typeof limit !== "number") return "";
  const [value, most] = [found.misfit.toFixed(1), limit.toFixed(1)];
  return found.misfit > limit ? say`Misfit ${value}, over the limit of ${most}` : say`Misfit ${value}, the limit is ${most}`;
}

function interval(low, high) {
  return known(low, 1) === "—" || known(high, 1) === "—" ? "" : `${known(low, 1)} … ${known(high, 1)} (95 %)`;
}

/**
 * The state in a few words for those who listen; `place` stands behind its title.
 *
 * Without a place it changes only when the state does, or what lasts beside it.
 */
export function words(shown, place) {
  const beside = shown.kind !== "clear" && shown.lasting ? [shown.lasting] : [];
  return [`${shown.title}${place ?? ""}`, ...beside].join(". ");
}

/** Return whether a contact has left the announced place: out of its interval, or by a millimetre without one. */
export function hasMoved(contact, announced) {
  if (contact?.state !== "contact" || announced === null) return false;
  if (inWords(placeOf(contact), 0) === inWords(announced, 0)) return false;
  return axesOf(contact).some((axis, index) => {
    const [at, low, high] = ["", "_low", "_high"].map((end) => contact[`${axis}${end}_mm`]);
    return announced[index] < (low ?? at - 1) || announced[index] > (high ?? at + 1);
  });
}
