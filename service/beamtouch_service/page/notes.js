// The notes of an answer in words, and which of them are announced at once. No document here.

import { axesOf } from "./places.js";

const UNEXPLAINED = (noun) => `Something acts on the ${noun} that is not a single contact, or a sensor is wrong`;
const LOOK = (noun) =>
  `Look whether more than one thing touches the ${noun}, whether something is wedged under it, and at the sensors`;
const LASTING = {
  rate: "The device does not keep its rate",
  noise: "The sender states another noise than the model was made for",
  unchecked: "Too few sensors to tell a single contact from anything else",
  degraded: "A sensor has been out for too long: it needs repair",
  senders: "Two daemons send samples of this surface: stop one of them",
  zeros: "Zeros have moved, as in warmth: wait until it settles, take everything off, then tare",
};
const PASSING = {
  overload: () => "The force is beyond the range of the scene",
  unsteady: (noun) => `The ${noun} moves, or one sample does not settle the state`,
};
const CHECK = "check-";

/**
 * Return what a contact (of any state) says beside its figures.
 *
 * detail: everything, as one text; lasting: the part that stays as long as its cause; passing: sentences that may
 * come and go from sample to sample; suspect: name of the channel to check first, or null.
 */
export function noted(contact) {
  const { state, quality, degraded_channels: left, notes = [] } = contact;
  const noun = axesOf(contact).length > 1 ? "plate" : "beam";
  const suspect = notes.find((note) => note.startsWith(CHECK))?.slice(CHECK.length) ?? null;
  const others = notes.filter((note) => !note.startsWith(CHECK));
  const degraded = quality === "degraded" ? [`Degraded: without ${left.join(", ")}`] : [];
  const lasting = [...degraded, ...others.filter((note) => !PASSING[note]).map((note) => LASTING[note] ?? note)];
  const passing = others.filter((note) => PASSING[note]).map((note) => sentence(note, state, noun));
  if (state !== "unexplained") {
    return { detail: [...lasting, ...passing].join(". "), lasting: lasting.join(". "), passing, suspect };
  }
  const check = suspect === null ? [] : [`Sensor ${suspect} contradicts the others: check it first`];
  const unexplained = UNEXPLAINED(noun);
  const detail = `${[...check, unexplained, LOOK(noun), ...lasting, ...passing].join(". ")}.`;
  return { detail, lasting: [unexplained, ...lasting].join(". "), passing: [...check, ...passing], suspect };
}

function sentence(note, state, noun) {
  const said = PASSING[note](noun);
  return note === "unsteady" && state === "contact" ? `${said}: the interval is wide` : said;
}
