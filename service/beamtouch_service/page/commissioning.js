// Commissioning: what to press, what was seen, the verdict, and its download. Asks only while it is open.
//
// The write token is held in memory and nowhere else, and sent in a header only.

import { below, own, PLAIN } from "./answer.js";
import { byId, html, setText, sign, svg } from "./dom.js";
import { inWords } from "./places.js";
import { heard, say } from "./say.js";
import { inZone } from "./times.js";
import { possible, refuses } from "./token.js";

const EVERY_MS = 300;
const ASK_MS = 20_000; // a record that is away may take that long to say so
const GONE = say`The service was restarted, or somebody ended this commissioning. Begin again.`;
const LOST = say`The service does not answer. Trying again.`;
const MEMORY = say`This service keeps its record in memory only: download the result before it stops.`;
const INTRODUCTION = [
  say`Press above each sensor, then at marks, while the page watches every channel. It takes some three minutes.`,
  say`Tare the sensors first, and take everything off.`,
].join(" ");
const KINDS = { right: "good", dead: "bad", inverted: "bad", swapped: "bad", gain: "bad", unsure: "unsure", unseen: "unsure" };
const SIGNS = { good: "good", bad: "bad", unsure: "unknown" };

const part = (name) => byId(`commissioning-${name}`);

export class Commissioning {
  constructor(token) {
    this.token = token;
    this.write = null; // the write token, once the service has accepted it
    this.surface = null;
    this.isOpen = false;
    this.round = 0; // of asking: an answer of an earlier one is not shown
    this.timer = null;
    this.forget();
    part("open").addEventListener("click", () => this.open());
    part("close").addEventListener("click", () => this.close());
    part("begin").addEventListener("submit", (event) => this.begin(event));
    part("confirm").addEventListener("submit", (event) => this.confirm(event));
    part("skip").addEventListener("click", () => this.act("skip", `/skip?run=${this.run?.id}&step=${this.run?.step}`));
    part("abandon").addEventListener("click", () => this.act("abandon", `/abandon?run=${this.run?.id}`));
    for (const format of ["text", "json"]) part(format).addEventListener("click", () => this.download(format));
  }

  /** Return where to press now, if anywhere: a dashed arrow over the beam, or a dashed ring on the plate. */
  aim(scale) {
    const at = this.isOpen ? (this.run?.at_mm ?? null) : null;
    if (at === null) return [];
    if (scale.isPlate) return [svg("circle", { class: "target", cx: scale.x(at.x), cy: scale.y(at.y), r: 14 })];
    const x = scale.x(at.position);
    const y = scale.y(0) - 5;
    return [
      svg("path", { class: "target", d: `M${x} 4V${y - 11}` }),
      svg("path", { class: "target-tip", d: `M${x} ${y}l-8-12h16z` }),
    ];
  }

  forget() {
    this.run = null;
    this.lasting = true;
    this.newest = null; // the newest result on record
    this.note = ""; // why a commissioning that was seen is gone
  }

  follow(surface) {
    if (surface === this.surface) return;
    this.surface = surface;
    this.forget();
    if (surface === null) this.close();
    else if (this.isOpen) this.ask();
  }

  open() {
    if (this.surface === null) return;
    this.isOpen = true;
    byId("commissioning").hidden = false;
    part("title").focus();
    part("title").scrollIntoView({ block: "start" });
    this.askNewest();
    this.ask();
  }

  close() {
    if (!this.isOpen) return;
    this.isOpen = false;
    this.round++;
    clearTimeout(this.timer);
    this.write = null;
    part("token").value = "";
    byId("commissioning").hidden = true;
    part("open").focus();
  }

  path(rest = "") {
    return `surfaces/${encodeURIComponent(this.surface)}/commissioning${rest}`;
  }

  /** Ask how far it is, now and then every moment while it is open. */
  async ask() {
    clearTimeout(this.timer);
    if (!this.isOpen) return;
    const round = ++this.round;
    try {
      const answer = await this.token.ask(this.path());
      const body = await answer.json();
      if (round !== this.round) return;
      if (answer.ok) this.take(body);
      else setText(part("prompt"), heard(body.title) ?? LOST);
    } catch {
      if (round !== this.round) return;
      setText(part("prompt"), LOST);
    }
    this.timer = setTimeout(() => this.ask(), EVERY_MS);
  }

  async askNewest() {
    try {
      const answer = await this.token.ask(this.path("s"));
      this.newest = answer.ok ? ((await answer.json()).commissionings[0] ?? null) : null;
    } catch {
      // It is asked for again when the section is opened again.
    }
    this.draw();
  }

  take({ run, ended, lasting }) {
    const before = this.run;
    this.run = run;
    this.lasting = lasting;
    if (before && !run) {
      this.note = heard(ended) ?? GONE;
      this.askNewest(); // somebody else may have put it on record
    }
    this.draw();
  }

  begin(event) {
    event.preventDefault();
    if (!this.run) this.act("start", "");
  }

  confirm(event) {
    event.preventDefault();
    const by = part("by").value.trim();
    if (!by) return this.complain(say`Type your name.`, "by");
    this.act("confirm", `/confirm?run=${this.run?.id}&by=${encodeURIComponent(by)}`);
  }

