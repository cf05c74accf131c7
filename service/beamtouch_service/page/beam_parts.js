// The parts of the drawing that do not move with the beam: axis, supports, sensors.

import { roundTicks, svg } from "./dom.js";
import { inWords as qualityInWords } from "./qualities.js";
import { say } from "./say.js";

const LABEL_PX = 74;
const BOX_PX = 12; // height of a sensor, and its width if the model does not state one
const LEAST_PX = 3;

/** The pattern of the interval. */
export function hatch() {
  const every = { width: 6, height: 6, patternUnits: "userSpaceOnUse", patternTransform: "rotate(45)" };
  const stroke = svg("path", { d: "M1.5 0v6", class: "hatch-line" });
  return svg("defs", {}, svg("pattern", { id: "hatch", ...every }, stroke));
}

export function axis(scale) {
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

/** A simple support is a triangle under the beam, on wheels if the beam slides on it; a fixed one is a wall, outside the
 * beam if it stands at its end. */
export function supports(list, scale) {
  const y = scale.y(0);
  return list.map(({ at_mm: at, kind, slides }) => {
    const x = scale.x(at);
    if (kind === "simple" && slides) return svg("path", { class: "support", d: roller(x, y + 3) });
    if (kind === "simple") return svg("path", { class: "support", d: `M${x} ${y + 3}l9 15h-18z` });
    const left = at <= 0 ? x - 11 : at >= scale.length ? x : x - 5.5;
    return svg("path", { class: "support fixed", d: `M${left} ${y - 20}h11v40h-11z` });
  });
}

function roller(x, y) {
  const wheel = (at) => `M${at - 3} ${y + 14}a3 3 0 1 0 6 0a3 3 0 1 0-6 0`;
  return `M${x} ${y}l9 11h-18z${wheel(x - 5)}${wheel(x + 5)}`;
}

/** Sensors that work are full boxes, as wide as their housings to scale; others are empty with a cross, and say why. */
export function sensors(shown, drawn, scale) {
  const width = Math.max(LEAST_PX, (drawn?.sensor_mm ?? 0) * scale.perMm || BOX_PX);
  const left = width / 2;
  const taken = [-Infinity, -Infinity];
  return shown.channels.flatMap((channel) => {
    const x = scale.x(channel.position_mm);
    const y = scale.sensorY;
    const row = x - taken[0] >= LABEL_PX ? 0 : 1;
    taken[row] = x;
    const works = channel.quality === "good" || channel.quality === "unknown";
    const suspect = works && channel.name === shown.suspect;
    const kind = channel.quality === "good" ? "sensor" : `sensor ${works ? "unknown" : "bad"}`;
    const box = svg("rect", { class: suspect ? "sensor suspect" : kind, x: x - left, y, width, height: BOX_PX });
    const cross = svg("path", { class: "sensor bad", d: `M${x - left} ${y}l${width} ${BOX_PX}m0-${BOX_PX}l-${width} ${BOX_PX}` });
    const stands = suspect ? "suspect" : works ? "" : "bad";
    const label = svg("text", { x, y: y + 27 + row * 14, "text-anchor": "middle", class: stands });
    label.append(suspect ? say`check ${channel.name}` : works ? channel.name : `${channel.name} ${qualityInWords(channel.quality)}`);
    const lead = svg("path", { class: "lead", d: `M${x} ${scale.y(0)}V${y}` });
    return works ? [lead, box, label] : [lead, box, cross, label];
  });
}
