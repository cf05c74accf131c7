// How the sensors have changed, in words.

import { byId, html } from "./dom.js";
import { heard, say } from "./say.js";
import { day } from "./times.js";

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
      this.show([...(wiring ? [faultsOf(wiring)] : []), ...sentences(health ?? {})]);
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

/** The fault of the wiring, or both that explain the contacts, in a sentence. */
export const faultsOf = (wiring) => say`Wiring: ${wiring.split(", or ").map(heard).join(say`, or `)}.`;

/** A sentence for each change of a sensor that is certain. `health`: name -> what the service says of it. */
function sentences(health) {
  return Object.entries(health)
    .filter(([, one]) => one.changed)
    .flatMap(([name, one]) => one.changes.map((part) => CHANGES[part]?.(name, one, day(one.since)) ?? `${name}: ${part}`));
}

const CHANGES = {
  gain: (name, { gain_percent: percent }, since) =>
    percent < 0
      ? say`${name} has lost ${round(-percent)} % since ${since}.`
      : say`${name} has gained ${round(percent)} % since ${since}.`,
  zero: (name, { zero_mm: zero, unit }, since) =>
    zero < 0
      ? say`${name} reads ${small(-zero, unit)} too little at rest since ${since}.`
      : say`${name} reads ${small(zero, unit)} too much at rest since ${since}.`,
};

const small = (value, unit) =>
  unit === "mm" ? `${(value * 1000).toFixed(0)} µm` : `${Number(value.toPrecision(2))} ${unit}`;

const round = (percent) => percent.toFixed(percent < 3 ? 1 : 0);
