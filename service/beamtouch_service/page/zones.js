// The zones of a beam: drawn behind it, and listed, each with its answer in the contact. Either may be null.

import { html, setText, svg } from "./dom.js";

const UNKNOWN = "—";
const LABEL_LEAST_PX = 160; // height of a drawing with room for names

/** Return the zones as bands behind the beam, each in the style of its answer. */
export function bands(beam, contact, scale) {
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
  zones.forEach(([name, { from_mm: from, to_mm: to }], index) => {
    const item = list.children[index] ?? list.appendChild(html("li"));
    const answer = contact?.zones?.[name];
    setText(item, `${name}, ${from} … ${to} mm: ${answer ?? UNKNOWN}`);
    item.className = answer ?? "unknown";
  });
}
