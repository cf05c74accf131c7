// The notes of an answer in words, and which of them are announced at once. No document here.

import { axesOf } from "./places.js";
import { say } from "./say.js";

const UNEXPLAINED = {
  beam: say`Something acts on the beam that is not a single contact, or a sensor is wrong`,
  plate: say`Something acts on the plate that is not a single contact, or a sensor is wrong`,
};
const LOOK = {
  beam: say`Look whether more than one thing touches the beam, whether something is wedged under it, and at the sensors`,
  plate: say`Look whether more than one thing touches the plate, whether something is wedged under it, and at the sensors`,
};
const LASTING = {
  rate: say`The device does not keep its rate`,
  noise: say`The sender states another noise than the model was made for`,
  unchecked: say`Too few sensors to tell a single contact from anything else`,
  degraded: say`A sensor has been out for too long: it needs repair`,
  senders: say`Two daemons send samples of this surface: stop one of them`,
  zeros: say`Zeros have moved, as in warmth: wait until it settles, take everything off, then tare`,
};
const FORCE = say`The force is beyond the range of the scene`;
const PASSING = {
  overload: { beam: FORCE, plate: FORCE },
  unsteady: {
    beam: say`The beam moves, or one sample does not settle the state`,
    plate: say`The plate moves, or one sample does not settle the state`,
  },
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
  const degraded = quality === "degraded" ? [say`Degraded: without ${left.join(", ")}`] : [];
  const lasting = [...degraded, ...others.filter((note) => !PASSING[note]).map((note) => LASTING[note] ?? note)];
  const passing = others.filter((note) => PASSING[note]).map((note) => sentence(note, state, noun));
  if (state !== "unexplained") {
    return { detail: [...lasting, ...passing].join(". "), lasting: lasting.join(". "), passing, suspect };
  }
  const check = suspect === null ? [] : [say`Sensor ${suspect} contradicts the others: check it first`];
  const unexplained = UNEXPLAINED[noun];
  const detail = `${[...check, unexplained, LOOK[noun], ...lasting, ...passing].join(". ")}.`;
  return { detail, lasting: [unexplained, ...lasting].join(". "), passing: [...check, ...passing], suspect };
}

function sentence(note, state, noun) {
  const said = PASSING[note][noun];
  return note === "unsteady" && state === "contact" ? say`${said}: the interval is wide` : said;
}
