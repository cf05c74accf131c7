// The form that asks for the token for reading, and the button that forgets it.

import { byId, setText } from "./dom.js";
import { possible } from "./token.js";

export class TokenForm {
  /** `onToken` is called when there is another token to try, or none any more. */
  constructor(token, onToken) {
    this.token = token;
    this.onToken = onToken;
    this.form = byId("token-form");
    this.field = byId("token");
    this.form.addEventListener("submit", (event) => this.submit(event));
    byId("forget").addEventListener("click", () => this.forget());
    window.addEventListener("storage", () => this.token.changedElsewhere() && this.onToken());
  }

  /** To be called often. The field takes the focus as it appears, unless something else has it. */
  draw(locked) {
    for (const id of ["forget", "with-token"]) byId(id).hidden = this.token.text === null;
    setText(byId("token-error"), locked ? this.token.error : "");
    this.field.setAttribute("aria-invalid", this.token.error !== "");
    if (this.form.hidden === !locked) return;
    this.form.hidden = !locked;
    if (!locked) this.form.reset();
    else if (document.activeElement === document.body) this.field.focus();
  }

  submit(event) {
    // The page sends it in a header; the browser would put it elsewhere.
    event.preventDefault();
    const text = this.field.value.trim();
    this.token.use(text, byId("keep").checked);
    this.draw(true); // a fault that is said again is a new one
    if (possible(text)) this.onToken();
    else this.token.refused();
    this.field.focus();
    this.field.select();
  }

  forget() {
    byId("forget").blur(); // it vanishes; the field takes over
    this.token.forget();
    this.onToken();
  }
}
