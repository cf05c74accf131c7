// The table of the sensors.

import { byId, html, setText, sign } from "./dom.js";
import { inWords, placeOf } from "./places.js";
import { inWords as qualityInWords } from "./qualities.js";
import { say } from "./say.js";

const MM = "mm";

/** Fill the table of channels; its rows stay, only what changed in them is written. `suspect`: name of one, or null. */
export function drawChannels(channels, suspect = null) {
  const body = byId("channels");
  setText(byId("deflection-unit"), channels[0]?.unit ?? MM);
  while (body.rows.length > channels.length) body.deleteRow(-1);
  channels.forEach((channel, index) => {
    drawChannel(body.rows[index] ?? body.appendChild(channelRow()), channel, channel.name === suspect);
  });
}

function channelRow() {
  return html("tr", {}, html("th", { scope: "row" }), html("td"), html("td"), html("td"));
}

function drawChannel(row, channel, suspect) {
  const { name, deflection_mm: deflection, quality, unit } = channel;
  const [title, place, value, words] = row.cells;
  setText(title, name);
  setText(place, inWords(placeOf(channel), 1));
  setText(value, deflection === null ? "—" : signed(deflection, unit));
  const text = suspect ? say`check first` : qualityInWords(quality);
  if (words.textContent === text) return;
  const kind = suspect ? "suspect" : quality === "good" || quality === "unknown" ? quality : "bad";
  words.className = `words ${kind}`;
  words.replaceChildren(sign(suspect ? "unknown" : kind), text);
}

/** With a true minus, and none before a zero; to a micrometre, or to four digits in other units than mm. */
function signed(value, unit) {
  const text = unit === MM ? value.toFixed(3) : `${Number(value.toPrecision(4))}`;
  return text.replace(/^-(0\.0+)$/, "$1").replace("-", "−");
}
