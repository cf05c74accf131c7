// The words that stand in the document itself, and the choice of language and zone below them.

import { byId, html } from "./dom.js";
import { language, named, say } from "./say.js";
import { choose, settings } from "./settings.js";

const CHOICES = {
  language: [["en", "English"], ["de", "Deutsch"]],
  zone: [["device", say`the zone of this device`], ["utc", "UTC"]],
};
const ATTRIBUTE = "aria-label";

/** Put the document into the language of the page. To be called before anything else is written into it. */
export function translate() {
  document.documentElement.lang = language;
  const walker = document.createTreeWalker(document.body, NodeFilter.SHOW_TEXT);
  while (walker.nextNode()) {
    const text = walker.currentNode;
    const words = text.data.trim();
    if (words) text.data = text.data.replace(words, () => named(words.replace(/\s+/g, " ")));
  }
  for (const element of document.querySelectorAll(`[${ATTRIBUTE}]`)) {
    element.setAttribute(ATTRIBUTE, named(element.getAttribute(ATTRIBUTE)));
  }
}

/** Fill the lists of languages and zones. */
export function offerSettings() {
  for (const [name, choices] of Object.entries(CHOICES)) {
    const list = byId(name);
    list.replaceChildren(...choices.map(([value, words]) => html("option", { value }, words)));
    list.value = settings[name];
    list.addEventListener("change", () => {
      if (!choose(name, list.value)) list.value = settings[name];
    });
  }
}
