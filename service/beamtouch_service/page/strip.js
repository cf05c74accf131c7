// The last minute as a strip chart: a line with the interval as a band, gaps where nothing touched, hatching where
// nothing was known, and crossed hatching where nothing explains the samples.

import { roundTicks, svg } from "./dom.js";
import { say } from "./say.js";

const SPAN_MS = 60_000;
const GAP_MS = 1000;
const EVERY_MS = 100;
const [LEFT, RIGHT, TOP, BOTTOM] = [40, 8, 6, 20];

/** The states and contacts of the last minute. */
export class History {
  constructor() {
    this.entries = [];
  }

  forget() {
    this.entries = [];
  }

  add(shown) {
    const at = performance.now();
    const last = this.entries.at(-1);
    if (last && last.kind === shown.kind && at - last.at < EVERY_MS) return;
    this.entries.push({ at, kind: shown.kind, contact: shown.contact });
    while (this.entries[0].at < at - SPAN_MS - GAP_MS) this.entries.shift();
  }

  /** Return a range for a figure, with the name of its upper end: from zero to a round value above all of it. */
  range(name, high) {
    const values = this.entries.map(({ contact }) => contact?.[high] ?? contact?.[name] ?? 0);
    const most = Math.max(1, ...values);
    const power = 10 ** Math.floor(Math.log10(most));
    return [0, [1, 1.5, 2, 3, 5, 7, 10].find((step) => step * power >= most) * power];
  }

  /** Stretches of one sort, as [from, to]; `test` takes a kind. */
  stretches(test) {
    return this.runs((entry) => test(entry.kind)).map(({ run, end }) => [run[0].at, end]);
  }

  /** Runs of consecutive entries that fulfil the test, each with the time at which it ended. */
  runs(test) {
    const found = [];
    let run = null;
    for (const entry of this.entries) {
      const joins = run && entry.at - run.end <= GAP_MS;
      if (run && joins) run.end = entry.at;
      if (!test(entry)) run = null;
      else if (joins) run.run.push(entry);
      else found.push((run = { run: [entry], end: entry.at }));
    }
    return found;
  }
}

const HATCHED = {
  unknown: { kinds: ["problem", "silent", "lost"], line: "M1 0v7" },
  unexplained: { kinds: ["unexplained"], line: "M1 0v7M0 1h7" },
};

/** Draw one quantity; `names` are those of its value and of the ends of its interval in a contact. */
export function drawStrip(element, history, names, range) {
  const { width, height } = element.getBoundingClientRect();
  if (width < 50) return element.replaceChildren();
  const now = performance.now();
  const [low, high] = range;
  const x = (at) => LEFT + Math.max(0, 1 - (now - at) / SPAN_MS) * (width - LEFT - RIGHT);
  const share = (value) => (Math.min(Math.max(value, low), high) - low) / (high - low);
  const y = (value) => height - BOTTOM - share(value) * (height - TOP - BOTTOM);
  element.setAttribute("viewBox", `0 0 ${width} ${height}`);
  element.replaceChildren(
    patterns(element.id),
    ...grid(x, y, now, range, width, height),
    ...hatched(history, x, height, element.id),
    ...lines(history, names, x, y),
  );
}

function patterns(id) {
  const every = { width: 7, height: 7, patternUnits: "userSpaceOnUse", patternTransform: "rotate(45)" };
  const each = Object.entries(HATCHED).map(([name, { line: d }]) =>
    svg("pattern", { id: `${id}-${name}`, ...every }, svg("path", { d, class: `${name}-line` })),
  );
  return svg("defs", {}, ...each);
}

function grid(x, y, now, [low, high], width, height) {
  const parts = [];
  for (const tick of roundTicks(low, high, Math.max(2, (height - TOP - BOTTOM) / 36))) {
    parts.push(svg("path", { class: "strip-grid", d: `M${LEFT} ${y(tick)}H${width - RIGHT}` }));
    parts.push(svg("text", { class: "muted", x: LEFT - 6, y: y(tick) + 4, "text-anchor": "end" }, `${tick}`));
  }
  for (const seconds of [60, 45, 30, 15, 0]) {
    const at = x(now - seconds * 1000);
    const anchor = seconds === 0 ? "end" : "middle";
    parts.push(svg("path", { class: "strip-grid", d: `M${at} ${TOP}V${height - BOTTOM}` }));
    const label = seconds === 0 ? say`now` : `−${seconds} s`;
    parts.push(svg("text", { class: "muted", x: at, y: height - 4, "text-anchor": anchor }, label));
  }
  return parts;
}

function hatched(history, x, height, id) {
  return Object.entries(HATCHED).flatMap(([name, { kinds }]) =>
    history.stretches((kind) => kinds.includes(kind)).map(([from, to]) => {
      const box = { x: x(from), y: TOP, width: Math.max(x(to) - x(from), 1), height: height - TOP - BOTTOM };
      return svg("rect", { class: name, ...box, fill: `url(#${id}-${name})` });
    }),
  );
}

function lines(history, [value, low, high], x, y) {
  const touched = history.runs((entry) => entry.contact !== null && typeof entry.contact[value] === "number");
  return touched.flatMap(({ run }) => {
    const at = (name) => run.map((entry) => `${x(entry.at).toFixed(1)},${y(entry.contact[name]).toFixed(1)}`);
    const line = svg("polyline", { class: "strip-line", points: at(value).join(" ") });
    if (typeof run[0].contact[low] !== "number") return [line];
    return [svg("polygon", { class: "strip-band", points: [...at(low), ...at(high).reverse()].join(" ") }), line];
  });
}

