// The connection to the service: one stream of one surface, opened again and again until it stands.

import { Stranger } from "./answer.js";
import { say } from "./say.js";
import { EventParser } from "./sse.js";
import { refuses } from "./token.js";

const SILENT_MS = 2000;
const FIRST_MS = 6000;
const RETRY_MS = 500; // twice as long after each failure
const MOST_RETRY_MS = 5000;
const WRONG_REPLICA = "urn:beamtouch:problem:wrong-replica";
const LOCKED_RETRY_MS = 30_000; // each refusal counts in the log of the service
const HELD_BACK = say`The service answers, but its stream does not arrive. A proxy may hold it back.`;

/** Milliseconds between two moments, by the clock that says more: one may sleep with the machine, the other be set. */
const between = (from, to) => Math.max(to.steady - from.steady, to.wall - from.wall, 0);
const present = () => ({ steady: performance.now(), wall: Date.now() });

const said = (error) => (error instanceof Stranger ? error.message : "");

export class Feed {
  /** `onMessage` is called with each message of the chosen surface, `onSurfaces` when the list of surfaces changes. */
  constructor(token, onMessage, onSurfaces) {
    this.token = token;
    this.link = "waiting"; // "waiting" for the first message, "open", "lost", "locked" for want of a token
    this.since = null; // Date of the last news, while lost
    this.why = ""; // what is known of the reason
    this.message = null;
    this.shape = null; // the last message that said what the beam looks like; its measurements are old
    this.surfaces = [];
    this.isShared = false; // whether several services share the surfaces
    this.wanted = null; // the surface that was asked for by name
    this.chosen = null; // the one that is followed
    this.onMessage = onMessage;
    this.onSurfaces = onSurfaces;
    this.heard = present();
    this.attempt = 0;
    this.stream = null; // the AbortController of the stream that is read
    this.retry = null;
    this.failures = 0; // in a row
  }

  /** Follow a surface by name; null follows the first. What is known of another one is dropped at once. */
  choose(name) {
    this.wanted = this.chosen = name;
    this.message = null;
    this.shape = null;
    this.failures = 0;
    if (this.link === "open") this.link = "waiting";
    this.connect();
  }

  /** Return how long ago the last message came, in ms. */
  get silence() {
    return between(this.heard, present());
  }

  /** The summary of the surface that is followed. */
  get surface() {
    return this.surfaces.find((surface) => surface.name === this.chosen) ?? null;
  }

  /** To be called often: a connection that says nothing is given up. */
  check() {
    const patience = this.link === "open" ? SILENT_MS : FIRST_MS;
    if (!this.stream || this.silence <= patience) return;
    this.lose(this.link === "open" ? "" : HELD_BACK); // the list of surfaces has just come
  }

  async connect() {
    this.close();
    const attempt = ++this.attempt;
    try {
      const answer = await this.token.ask("surfaces");
      const body = refuses(answer) ? null : await answer.json();
      const several = body?.type === WRONG_REPLICA ? await this.named(body.surfaces) : null;
      if (attempt !== this.attempt) return;
      if (!answer.ok && !several) return body ? this.refuse(body) : this.lock();
      this.surfaces = several ?? body.surfaces;
      this.isShared = several !== null;
    } catch (error) {
      if (attempt === this.attempt) this.lose(said(error));
      return;
    }
    this.token.accepted();
    if (this.link === "locked") this.link = "waiting";
    this.chosen ??= this.surfaces[0]?.name ?? null;
    this.onSurfaces();
    if (this.surface) this.listen();
    else this.refuse(this.missing());
  }

  /** Several services share these surfaces: only the chosen one is asked for. */
  async named(names) {
    const name = this.chosen ?? names[0];
    const answer = await this.token.ask(`surfaces/${encodeURIComponent(name)}`);
    const chosen = answer.ok ? await answer.json() : null;
    return names.map((one) => (one === name && chosen ? chosen : { name: one }));
  }

  async listen() {
    const stream = new AbortController();
    this.stream = stream;
    this.heard = present();
    let why = "";
    try {
      const path = `surfaces/${encodeURIComponent(this.chosen)}/stream`;
      const answer = await this.token.ask(path, stream.signal);
      if (answer.ok) await this.read(answer.body.getReader(), stream);
      const body = answer.ok || refuses(answer) ? null : await answer.json();
      if (!answer.ok && stream === this.stream) return body ? this.refuse(body) : this.lock();
    } catch (error) {
      why = said(error); // or broken, or given up here
    }
    if (stream === this.stream) this.lose(why);
  }

  /** Take what comes until the stream ends, or is not the one to follow any more. */
  async read(reader, stream) {
    const parser = new EventParser();
    for (;;) {
      const { done, value } = await reader.read();
      // Before it is taken: what comes after a silence too long, as of a machine that slept, has waited on the way.
      this.check();
      if (done || stream !== this.stream) return;
      for (const event of parser.push(value)) if (event.type === "state") this.hear(JSON.parse(event.data));
    }
  }

  hear(message) {
    this.failures = 0;
    this.take(message);
  }

  /** The problem that the service has no such surface. */
  missing() {
    const names = this.surfaces.map((surface) => surface.name).join(", ");
    return names
      ? { title: say`There is no surface “${this.chosen}”`, detail: say`There is ${names}.` }
      : { title: say`The service has no surface`, detail: say`Start it with --model MODEL or --config FILE.` };
  }

  /** The service is there, but says no: as true as any message, until asked again. */
  refuse(problem) {
    this.close();
    this.take({ surface: this.chosen, contact: null, problem, age_ms: null, channels: [], length_mm: null });
    this.again();
  }

  /** The service asks for a token, or for another one: nothing that it said before is shown any longer. */
  lock() {
    this.close();
    this.token.refused();
    this.link = "locked";
    this.since = null;
    this.message = null;
    this.shape = null;
    this.forget();
    // Without a token to try there is nothing to ask until one is typed in.
    if (this.token.text !== null) this.retry = setTimeout(() => this.connect(), LOCKED_RETRY_MS);
  }

  /** The surfaces too are for those who have the token. */
  forget() {
    this.surfaces = [];
    this.chosen = this.wanted;
    this.onSurfaces();
  }

  take(message) {
    if (message.surface !== this.chosen) return;
    this.link = "open";
    this.since = null;
    this.heard = present();
    this.message = message;
    if (message.length_mm !== null) this.shape = message;
    this.onMessage(message);
  }

  /** `why`: what is known of the reason, in a sentence. */
  lose(why = "") {
    this.close();
    this.why = why;
    // A stream is not taken up where it broke: what waited in it on the way is old.
    this.since ??= new Date(this.link === "open" ? this.heard.wall : Date.now());
    this.link = "lost";
    this.message = null;
    this.again();
  }

  again() {
    const wait = Math.min(RETRY_MS * 2 ** this.failures++, MOST_RETRY_MS);
    this.retry = setTimeout(() => this.connect(), wait);
  }

  close() {
    clearTimeout(this.retry);
    this.stream?.abort();
    this.stream = null;
  }
}
