// The tables: what each sensor says, and the recent contacts.

import { byId, html, setText, sign } from "./dom.js";

const WORDS = {
  good: "good",
  "out-of-range": "out of range",
  saturated: "saturated",
  stuck: "stuck",
  missing: "missing",
  unknown: "not known",
};

/** Fill the table of channels; its rows stay, only what changed in them is written. */
export function drawChannels(channels) {
  const body = byId("channels");
  while (body.rows.length > channels.length) body.deleteRow(-1);
  channels.forEach((channel, index) => drawChannel(body.rows[index] ?? body.appendChild(channelRow()), channel));
}

function channelRow() {
  return html("tr", {}, html("th", { scope: "row" }), html("td"), html("td"), html("td"));
}

function drawChannel(row, { name, position_mm: at, deflection_mm: deflection, quality }) {
  const [title, place, value, words] = row.cells;
  setText(title, name);
  setText(place, at.toFixed(1));
  setText(value, deflection === null ? "—" : signed(deflection));
  if (words.dataset.quality === quality) return;
  const kind = quality === "good" || quality === "unknown" ? quality : "bad";
  words.dataset.quality = quality;
  words.className = `words ${kind}`;
  words.replaceChildren(sign(kind), WORDS[quality] ?? quality);
}

/** With a true minus, and none before a zero. */
function signed(value) {
  return value.toFixed(3).replace(/^-(0\.0+)$/, "$1").replace("-", "−");
}

/** The recent contacts. */
export class Events {
  constructor(token) {
    this.token = token;
    this.timer = null;
    this.events = [];
    this.current = true; // whether an open contact may be shown as going on
  }

  /** Ask now, and from now on every few seconds. */
  async follow(surface) {
    clearTimeout(this.timer);
    this.surface = surface;
    if (!surface) return this.show([]);
    try {
      const answer = await this.token.ask(`/events?surface=${encodeURIComponent(surface)}&limit=20`);
      const events = answer.ok ? (await answer.json()).events : [];
      if (surface !== this.surface) return;
      this.show(events);
    } catch {
      // The feed says that the connection is lost; what happened before still happened.
    }
    this.timer = setTimeout(() => this.follow(this.surface), 5000);
  }

  /** Say whether the surface has a contact now; without one, or without news, no contact is shown as going on. */
  mark(current) {
    if (current === this.current) return;
    this.current = current;
    this.show(this.events);
  }

  show(events) {
    this.events = events;
    byId("events-section").hidden = events.length === 0;
    byId("events").replaceChildren(...events.map((event) => eventRow(event, this.current)));
  }
}

const ENDS = { stale: "samples stopped", unfinished: "service stopped" };

function eventRow(event, current) {
  const { touched_at, peak_force_n, mean_position_mm } = event;
  const time = html("time", { datetime: touched_at }, new Date(touched_at).toLocaleTimeString("en-GB"));
  const number = (value) => html("td", {}, value === null ? "—" : value.toFixed(1));
  const row = html("tr", {}, html("th", { scope: "row" }, time));
  row.append(number(mean_position_mm), number(peak_force_n), html("td", {}, duration(event, current)));
  return row;
}

/** How long it touched, in s, and how it ended; at least that long where nobody saw it lift. */
function duration({ dwell_ms, end }, current) {
  if (end === "open" && current) return "still";
  const seconds = (dwell_ms / 1000).toFixed(1);
  if (end === "lift") return seconds;
  return ENDS[end] ? `≥ ${seconds}, ${ENDS[end]}` : `≥ ${seconds}`;
}
