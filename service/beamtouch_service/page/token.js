// The token for reading: where it is kept, and the requests that bear it. Only ever in a header: addresses end up in
// logs and histories. Not in a cookie either, which every page of this host would send along. No document here.

import { below, own, PLAIN } from "./answer.js";
import { say } from "./say.js";

// One for each service: several may share a host, each below a path of its own.
const KEY = `beamtouch-reading-token${window.location.pathname.replace(/\/[^/]*$/, "")}`;
const ASK_MS = 5000;

/** A browser may forbid to keep anything; then a token lasts until the page is left. */
function quietly(action) {
  try {
    return action();
  } catch {
    return null;
  }
}

const kept = () =>
  quietly(() => window.sessionStorage.getItem(KEY)) ?? quietly(() => window.localStorage.getItem(KEY));

export class Token {
  constructor() {
    this.text = kept(); // null: none
    this.tried = null; // while it is not known whether the service accepts what was typed: where to keep it
    this.error = ""; // what to say of a token that was refused
  }

  /** Use this token; it is kept only once the service has accepted it, for the session or until it is forgotten. */
  use(text, long) {
    this.text = text;
    this.tried = { long };
    this.error = "";
  }

  accepted() {
    const { text, tried } = this;
    this.error = "";
    this.tried = null;
    if (!tried) return;
    this.drop();
    quietly(() => (tried.long ? window.localStorage : window.sessionStorage).setItem(KEY, text));
  }

  /** The one that was kept stays: the service may have been started with a wrong one, and a panel has nobody to type. */
  refused() {
    if (this.tried) this.error = say`This token is not accepted`;
    else if (this.text !== null && !this.error) this.error = say`The token kept here is not accepted any more`;
    if (this.tried) this.text = kept();
    this.tried = null;
  }

  forget() {
    this.drop();
    this.text = null;
    this.tried = null;
    this.error = "";
  }

  /** Return whether another window has kept another token, or forgotten this one; then that holds here as well. */
  changedElsewhere() {
    const text = kept();
    if (this.tried || text === this.text) return false;
    this.error = "";
    this.text = text;
    return true;
  }

  drop() {
    quietly(() => window.sessionStorage.removeItem(KEY));
    quietly(() => window.localStorage.removeItem(KEY));
  }

  /**
   * Ask the service; the path is from the address of the page, which a proxy may have below a path of its own. Rejects
   * where no answer has begun, or ended, before the signal, after 5 s if none is given; with Stranger, see there.
   */
  async ask(path, signal = AbortSignal.timeout(ASK_MS)) {
    const headers = this.text === null ? {} : { Authorization: `Bearer ${this.text}` };
    return own(await fetch(below(path), { ...PLAIN, headers, signal }));
  }
}

/** Tokens of the service are of these characters; a header takes no others. */
export const possible = (text) => /^[!-~]+$/.test(text);

export const refuses = (answer) => answer.status === 401 || answer.status === 403;
