// The beam to scale along its length, its deflection exaggerated, its sensors, and the contact with its interval.

import { axis, hatch, sensors, supports } from "./beam_parts.js";
import { shapeUnder, spline } from "./curves.js";
import { svg } from "./dom.js";
import { say } from "./say.js";

const MARGIN = 36;
const LEAST_DEFLECTION_MM = 0.1;
const LEAST_OF_OTHER = 1e-9; // less than any sensor shows, whatever its unit
const DEEPEST = 0.21; // of the height
const MEMORY_MS = 60_000;
const PIECES = 80;

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

  /**
   * `drawn`: supports and table by the model, or null while they are not known. `under` and `over` take the scale and
   * return what else is drawn, behind the beam and in front of it.
   */
  draw(shown, drawn, under, over) {
    const { width, height } = this.element.getBoundingClientRect();
    if (width < 50 || !shown.length) {
      this.element.replaceChildren();
      this.caption(say`The beam is drawn once the service says what it looks like.`);
      return;
    }
    const seen = shown.channels.filter((channel) => channel.quality === "good" && channel.deflection_mm !== null);
    const bent = bentOf(shown, drawn, seen);
    const scale = this.scale(shown, seen, bent, width, height);
    this.element.setAttribute("viewBox", `0 0 ${width} ${height}`);
    this.element.replaceChildren(
      hatch(),
      ...under(scale),
      ...axis(scale),
      ...supports(drawn?.supports ?? [], scale),
      ...sensors(shown, drawn, scale),
      ...line(shown, drawn, seen, bent, scale),
      ...seen.map((channel) => mark(channel, shown, scale)),
      ...over(scale),
      ...(shown.kind === "contact" ? touch(shown.contact, bent, scale) : []),
    );
    this.caption(captionOf(shown, drawn, seen, scale));
  }

  /** The exaggeration follows the largest deflection of the last minute, in round steps, so that it seldom changes. */
  scale(shown, seen, bent, width, height) {
    const now = performance.now();
    const measured = seen.map((channel) => Math.abs(channel.deflection_mm));
    const along = bent ? places(0, shown.length).map((at) => Math.abs(bent(at))) : [];
    const inMm = isLength(shown);
    const mm = Math.max(inMm ? LEAST_DEFLECTION_MM : LEAST_OF_OTHER, ...measured, ...along);
    if (mm >= this.deepest.mm || now - this.deepest.at > MEMORY_MS) this.deepest = { mm, at: now };
    const perMm = (width - 2 * MARGIN) / shown.length;
    const most = (height * DEEPEST) / (this.deepest.mm * perMm);
    const power = 10 ** Math.floor(Math.log10(most));
    const round = [8, 6, 5, 4, 3, 2, 1].find((step) => step * power <= most) * power;
    const factor = inMm ? Math.max(1, round) : round;
    return {
      width,
      height,
      factor,
      length: shown.length,
      perMm,
      x: (at) => MARGIN + at * perMm,
      y: (deflection) => height * 0.24 + deflection * perMm * factor,
      sensorY: height * 0.48,
      barY: height - 38,
      axisY: height - 24,
    };
  }
}

/** Return the deflection along the beam in contact, by the model or else through the measured points; or null. */
function bentOf(shown, drawn, seen) {
  if (shown.kind !== "contact") return null;
  if (drawn) return shapeUnder(shown.contact, drawn, seen);
  return seen.length < 2 ? () => 0 : spline(seen);
}

function captionOf(shown, drawn, seen, scale) {
  if (!seen.length) return say`Position and deflection are not known.`;
  const circles = isLength(shown)
    ? say`Circles: measured deflection, ${scale.factor} times larger.`
    : say`Circles: measured deflection, in ${seen[0].unit}, to a scale of their own.`;
  if (shown.kind === "clear") return circles;
  if (shown.kind !== "contact") return `${circles} ${say`The shape between them is not known.`}`;
  const by = drawn ? say`Line: the beam by the model.` : say`Line: a smooth curve through them.`;
  return `${circles} ${by} ${say`Hatched: 95 % interval.`}`;
}

/** A deflection in mm has the scale of the beam; one in another unit, as uV/V, has none that is right. */
const isLength = (shown) => shown.channels.every((channel) => channel.unit === "mm");

const places = (from, to, count = PIECES) =>
  Array.from({ length: count + 1 }, (_, index) => from + ((to - from) * index) / count);

/** The line of the beam: bent by a contact, straight where it is clear, and otherwise only between measured points. */
function line(shown, drawn, seen, bent, scale) {
  const along = (name, points, deflection) =>
    svg("polyline", { class: name, points: points.map((at) => `${scale.x(at)},${scale.y(deflection(at))}`).join(" ") });
  const whole = [0, scale.length];
  if (shown.kind === "clear") return [along("bent", whole, () => 0)];
  const rest = along("rest", whole, () => 0);
  if (!drawn && seen.length < 2) return [rest];
  if (!bent) {
    const points = seen.map((one) => `${scale.x(one.position_mm)},${scale.y(one.deflection_mm)}`);
    return [rest, svg("polyline", { class: "doubt", points: points.join(" ") })];
  }
  if (drawn) return [rest, along("bent", places(...whole), bent)];
  const [first, last] = [seen[0].position_mm, seen.at(-1).position_mm];
  const outside = [along("guessed", [0, first], bent), along("guessed", [last, scale.length], bent)];
  return [rest, ...outside, along("bent", places(first, last), bent)];
}

function mark(channel, shown, scale) {
  const kind = channel.name === shown.suspect ? "seen suspect" : "seen";
  return svg("circle", { class: kind, cx: scale.x(channel.position_mm), cy: scale.y(channel.deflection_mm), r: 4 });
}

function touch(contact, bent, scale) {
  const bounded = (at) => scale.x(Math.min(Math.max(at, 0), scale.length));
  const x = bounded(contact.position_mm);
  const y = scale.y(bent(contact.position_mm)) - 4;
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
