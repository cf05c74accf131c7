// The list of what needs a technician now, on all surfaces of the service.

import { byId, html } from "./dom.js";
import { heard, say } from "./say.js";
import { inZone } from "./times.js";

const AGAIN_MS = 5000;
const MOST = 20; // of a plant, more are no list that anyone reads

export class Alarms {
  constructor(token) {
    this.token = token;
    this.timer = null;
    this.seen = new Map(); // alarm -> when this page first saw it
    this.said = "";
  }

  /**
   * Ask now, and from now on every few seconds. An answer that does not come leaves no list: it would be an old one.
   *
   * isShared: whether other services have a part of the surfaces; then none has the whole list.
   */
  async follow(isShared) {
    clearTimeout(this.timer);
    if (isShared) return this.show([]);
    let alarms = [];
    try {
      const answer = await this.token.ask("alarms");
      if (answer.ok) alarms = listed(await answer.json());
    } catch {
      // The feed says that the connection is lost.
    }
    this.show(alarms);
    clearTimeout(this.timer);
    this.timer = setTimeout(() => this.follow(isShared), AGAIN_MS);
  }

  /** Only what is new is written: a screen reader announces it once. After midnight each time has its day, too. */
  show(alarms) {
    const now = new Date();
    this.seen = new Map(alarms.map(({ key }) => [key, this.seen.get(key) ?? now]));
    const text = JSON.stringify(alarms.map(({ key, since }) => [key, inZone(since ?? this.seen.get(key))]));
    if (text === this.said) return;
    this.said = text;
    const rest = alarms.length - MOST;
    byId("alarms").replaceChildren(
      ...alarms.slice(0, MOST).map((alarm) => this.line(alarm)),
      ...(rest > 0 ? [html("li", {}, say`and ${rest} more`)] : []),
    );
    byId("alarms-section").hidden = alarms.length === 0;
  }

  line({ key, surface, name, title, detail, since }) {
    const where = surface ? html("a", { href: `?surface=${encodeURIComponent(surface)}` }, surface) : `[${name}]`;
    const when = since ? [say`since`, since] : [say`seen since`, this.seen.get(key).toISOString()];
    const time = html("time", { datetime: when[1] }, inZone(when[1]));
    return html("li", {}, html("strong", {}, where, title ? `: ${heard(title)}` : ""), ` ${when[0]} `, time, html("p", {}, heard(detail)));
  }
}

/** Return the alarms of an answer; `key` is the same for as long as an alarm lasts. */
function listed({ surfaces, missing }) {
  const ofSurfaces = Object.entries(surfaces).map(([surface, { type, title, detail, since }]) => ({
    key: `${surface} ${type}`, surface, title, detail, since,
  }));
  const ofParts = Object.entries(missing).map(([name, detail]) => ({ key: `[${name}]`, name, detail }));
  return [...ofParts, ...ofSurfaces];
}
