// Server-sent events from a stream of bytes. The browser's own EventSource cannot send a token. No document here.

/** Takes the bytes as they come, cut anywhere, and returns the events that they complete. */
export class EventParser {
  constructor() {
    this.decoder = new TextDecoder(); // keeps the first bytes of a character that a chunk cut in two
    this.rest = ""; // of a line whose end has not come
    this.returned = false; // the last chunk ended with \r, so that a \n to come belongs to the same end of line
    this.begin();
  }

  begin() {
    this.type = "message";
    this.data = [];
  }

  /** Return the events that end in these bytes, as {type, data}. */
  push(bytes) {
    const text = this.decoder.decode(bytes, { stream: true });
    if (!text) return [];
    const more = this.returned && text[0] === "\n" ? text.slice(1) : text;
    this.returned = text.endsWith("\r");
    const lines = (this.rest + more).split(/\r\n|\r|\n/);
    this.rest = lines.pop();
    return lines.flatMap((line) => this.take(line));
  }

  take(line) {
    if (line === "") return this.end();
    const [, field, value] = line.match(/^([^:]*)(?:: ?)?(.*)$/s);
    if (field === "event") this.type = value || "message";
    if (field === "data") this.data.push(value);
    return []; // nor do comments, ids and delays end an event
  }

  end() {
    const event = { type: this.type, data: this.data.join("\n") };
    const complete = this.data.length > 0;
    this.begin();
    return complete ? [event] : [];
  }
}
