// The beam to scale along its length, its deflection exaggerated, its sensors, and the contact with its interval.

import { roundTicks, svg } from "./dom.js";

const MARGIN = 36;
const LEAST_DEFLECTION_MM = 0.1;
const DEEPEST = 0.21; // of the height
const LABEL_PX = 74;
const MEMORY_MS = 60_000;

/** Draws into an <svg>, whose size decides how much room there is. */
export class BeamView {
  constructor(element, caption) {
    this.element = element;
    this.caption = caption;
    this.deepest = { mm: 0, at: 0 };
  }

  forget() {
    this.deepest = { mm: 0, at: 0 };
  }

  draw(shown) {
    const { width, height } = this.element.getBoundingClientRect();
    if (width < 50 || !shown.length) {
      this.element.replaceChildren();
      this.caption("The beam is drawn once the service says what it looks like.");
      return;
    }
    const seen = shown.channels.filter((channel) => channel.quality === "good" && channel.deflection_mm !== null);
    const scale = this.scale(shown, seen, width, height);
    this.element.setAttribute("viewBox", `0 0 ${width} ${height}`);
    this.element.replaceChildren(
      hatch(),
      ...axis(scale),
      ...sensors(shown, scale),
      ...curve(seen, scale),
      ...(shown.contact?.state === "contact" ? touch(shown.contact, seen, scale) : []),
    );
    this.caption(captionOf(shown, seen, scale));
  }

  /** The exaggeration follows the largest deflection of the last minute, in round steps, so that it seldom changes. */
  scale(shown, seen, width, height) {
    const now = performance.now();
    const mm = Math.max(LEAST_DEFLECTION_MM, ...seen.map((channel) => Math.abs(channel.deflection_mm)));
    if (mm >= this.deepest.mm || now - this.deepest.at > MEMORY_MS) this.deepest = { mm, at: now };
    const perMm = (width - 2 * MARGIN) / shown.length;
    const most = (height * DEEPEST) / (this.deepest.mm * perMm);
    const power = 10 ** Math.floor(Math.log10(most));
    const factor = Math.max(1, [8, 6, 5, 4, 3, 2, 1].find((step) => step * power <= most) * power);
    return {
      width,
      factor,
      length: shown.length,
      x: (at) => MARGIN + at * perMm,
      y: (deflection) => height * 0.24 + deflection * perMm * factor,
      sensorY: height * 0.48,
      barY: height - 38,
      axisY: height - 24,
    };
  }
}

function captionOf(shown, seen, scale) {
  if (!seen.length) return "Position and deflection are not known.";
  const exaggerated = `Deflection drawn ${scale.factor} times larger, smooth between the circles.`;
  return shown.contact?.state === "contact" ? `${exaggerated} Hatched: 95 % interval.` : exaggerated;
}

function hatch() {
  const every = { width: 6, height: 6, patternUnits: "userSpaceOnUse", patternTransform: "rotate(45)" };
  const line = svg("path", { d: "M1.5 0v6", class: "hatch-line" });
  return svg("defs", {}, svg("pattern", { id: "hatch", ...every }, line));
}

function axis(scale) {
  const y = scale.axisY;
  const parts = [svg("path", { class: "axis", d: `M${scale.x(0)} ${y}H${scale.x(scale.length)}` })];
  for (const tick of roundTicks(0, scale.length, scale.width / 90)) {
    const x = scale.x(tick);
    const last = tick + 1e-6 > scale.length;
    parts.push(svg("path", { class: "axis", d: `M${x} ${y}v5` }));
    parts.push(svg("text", { class: "muted", x, y: y + 19, "text-anchor": "middle" }, last ? `${tick} mm` : `${tick}`));
  }
  return parts;
}

/** Sensors that work are full squares; others are empty ones with a cross, and say why. */
function sensors(shown, scale) {
  const taken = [-Infinity, -Infinity];
  return shown.channels.flatMap((channel) => {
    const x = scale.x(channel.position_mm);
    const y = scale.sensorY;
    const row = x - taken[0] >= LABEL_PX ? 0 : 1;
    taken[row] = x;
    const works = channel.quality === "good" || channel.quality === "unknown";
    const kind = channel.quality === "good" ? "sensor" : `sensor ${works ? "unknown" : "bad"}`;
    const box = svg("rect", { class: kind, x: x - 6, y, width: 12, height: 12 });
    const cross = svg("path", { class: "sensor bad", d: `M${x - 6} ${y}l12 12m0-12l-12 12` });
    const label = svg("text", { x, y: y + 27 + row * 14, "text-anchor": "middle", class: works ? "" : "bad" });
    label.append(works ? channel.name : `${channel.name} ${channel.quality}`);
    const lead = svg("path", { class: "lead", d: `M${x} ${scale.y(0)}V${y}` });
    return works ? [lead, box, label] : [lead, box, cross, label];
  });
}

