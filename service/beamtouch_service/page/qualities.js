// The qualities of a channel in words. No document here.

import { say } from "./say.js";

const WORDS = {
  good: say`good`,
  "out-of-range": say`out of range`,
  saturated: say`saturated`,
  stuck: say`stuck`,
  missing: say`missing`,
  unknown: say`not known`,
};

/** Return a quality in words; of a service that knows more of them, as it is. */
export const inWords = (quality) => WORDS[quality] ?? quality;
