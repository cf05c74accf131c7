// The zones of a surface: drawn behind it, and listed, each with its answer in the contact. Either may be null.

import { html, setText, svg } from "./dom.js";
import { box } from "./plate.js";
import { say } from "./say.js";

const UNKNOWN = "—";
const ANSWERS = { inside: say`inside`, outside: say`outside`, unsure: say`unsure` };
const LABEL_LEAST_PX = 160; // height of a drawing with room for names

/** Return the zones behind the drawing, each in the style of its answer: bands on a beam, rectangles on a plate. */
export function bands(beam, contact, scale) {
  return scale.isPlate ? rectangles(beam, contact, scale) : alongBeam(beam, contact, scale);
}

function rectangles(beam, contact, scale) {
  return Object.entries(beam?.zones ?? {}).flatMap(([name, { x_mm: x, y_mm: y }]) => {
    const kind = `zone ${contact?.zones?.[name] ?? "unknown"}`;
    const at = { class: "muted", x: scale.x((x[0] + x[1]) / 2), y: scale.y(y[0]) - 6, "text-anchor": "middle" };
    return [svg("rect", { class: kind, ...box(scale, x, y), "data-zone": name }), svg("text", at, name)];
  });
}

function alongBeam(beam, contact, scale) {
  return Object.entries(beam?.zones ?? {}).flatMap(([name, { from_mm: from, to_mm: to }], place) => {
    const [x, width] = [scale.x(from), (to - from) * scale.perMm];
    const kind = `zone ${contact?.zones?.[name] ?? "unknown"}`;
    const band = svg("rect", { class: kind, x, y: 1, width, height: scale.axisY - 1, "data-zone": name });
    if (scale.height < LABEL_LEAST_PX) return [band];
    const y = scale.barY - 4 - 13 * (place % 2);
    return [band, svg("text", { class: "muted", x: x + 5, y }, name)];
  });
}

/** Fill a list with the zones and their answers; its items stay, only what changed in them is written. */
export function listZones(list, beam, contact) {
  const zones = Object.entries(beam?.zones ?? {});
  while (list.children.length > zones.length) list.lastChild.remove();
  zones.forEach(([name, zone], index) => {
    const item = list.children[index] ?? list.appendChild(html("li"));
    const answer = contact?.zones?.[name];
    setText(item, `${name}, ${where(zone)} mm: ${ANSWERS[answer] ?? answer ?? UNKNOWN}`);
    item.className = answer ?? "unknown";
  });
}

const where = ({ from_mm: from, to_mm: to, x_mm: x, y_mm: y }) =>
  x ? `x ${x[0]} … ${x[1]}, y ${y[0]} … ${y[1]}` : `${from} … ${to}`;
