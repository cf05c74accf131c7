// Links to the capture of an event: its samples and residuals, for a technician.

import { html } from "./dom.js";

export class Capture {
  constructor(token) {
    this.token = token;
  }

  link({ id, touched_at: at }) {
    const address = { href: `/events/${id}/capture`, download: `event-${id}.json` };
    const link = html("a", { ...address, "aria-label": `Capture of the event of ${at}` }, "capture");
    // The browser itself would follow the link without the token.
    link.addEventListener("click", (event) => this.token.text !== null && this.fetch(event));
    return link;
  }

  async fetch(event) {
    event.preventDefault();
    const link = event.currentTarget;
    try {
      const answer = await this.token.ask(link.pathname);
      if (!answer.ok) return link.replaceWith("no capture");
      const address = URL.createObjectURL(await answer.blob());
      html("a", { href: address, download: link.download }).click();
      setTimeout(() => URL.revokeObjectURL(address), 10_000);
    } catch {
      // The feed says that the connection is lost.
    }
  }
}
