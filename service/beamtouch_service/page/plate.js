// The plate from above, to scale: its supports, its sensors, its zones, and the contact with the region that holds 95 %.

import { hatch } from "./beam_parts.js";
import { roundTicks, svg } from "./dom.js";
import { inWords, intervalOf, placeOf } from "./places.js";
import { inWords as qualityInWords } from "./qualities.js";
import { say } from "./say.js";

const [LEFT, RIGHT, TOP, BOTTOM] = [44, 14, 14, 30];
const LEAST_PX = 6; // of a sensor
const BOX_PX = 12; // of a sensor whose size the model does not state
const NORMAL = 1.96; // half-width of a 95 % interval in standard deviations
const WITHIN = Math.sqrt(-2 * Math.log(0.05)); // radius of the circle that holds 95 % of two of them
const CORNERS = 64; // of an ellipse

/** Draws into an <svg>, whose width decides how much room there is. */
export class PlateView {
  constructor(element, caption) {
    this.element = element;
    this.caption = caption;
  }

  forget() {}

  /** `drawn`: supports by the model, or null while they are not known; `under` and `over` as for a beam. */
  draw(shown, drawn, under, over) {
    const { width, height } = this.element.getBoundingClientRect();
    if (width < 50 || !shown.length) {
      this.element.replaceChildren();
      this.caption(say`The plate is drawn once the service says what it looks like.`);
      return;
    }
    const scale = scaleOf(shown, width, height);
    this.element.setAttribute("viewBox", `0 0 ${width} ${height}`);
    this.element.replaceChildren(
      hatch(),
      svg("rect", { class: "plate", ...box(scale, [0, scale.length], [0, scale.width]) }),
      ...under(scale),
      ...axes(scale),
      ...(drawn?.supports ?? []).map((one) => support(one, scale)),
      ...shown.channels.flatMap((channel) => sensor(channel, shown, drawn, scale)),
      ...over(scale),
      ...(shown.kind === "contact" ? touch(shown.contact, scale) : []),
    );
    this.caption(captionOf(shown, drawn));
  }
}

/** The same scale along both axes; `y` grows upwards, as on a drawing. */
function scaleOf({ length, width: across }, width, height) {
  const perMm = Math.min((width - LEFT - RIGHT) / length, (height - TOP - BOTTOM) / across);
  const left = LEFT + (width - LEFT - RIGHT - length * perMm) / 2;
  return {
    perMm,
    length,
    width: across,
    isPlate: true,
    x: (at) => left + at * perMm,
    y: (at) => TOP + (across - at) * perMm,
  };
}

/** The rectangle between two coordinates of each axis. */
export function box(scale, [left, right], [below, above]) {
  const [x, y] = [scale.x(left), scale.y(above)];
  return { x, y, width: Math.max(scale.x(right) - x, 0), height: Math.max(scale.y(below) - y, 0) };
}

function axes(scale) {
  const parts = [];
  const bottom = scale.y(0);
  for (const tick of roundTicks(0, scale.length, Math.max(2, (scale.length * scale.perMm) / 90))) {
    const x = scale.x(tick);
    parts.push(svg("path", { class: "axis", d: `M${x} ${bottom}v5` }));
    const isLast = tick + 1e-6 > scale.length;
    const words = tick === 0 ? "" : isLast ? `x ${tick} mm` : `${tick}`;
    parts.push(svg("text", { class: "muted", x: x + (isLast ? 12 : 0), y: bottom + 19, "text-anchor": isLast ? "end" : "middle" }, words));
  }
  for (const tick of roundTicks(0, scale.width, Math.max(2, (scale.width * scale.perMm) / 60))) {
    const y = scale.y(tick);
    parts.push(svg("path", { class: "axis", d: `M${scale.x(0)} ${y}h-5` }));
    const words = tick + 1e-6 > scale.width ? `y ${tick}` : `${tick}`;
    parts.push(svg("text", { class: "muted", x: scale.x(0) - 8, y: y + 4, "text-anchor": "end" }, words));
  }
  return parts;
}

/** A rigid support is a triangle, one that gives way a ring, each in a point; a line is a bar. */
function support({ at_mm: at, across_mm: across, end_mm: end, kind }, scale) {
  const [x, y] = [scale.x(at), scale.y(across)];
  const name = `support ${kind}`;
  if (end) return svg("path", { class: `${name} line`, d: `M${x} ${y}L${scale.x(end[0])} ${scale.y(end[1])}` });
  if (kind === "spring") return svg("circle", { class: name, cx: x, cy: y, r: 9 });
  return svg("path", { class: name, d: `M${x} ${y - 10}l9 16h-18z` });
}

