// The sentences of the page and of the service in the language of the page. They stand in English where they are said;
// german.js has the German ones. No document here.

import { settings } from "./settings.js";

const ENGLISH = { PAGE: {}, SERVICE: {}, LISTED: {} };
const { PAGE, SERVICE, LISTED } = settings.language === "de" ? await import("./german.js") : ENGLISH;
const BLANK = /\{\}/g;
const SENTENCES = /(?<=[.?!]) (?=[\p{Lu}“])/u; // between two of them

/** A tag for a sentence of the page: say`There is ${names}.` */
export const say = (parts, ...values) => filled(named(parts.join("{}")), values);

/** Return a label of the page; one that is not listed is nobody's sentence, and stays. */
export const named = (text) => PAGE[text] ?? text;

/**
 * Return what the service says: one sentence, or several in a row. What no pattern knows, stays in English.
 *
 * What names stand in it stays as it is, too.
 */
export const heard = (text) => (!text || settings.language === "en" ? text : inOther(text, SAID, [SENTENCES]));

const SAID = patterns(SERVICE, "(.+?)");
const LISTS = patterns({ ...LISTED, ...SERVICE }, "((?:(?!, |; ).)+?)"); // a blank holds one item

/** The pattern with the most words of its own first: what fits it may fit others, too. */
function patterns(words, blank) {
  const own = (english) => english.replace(BLANK, "").length;
  const sorted = Object.entries(words).sort(([one], [other]) => own(other) - own(one));
  const exact = (english) => english.replace(/[.*+?^$()|[\]\\/]/g, "\\$&");
  return sorted.map(([english, other]) => [new RegExp(`^${exact(english).replace(BLANK, blank)}$`), other]);
}

/** Return a text in the other language: the whole of it if a pattern fits, or else its parts between separators. */
function inOther(text, known, [separator, ...finer]) {
  for (const [pattern, words] of known) {
    const found = pattern.exec(text);
    if (found) return filled(words, found.slice(1).map((value) => inOther(value, LISTS, ["; ", ", "])));
  }
  if (separator === undefined) return text;
  const parts = text.split(separator).map((part) => inOther(part, known, finer));
  return parts.join(separator === SENTENCES ? " " : separator);
}

/** Fill the blanks of a sentence in their order, or by their numbers from 1 where that is another. */
function filled(words, values) {
  let next = 0;
  return words.replace(/\{(\d?)\}/g, (_, number) => values[number ? number - 1 : next++]);
}
