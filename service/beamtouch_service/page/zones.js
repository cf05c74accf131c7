// The zones of the configuration: drawn over the beam, and listed with the answer for each.

import { html, setText, svg } from "./dom.js";

const UNKNOWN = "—";
const LABEL_LEAST_PX = 160; // height of a drawing with room for names

/** Return the zones as bands over the beam, each in the style of its answer; `answers` by name, or null. */
export function bands(zones, answers, scale, height) {
  return Object.entries(zones).flatMap(([name, { from_mm: from, to_mm: to }], place) => {
    const [x, width] = [scale.x(from), (to - from) * scale.perMm];
    const kind = `zone ${answers?.[name] ?? "unknown"}`;
    const band = svg("rect", { class: kind, x, y: 1, width, height: scale.axisY - 1, "data-zone": name });
    if (height < LABEL_LEAST_PX) return [band];
    const y = scale.barY - 4 - 13 * (place % 2);
    return [band, svg("text", { class: "muted", x: x + 5, y }, name)];
  });
}

/** Fill a list with the zones and their answers; its items stay, only what changed in them is written. */
export function listZones(list, zones, answers) {
  const names = Object.keys(zones);
  while (list.children.length > names.length) list.lastChild.remove();
  names.forEach((name, index) => {
    const item = list.children[index] ?? list.appendChild(html("li"));
    const { from_mm: from, to_mm: to } = zones[name];
    setText(item, `${name}, ${from} … ${to} mm: ${answers?.[name] ?? UNKNOWN}`);
    item.className = answers?.[name] ?? "unknown";
  });
}
