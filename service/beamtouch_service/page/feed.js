// The connection to the service: one stream of one surface, opened again and again until it stands.

const SILENT_MS = 2000;
const FIRST_MS = 6000;
const RETRY_MS = 1500;
const ASK_MS = 5000;

/** Milliseconds between two moments, by the clock that says more: one may sleep with the machine, the other be set. */
const between = (from, to) => Math.max(to.steady - from.steady, to.wall - from.wall, 0);
const present = () => ({ steady: performance.now(), wall: Date.now() });

export class Feed {
  /** `onMessage` is called with each message of the chosen surface, `onOpen` with the list of surfaces. */
  constructor(onMessage, onOpen) {
    this.link = "waiting"; // "waiting" for the first message, "open", "lost"
    this.since = null; // Date of the last news, while lost
    this.message = null;
    this.shape = null; // the last message that said what the beam looks like; its measurements are old
    this.surfaces = [];
    this.chosen = null;
    this.onMessage = onMessage;
    this.onOpen = onOpen;
    this.heard = present();
    this.attempt = 0;
    this.source = null;
    this.retry = null;
  }

  /** Follow a surface by name; null follows the first. What is known of another one is dropped at once. */
  choose(name) {
    this.chosen = name;
    this.message = null;
    this.shape = null;
    if (this.link === "open") this.link = "waiting";
    this.connect();
  }

  /** How long ago the last message came, in ms. */
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
    if (this.source && this.silence > patience) this.lose();
  }

  async connect() {
    this.close();
    const attempt = ++this.attempt;
    try {
      const answer = await fetch("/surfaces", { cache: "no-store", signal: AbortSignal.timeout(ASK_MS) });
      const body = await answer.json();
      if (attempt !== this.attempt) return;
      if (!answer.ok) return this.refuse(body);
      this.surfaces = body.surfaces;
    } catch {
      if (attempt === this.attempt) this.lose();
      return;
    }
    this.chosen ??= this.surfaces[0]?.name ?? null;
    this.onOpen();
    if (this.surface) this.listen();
    else this.refuse(this.missing());
  }

  listen() {
    this.heard = present();
    this.source = new EventSource(`/surfaces/${encodeURIComponent(this.chosen)}/stream`);
    this.source.addEventListener("state", (event) => this.take(JSON.parse(event.data)));
    this.source.addEventListener("error", () => this.lose());
  }

  /** The problem that the service has no such surface. */
  missing() {
    const names = this.surfaces.map((surface) => surface.name).join(", ");
    return names
      ? { title: `There is no surface “${this.chosen}”`, detail: `There is ${names}.` }
      : { title: "The service has no surface", detail: "Start it with --model MODEL or --config FILE." };
  }

  /** The service is there, but says no: as true as any message, until asked again. */
  refuse(problem) {
    this.take({ surface: this.chosen, contact: null, problem, age_ms: null, channels: [], length_mm: null });
    this.retry = setTimeout(() => this.connect(), RETRY_MS);
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

  lose() {
    this.close();
    // A stream is not taken up where it broke: what waited in it on the way is old.
    this.since ??= new Date(this.link === "open" ? this.heard.wall : Date.now());
    this.link = "lost";
    this.message = null;
    this.retry = setTimeout(() => this.connect(), RETRY_MS);
  }

  close() {
    clearTimeout(this.retry);
    this.source?.close();
    this.source = null;
  }
}