function curve(seen, scale) {
  const rest = svg("path", { class: "rest", d: `M${scale.x(0)} ${scale.y(0)}H${scale.x(scale.length)}` });
  if (seen.length < 2) return [rest];
  const bent = spline(seen);
  const [first, last] = [seen[0].position_mm, seen.at(-1).position_mm];
  const piece = (from, to, count, name) => {
    const points = Array.from({ length: count + 1 }, (_, index) => from + ((to - from) * index) / count);
    const drawn = points.map((at) => `${scale.x(at)},${scale.y(bent(at))}`);
    return svg("polyline", { class: name, points: drawn.join(" ") });
  };
  const marks = seen.map((one) =>
    svg("circle", { class: "seen", cx: scale.x(one.position_mm), cy: scale.y(one.deflection_mm), r: 4 }),
  );
  const outside = [piece(0, first, 1, "guessed"), piece(last, scale.length, 1, "guessed")];
  return [rest, ...outside, piece(first, last, 60, "bent"), ...marks];
}

function touch(contact, seen, scale) {
  const bounded = (at) => scale.x(Math.min(Math.max(at, 0), scale.length));
  const x = bounded(contact.position_mm);
  const y = scale.y(seen.length < 2 ? 0 : spline(seen)(contact.position_mm)) - 4;
  const side = contact.position_mm > scale.length / 2 ? -1 : 1;
  const words = svg("text", { class: "here", x: x + side * 14, y: 18, "text-anchor": side < 0 ? "end" : "start" });
  words.append(`${contact.position_mm.toFixed(1)} mm`);
  const parts = [
    svg("path", { class: "touch", d: `M${x} 6V${y - 9}` }),
    svg("path", { class: "tip", d: `M${x} ${y}l-7-12h14z` }),
    words,
  ];
  if (contact.position_low_mm !== null && contact.position_high_mm !== null) {
    const [low, high] = [bounded(contact.position_low_mm), bounded(contact.position_high_mm)];
    const box = { x: low, y: scale.barY, width: Math.max(high - low, 3), height: 14 };
    parts.push(svg("rect", { class: "bar", ...box, fill: "url(#hatch)", id: "bar" }));
  }
  parts.push(svg("path", { class: "tip", d: `M${x} ${scale.barY - 1}l-5-8h10z` }));
  return parts;
}

/** Return the natural cubic spline through the channels, straight outside: no moment at a free or hinged end. */
export function spline(channels) {
  const x = channels.map((channel) => channel.position_mm);
  const y = channels.map((channel) => channel.deflection_mm);
  const bend = secondDerivatives(x, y);
  const slope = (i) => (y[i + 1] - y[i]) / (x[i + 1] - x[i]);
  const last = x.length - 1;
  const startSlope = slope(0) - ((x[1] - x[0]) * (2 * bend[0] + bend[1])) / 6;
  const endSlope = slope(last - 1) + ((x[last] - x[last - 1]) * (bend[last - 1] + 2 * bend[last])) / 6;
  return (at) => {
    if (at <= x[0]) return y[0] + startSlope * (at - x[0]);
    if (at >= x[last]) return y[last] + endSlope * (at - x[last]);
    const i = x.findIndex((_, index) => at < x[index + 1]);
    const h = x[i + 1] - x[i];
    const [a, b] = [(x[i + 1] - at) / h, (at - x[i]) / h];
    return a * y[i] + b * y[i + 1] + (((a ** 3 - a) * bend[i] + (b ** 3 - b) * bend[i + 1]) * h * h) / 6;
  };
}

/** Solve the tridiagonal system of a natural spline from front to back and back again. */
function secondDerivatives(x, y) {
  const bend = x.map(() => 0);
  const part = x.map(() => 0);
  for (let i = 1; i < x.length - 1; i++) {
    const share = (x[i] - x[i - 1]) / (x[i + 1] - x[i - 1]);
    const pivot = share * bend[i - 1] + 2;
    const change = (y[i + 1] - y[i]) / (x[i + 1] - x[i]) - (y[i] - y[i - 1]) / (x[i] - x[i - 1]);
    bend[i] = (share - 1) / pivot;
    part[i] = ((6 * change) / (x[i + 1] - x[i - 1]) - share * part[i - 1]) / pivot;
  }
  for (let i = x.length - 2; i >= 0; i--) bend[i] = bend[i] * bend[i + 1] + part[i];
  return bend;
}
