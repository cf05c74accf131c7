// Whose answer it is: the service's own, or that of a proxy in front of it. No document here.

import { say } from "./say.js";

/** For each request: a redirection is none of the service. */
export const PLAIN = { cache: "no-store", redirect: "manual" };

/** Return the address of a path from the page on. That of the page may hold a login, with which no browser asks. */
export const below = (path) => new URL(path, location.origin + location.pathname).href;

/** Something else has answered in place of the service; the message is a sentence that says what it wants. */
export class Stranger extends Error {}

/** Return an answer if it is the service's; throws Stranger otherwise. All its errors are problem+json. */
export function own(answer) {
  const type = answer.headers.get("Content-Type") ?? "";
  if (answer.ok ? !type.startsWith("text/html") : type.startsWith("application/problem+json")) return answer;
  throw new Stranger(words(answer));
}

function words({ ok, status, type }) {
  if (ok || type === "opaqueredirect") return say`A proxy answers with a page of its own, perhaps a login: load this page again.`;
  if (status === 401 || status === 403 || status === 407) return say`A proxy asks for a login (${status}): load this page again.`;
  if (status >= 502 && status <= 504) return say`A proxy does not reach the service (${status}).`;
  return say`A proxy answers in place of the service (${status}).`;
}
