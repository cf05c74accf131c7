// The table of recent events: contacts, and stretches that nothing explains.

import { byId, html, setText } from "./dom.js";
import { COLUMNS } from "./fields.js";
import { inWords } from "./places.js";
import { named, say } from "./say.js";
import { clock as timeOf, zone } from "./times.js";

const AGAIN_MS = 5000;
// The first sample after the event was clear, or after an unexplained stretch a contact.
const SEEN_ENDS = ["lift", "clear", "contact"];

export class Events {
  constructor(token) {
    this.token = token;
    this.timer = null;
    this.events = [];
    this.current = true; // whether an open event may be shown as going on
    byId("events-head").replaceChildren(...COLUMNS.map(() => html("th", { scope: "col" })));
  }

  /** Ask now, and from now on every few seconds. */
  async follow(surface) {
    clearTimeout(this.timer);
    this.surface = surface;
    if (!surface) return this.show([]);
    try {
      const answer = await this.token.ask(`events?surface=${encodeURIComponent(surface)}&limit=20`);
      const events = answer.ok ? (await answer.json()).events : [];
      if (surface !== this.surface) return;
      this.show(events);
    } catch {
      // The feed says that the connection is lost; what happened before still happened.
    }
    this.timer = setTimeout(() => this.follow(this.surface), AGAIN_MS);
  }

  /** Say whether something acts on the surface now; if not, or without news, no event is shown as going on. */
  mark(current) {
    if (current === this.current) return;
    this.current = current;
    this.show(this.events);
  }

  /** Rows stay where they are; only what changed is rebuilt. */
  show(events) {
    this.events = events;
    byId("events-section").hidden = events.length === 0;
    COLUMNS.forEach((column, index) => setText(byId("events-head").cells[index], heading(column)));
    const body = byId("events");
    const known = new Map([...body.rows].map((row) => [row.dataset.of, row]));
    events.forEach((event, index) => {
      const of = JSON.stringify([event, this.current, timeOf(new Date(event.touched_at))]);
      const row = known.get(of) ?? this.row(event, of);
      if (body.rows[index] !== row) body.insertBefore(row, body.rows[index] ?? null);
    });
    while (body.rows.length > events.length) body.deleteRow(-1);
  }

  row(event, of) {
    return html("tr", { "data-of": of }, ...COLUMNS.flatMap(({ name }) => cell(event, name, this.current) ?? []));
  }
}

/** The unit of times is their zone, which is another one in summer. */
function heading({ name, label, unit }) {
  const shown = name === "touched_at" ? zone() : unit;
  return shown ? `${named(label)}, ${shown}` : named(label);
}

/** Return the cell of a column; null if the one beside it covers it. */
function cell(event, name, current) {
  const isUnexplained = event.kind === "unexplained";
  switch (name) {
    case "touched_at":
      return html("th", { scope: "row" }, clock(event.touched_at));
    case "place":
      return isUnexplained ? html("td", { colspan: 2, class: "doubt" }, say`unexplained`) : place(event);
    case "mean_force_n":
      return isUnexplained ? null : force(event);
    case "dwell_ms":
      return html("td", {}, duration(event, current));
    default:
      return html("td", {}, `${event[name] ?? "—"}`);
  }
}

/** Return where the load lay, or from where to where it moved. */
function place(event) {
  const axes = "mean_x_mm" in event ? ["x", "y"] : ["position"];
  const [means, lows, highs, least, most] = ["mean_#", "mean_#_low", "mean_#_high", "min_#", "max_#"].map((name) =>
    axes.map((axis) => event[`${name.replace("#", axis)}_mm`]),
  );
  if (means.some(isUnknown)) return html("td", {}, "—");
  const hasMoved = axes.some((_, index) => least[index] < lows[index] || most[index] > highs[index]);
  if (hasMoved) return html("td", {}, axes.map((_, index) => span(least[index], most[index], "…")).join(", "));
  const title = `${axes.map((_, index) => span(lows[index], highs[index], say`to`)).join(", ")} (95 %)`;
  return html("td", { title }, inWords(means, 1));
}

const isUnknown = (value) => value === null || value === undefined;
const span = (low, high, word) => `${low.toFixed(1)} ${word} ${high.toFixed(1)}`;

/** The mean force, and the largest one if it was clearly larger. */
const force = ({ mean_force_n: mean, mean_force_low_n: low, mean_force_high_n: high, peak_force_n: peak }) => {
  const cell = number(mean, low, high);
  if (peak > high) cell.append(say`, at most ${peak.toFixed(1)}`);
  return cell;
};

const clock = (at) => html("time", { datetime: at }, timeOf(new Date(at)));
const number = (value, low, high) => {
  if (isUnknown(value)) return html("td", {}, "—");
  return html("td", { title: `${span(low, high, say`to`)} (95 %)` }, value.toFixed(1));
};
const seconds = (ms) => (ms / 1000).toFixed(1);

/** Return how long it lasted and was in zones, in s, whether its figures are uncertain, and how it ended; at least
 * that long where nobody saw the end. */
function duration({ dwell_ms, end, kind, unexplained_ms, unsteady, zones }, current) {
  const stays = Object.entries(zones ?? {}).map(([name, ms]) => say`, ${seconds(ms)} in ${name}`);
  const stretches = kind !== "unexplained" && unexplained_ms > 0 ? say`, ${seconds(unexplained_ms)} unexplained` : "";
  const within = stays.join("") + (unsteady ? `${stretches}${say`, unsteady`}` : stretches);
  if (end === "open" && current) return `${say`still`}${within}`;
  if (SEEN_ENDS.includes(end)) return `${seconds(dwell_ms)}${within}`;
  return `≥ ${seconds(dwell_ms)}${within}`;
}
