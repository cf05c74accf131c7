// How the sensors have changed, in words.

import { byId, html } from "./dom.js";

const AGAIN_MS = 10_000;

export class Health {
  constructor(token) {
    this.token = token;
    this.timer = null;
    this.said = "";
  }

  /** Ask now, and from now on every few seconds. */
  async follow(surface) {
    clearTimeout(this.timer);
    if (surface !== this.surface) this.show([]);
    this.surface = surface;
    if (!surface) return;
    try {
      const answer = await this.token.ask(`surfaces/${encodeURIComponent(surface)}`);
      const { health, wiring } = answer.ok ? await answer.json() : {};
      if (surface !== this.surface) return;
      this.show([...(wiring ? [`Wiring: ${wiring}.`] : []), ...sentences(health ?? {})]);
    } catch {
      // The feed says that the connection is lost; what has changed is still changed.
    }
    clearTimeout(this.timer);
    this.timer = setTimeout(() => this.follow(this.surface), AGAIN_MS);
  }

  /** Only what is new is written: a screen reader announces it once. */
  show(lines) {
    const text = lines.join();
    if (text === this.said) return;
    this.said = text;
    byId("health").replaceChildren(...lines.map((line) => html("li", {}, line)));
  }
}

/** A sentence for each sensor that has changed for certain. `health`: name -> what the service says of it. */
function sentences(health) {
  return Object.entries(health)
    .filter(([, one]) => one.changed)
    .map(([name, one]) => `${name} ${one.changes.map((part) => CHANGES[part]?.(one) ?? part).join(", and ")} since ${day(one.since)}.`);
}

const CHANGES = {
  gain: ({ gain_percent: percent }) => `has ${percent < 0 ? "lost" : "gained"} ${round(Math.abs(percent))} %`,
  zero: ({ zero_mm: zero, unit }) => `reads ${small(Math.abs(zero), unit)} too ${zero < 0 ? "little" : "much"} at rest`,
};

const small = (value, unit) =>
  unit === "mm" ? `${(value * 1000).toFixed(0)} µm` : `${Number(value.toPrecision(2))} ${unit}`;

const round = (percent) => percent.toFixed(percent < 3 ? 1 : 0);

function day(at) {
  const date = new Date(at);
  const year = date.getFullYear() === new Date().getFullYear() ? {} : { year: "numeric" };
  return date.toLocaleDateString("en-GB", { day: "numeric", month: "long", ...year });
}
