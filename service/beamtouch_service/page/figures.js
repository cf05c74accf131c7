// The large figures and their charts: one for each figure of the table.

import { byId, html, setText, svg } from "./dom.js";
import { FIGURES } from "./fields.js";
import { named, say } from "./say.js";
import { drawStrip } from "./strip.js";

/** The figures of a surface, which take the place of those of another number of axes. */
export class Figures {
  constructor() {
    this.shape(1);
  }

  /** Make the elements for a surface with this number of axes. */
  shape(axes) {
    if (axes === this.axes) return;
    this.axes = axes;
    this.all = FIGURES[axes];
    byId("figures").replaceChildren(...this.all.map(figure));
    byId("charts").replaceChildren(...this.all.filter(({ ends }) => ends).map(chart));
  }

  /** Show texts, as `figures` of state.js returns them. */
  write(texts) {
    for (const { id } of this.all) {
      setText(byId(id), texts[id].value);
      setText(byId(`${id}-interval`), texts[id].below);
    }
  }

  /** Draw the last minute; `size` of the surface along each axis in mm. */
  drawCharts(history, size) {
    for (const { id, name, ends, axis } of this.all) {
      if (!ends) continue;
      const range = axis === null ? history.range(name, ends[1]) : [0, size[axis] ?? 100];
      drawStrip(byId(`${id}-strip`), history, [name, ...ends], range);
    }
  }
}

function figure({ id, label, unit, axis }) {
  return html(
    "div",
    { class: `figure ${axis === null ? id : "place"}` },
    html("dt", { id: `${id}-name` }, named(label)),
    html("dd", {}, html("span", { class: "digits", id }, "—"), " ", html("span", { class: "unit" }, unit)),
    html("dd", { class: "interval", id: `${id}-interval` }),
  );
}

function chart({ id, label, unit }) {
  return html(
    "figure",
    {},
    html("figcaption", { id: `${id}-chart` }, say`${named(label)} in ${unit}, last minute`),
    svg("svg", { id: `${id}-strip`, role: "img", "aria-labelledby": `${id}-chart` }),
  );
}
