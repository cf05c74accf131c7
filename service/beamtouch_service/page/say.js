// The sentences of the page and of the service in the language of the page. They stand in English where they are said;
// german.js has the German ones. No document here.

import { settings } from "./settings.js";

const ENGLISH = { PAGE: {}, SERVICE: {}, LISTED: {}, WORDS: {} };
const SPOKEN = settings.language === "de" ? await import("./german.js").catch(() => ENGLISH) : ENGLISH;
const { PAGE, SERVICE, LISTED, WORDS } = SPOKEN;
const BLANK = /\{(?:word)?\}/g;
const SENTENCES = /(?<=[.?!]) (?=[\p{Lu}“])/u; // between two of them

/** The language of the words: English where those of the other one do not arrive. */
export const language = SPOKEN === ENGLISH ? "en" : settings.language;

/** A tag for a sentence of the page: say`There is ${names}.` */
export const say = (parts, ...values) => filled(named(parts.join("{}")), values);

/** Return a label of the page; one that is not listed is nobody's sentence, and stays. */
export const named = (text) => PAGE[text] ?? text;

/**
 * Return what the service says: one sentence, or several in a row. A sentence that no pattern knows stays in English.
 *
 * What names stand in it stays as it is, too.
 */
export const heard = (text) => text?.split(SENTENCES).map(inOther).join(" ");

const SAID = patterns(SERVICE, "(.+?)");
const LISTS = patterns({ ...LISTED, ...SERVICE }, "((?:(?!, |; ).)+?)"); // a blank holds one item

/** The pattern with the most words of its own first: what fits it may fit others, too. */
function patterns(sentences, blank) {
  const own = (english) => english.replace(BLANK, "").length;
  const sorted = Object.entries(sentences).sort(([one], [other]) => own(other) - own(one));
  const exact = (english) => english.replace(/[.*+?^$()|[\]\\/]/g, "\\$&");
  return sorted.map(([english, other]) => {
    const holdsWord = [...english.matchAll(BLANK)].map(([found]) => found === "{word}");
    return { pattern: new RegExp(`^${exact(english).replace(BLANK, blank)}$`), holdsWord, other };
  });
}

/** Return a sentence in the other language; a title may end it, which has no full stop where it stands alone. */
function inOther(sentence) {
  const title = sentence.replace(/\.$/, "");
  return matched(sentence, SAID) ?? (title === sentence ? null : withStop(matched(title, SAID))) ?? sentence;
}

const withStop = (text) => text && `${text}.`;

/** Return a text in the other language; null if no pattern fits. */
function matched(text, known) {
  for (const { pattern, holdsWord, other } of known) {
    const found = pattern.exec(text)?.slice(1);
    if (found) return filled(other, found.map((value, index) => (holdsWord[index] ? WORDS[value] ?? value : listed(value))));
  }
  return null;
}

/** Return what stands in a blank in the other language: the whole of it if a pattern fits, or else each item. */
function listed(text, [separator, ...finer] = ["; ", ", "]) {
  if (!text.includes(" ")) return text; // a name or a figure
  const whole = matched(text, LISTS);
  if (whole !== null || separator === undefined) return whole ?? text;
  return text.split(separator).map((part) => listed(part, finer)).join(separator);
}

/** Fill the blanks of a sentence in their order, or by their numbers from 1 where that is another. */
function filled(words, values) {
  let next = 0;
  return words.replace(/\{(\d?)\}/g, (_, number) => values[number ? number - 1 : next++]);
}