  async act(action, query) {
    const text = this.write ?? part("token").value.trim();
    setText(part("error"), "");
    if (!possible(text)) return this.complain(say`Type the write token of the service.`, "token");
    clearTimeout(this.timer); // what is asked meanwhile would be shown after this
    this.round++;
    try {
      const headers = { Authorization: `Bearer ${text}` };
      const signal = AbortSignal.timeout(ASK_MS);
      const answer = own(await fetch(below(this.path(query)), { method: "POST", ...PLAIN, headers, signal }));
      const body = await answer.json();
      if (refuses(answer)) {
        this.write = null;
        this.draw();
        this.complain(heard(body.detail), "token");
        return this.ask();
      }
      this.write = text;
      part("token").value = "";
      if (!answer.ok) this.complain(`${heard(body.title)}. ${heard(body.detail)}`);
      else if (action === "confirm") this.recorded(body);
      else this.done(action, body);
    } catch {
      this.complain(LOST);
    }
    this.ask();
  }

  recorded(result) {
    this.run = null;
    this.newest = result;
    this.note = say`The result is on record as number ${result.id}.`;
    this.draw();
  }

  done(action, state) {
    if (action === "abandon") this.run = null;
    this.note = action === "abandon" ? (heard(state.ended) ?? "") : "";
    this.take(state);
  }

  complain(words, field = null) {
    setText(part("error"), words);
    if (field) part(field).focus();
  }

  draw() {
    const { run, newest } = this;
    const isDone = run !== null && run.step >= run.steps;
    setText(part("prompt"), run ? heard(run.prompt) : this.note || say`No commissioning is under way.`);
    setText(part("help"), run ? (this.lasting || !isDone ? "" : MEMORY) : INTRODUCTION);
    part("held").hidden = run?.stage !== "hold";
    part("held").value = run?.held ?? 0;
    drawSteps(run);
    drawVerdict((run?.report.verdict ?? []).map(heard));
    part("token-row").hidden = this.write !== null;
    part("begin").hidden = run !== null && this.write !== null;
    part("start").hidden = part("start").disabled = run !== null; // disabled, it takes no Enter
    part("skip").hidden = !run || isDone;
    part("confirm").hidden = !isDone;
    part("abandon").hidden = !run;
    part("newest").hidden = newest === null || run !== null;
    if (newest) setText(part("newest-words"), say`On record: ${summary(newest)}`);
  }

  /** The service makes the file; a link could not carry the token. */
  async download(format) {
    const { id } = this.newest;
    try {
      const answer = await this.token.ask(this.path(`s/${id}?format=${format}`));
      if (!answer.ok) return this.complain(heard((await answer.json()).detail));
      const link = html("a", {
        href: URL.createObjectURL(await answer.blob()),
        download: `commissioning-${this.surface}-${id}.${format === "text" ? "txt" : "json"}`,
      });
      link.click();
      URL.revokeObjectURL(link.href);
    } catch {
      this.complain(LOST);
    }
  }
}

const passed = (report) => (report.passed ? say`passed` : say`not passed`);

function summary(report) {
  const verdict = report.verdict.map(heard).join(" ");
  return say`${passed(report)}, ${inZone(report.ended_at)}, by ${report.by}. ${verdict}`;
}

/** The steps as a list; its items stay, only what changed in them is written. */
function drawSteps(run) {
  const list = part("steps");
  list.hidden = !run;
  const steps = run ? [...run.report.sensors.map(ofSensor), ...run.report.places.map(ofPlace)] : [];
  while (list.children.length > steps.length) list.lastChild.remove();
  steps.forEach(({ title, says, kind }, index) => {
    const item = list.children[index] ?? list.appendChild(html("li"));
    const text = says ? `${title}: ${says}` : title;
    item.className = [index === run.step ? "current" : "", kind ?? ""].join(" ").trim();
    if (index === run.step) item.setAttribute("aria-current", "step");
    else item.removeAttribute("aria-current");
    if (item.textContent !== text) item.replaceChildren(...(kind ? [sign(SIGNS[kind])] : []), text);
  });
}

function ofSensor({ name, at_mm: at, finding, says }) {
  return { title: `${name}, ${inWords(Object.values(at), 0)} mm`, says: heard(says), kind: KINDS[finding] };
}

function ofPlace({ at_mm: at, says, stated_mm: stated, error_mm: error, allowed_mm: allowed }) {
  const isRight = error !== null && Object.entries(error).every(([axis, mm]) => Math.abs(mm) <= allowed[axis]);
  const middles = Object.values(stated ?? {}).map(([middle]) => middle);
  const said = says?.split("; ").map(heard).join("; ");
  const words = middles.length ? `${inWords(middles, 1)} mm, ${said}` : said;
  const title = say`mark at ${inWords(Object.values(at), 0)} mm`;
  return { title, says: words, kind: says ? (isRight ? "good" : "bad") : undefined };
}

function drawVerdict(sentences) {
  const list = part("verdict");
  list.hidden = sentences.length === 0;
  if (list.dataset.of === sentences.join("\n")) return;
  list.dataset.of = sentences.join("\n");
  list.replaceChildren(...sentences.map((one) => html("li", {}, one)));
}