/** Sensors that work are full boxes, to scale; others are empty with a cross, and say why. */
function sensor(channel, shown, drawn, scale) {
  const side = Math.max(LEAST_PX, (drawn?.sensor_mm ?? 0) * scale.perMm || BOX_PX);
  const [x, y] = [scale.x(channel.x_mm), scale.y(channel.y_mm)];
  const works = channel.quality === "good" || channel.quality === "unknown";
  const suspect = works && channel.name === shown.suspect;
  const kind = channel.quality === "good" ? "sensor" : `sensor ${works ? "unknown" : "bad"}`;
  const [left, top] = [x - side / 2, y - side / 2];
  const parts = [svg("rect", { class: suspect ? "sensor suspect" : kind, x: left, y: top, width: side, height: side })];
  if (!works) parts.push(svg("path", { class: "sensor bad", d: `M${left} ${top}l${side} ${side}m0-${side}l-${side} ${side}` }));
  const words = suspect ? say`check ${channel.name}` : works ? channel.name : `${channel.name} ${qualityInWords(channel.quality)}`;
  const isRight = channel.x_mm > scale.length / 2;
  const isHigh = channel.y_mm > scale.width / 2;
  const at = {
    x: x + (isRight ? -1 : 1) * (side / 2 + 4),
    y: isHigh ? y + side / 2 + 13 : y - side / 2 - 4, // towards the middle: the rim has supports
    "text-anchor": isRight ? "end" : "start",
    class: suspect ? "suspect" : works ? "" : "bad",
  };
  return [...parts, svg("text", at, words)];
}

function touch(contact, scale) {
  const [x, y] = [scale.x(contact.x_mm), scale.y(contact.y_mm)];
  const onRight = contact.x_mm > scale.length * 0.6;
  const isHigh = contact.y_mm > scale.width * 0.85;
  const at = { class: "here", x: x + (onRight ? -14 : 14), y: isHigh ? y + 26 : y - 12, "text-anchor": onRight ? "end" : "start" };
  return [
    ...region(contact, scale),
    svg("path", { class: "touch", d: `M${x - 9} ${y}h18M${x} ${y - 9}v18` }),
    svg("circle", { class: "tip", cx: x, cy: y, r: 4 }),
    svg("text", at, `${inWords(placeOf(contact), 1)} mm`),
  ];
}

/** Draw where 95 % of such contacts are: an ellipse, or the box of both intervals if the model states no correlation. */
function region(contact, scale) {
  const across = { fill: "url(#hatch)", id: "bar", class: "bar" };
  const spans = [intervalOf(contact, "x", scale.length), intervalOf(contact, "y", scale.width)];
  if (spans.includes(null)) return [];
  if (typeof contact.place_correlation !== "number") return [svg("rect", { ...across, ...box(scale, ...spans) })];
  const points = ellipse(contact).map(([x, y]) => {
    const [at, up] = [Math.min(Math.max(x, 0), scale.length), Math.min(Math.max(y, 0), scale.width)];
    return `${scale.x(at).toFixed(1)},${scale.y(up).toFixed(1)}`;
  });
  return [svg("polygon", { ...across, points: points.join(" ") })];
}

/** The corners of the ellipse in mm. Its middle is that of the intervals, whose half-widths give the deviations. */
function ellipse(contact) {
  const along = (axis) => {
    const [low, high] = [contact[`${axis}_low_mm`], contact[`${axis}_high_mm`]];
    return { middle: (low + high) / 2, reach: (WITHIN * (high - low)) / 2 / NORMAL };
  };
  const [x, y] = [along("x"), along("y")];
  const shared = Math.min(Math.max(contact.place_correlation, -1), 1);
  const own = Math.sqrt(1 - shared * shared);
  return Array.from({ length: CORNERS }, (_, index) => {
    const [sin, cos] = [Math.sin, Math.cos].map((of) => of((2 * Math.PI * index) / CORNERS));
    return [x.middle + x.reach * cos, y.middle + y.reach * (shared * cos + own * sin)];
  });
}

function captionOf(shown, drawn) {
  const words = [say`The plate from above, to scale.`];
  if (drawn?.supports.some(({ kind }) => kind === "spring")) words.push(say`Rings: supports that give way.`);
  if (shown.kind !== "contact") return words.join(" ");
  const isEllipse = typeof shown.contact.place_correlation === "number";
  const hatched = isEllipse
    ? say`Hatched: where 95 % of such contacts are.`
    : say`Hatched: the 95 % intervals of x and y.`;
  return [...words, hatched].join(" ");
}
