// How the candidate for the model of a surface differs from it, in a sentence.

import { byId, setText } from "./dom.js";
import { say } from "./say.js";

const AGAIN_MS = 10_000;
const VERDICTS = new Map([
  [true, say`It is worse.`],
  [false, say`Nothing speaks against it.`],
  [null, say`These are too few to judge it.`],
]);

export class Candidate {
  constructor(token) {
    this.token = token;
    this.timer = null;
  }

  /** Ask now, and from now on every few seconds. */
  async follow(surface) {
    clearTimeout(this.timer);
    if (surface !== this.surface) setText(byId("candidate"), "");
    this.surface = surface;
    if (!surface) return;
    try {
      const answer = await this.token.ask(`surfaces/${encodeURIComponent(surface)}/candidate`);
      const found = answer.ok ? await answer.json() : {};
      if (surface !== this.surface) return;
      setText(byId("candidate"), words(found));
    } catch {
      // The feed says that the connection is lost.
    }
    clearTimeout(this.timer);
    this.timer = setTimeout(() => this.follow(this.surface), AGAIN_MS);
  }
}

/** Nothing without a candidate. The rest of what is known of it stands at the address that was asked. */
function words({ candidate, comparison, error }) {
  if (error) return say`The candidate for the model is not compared: ${error.replace(/\.$/, "")}.`;
  if (!candidate || !comparison) return "";
  const { differing, samples, figures, is_worse: isWorse } = comparison;
  const apart = Object.entries(figures).map(([name, one]) => inFigure(name, one));
  const state = say`Candidate ${candidate} for the model: another state in ${differing} of ${samples} samples.`;
  return [state, ...(apart.length ? [say`Contacts differ by ${apart.join(", ")}.`] : []), VERDICTS.get(isWorse)].join(" ");
}

/** As "0.12 mm", of a plate with the axis before it. */
function inFigure(name, { mean_size: size }) {
  const [figure, unit] = name.split("_");
  const axis = figure.length === 1 ? `${figure} ` : "";
  return `${axis}${Number(size.toPrecision(2))} ${unit === "n" ? "N" : unit}`;
}
