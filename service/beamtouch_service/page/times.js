// Times in words, in the zone that the reader chose.

import { locale, timeZone } from "./settings.js";

const ZONED = { hour: "2-digit", minute: "2-digit", second: "2-digit", timeZoneName: "short", timeZone };
const DAY = { day: "numeric", month: "short", year: "numeric" };

/** Return a time with its zone, and its day unless that is today. */
export function inZone(at) {
  const date = new Date(at);
  const [day, today] = [date, new Date()].map((one) => one.toLocaleDateString(locale, { timeZone }));
  return date.toLocaleString(locale, day === today ? ZONED : { ...DAY, ...ZONED });
}

/** Return the name of the zone. */
export const zone = () =>
  new Intl.DateTimeFormat(locale, { timeZoneName: "short", timeZone }).formatToParts().find(({ type }) => type === "timeZoneName").value;

/** Return the time of a day, without its zone. */
export const clock = (date) => date.toLocaleTimeString(locale, { timeZone });

/** Return the day in words, with its year unless that is this one. */
export function day(at) {
  const [date, now] = [new Date(at), new Date()];
  const [year, thisYear] = [date, now].map((one) => one.toLocaleDateString(locale, { year: "numeric", timeZone }));
  const parts = { day: "numeric", month: "long", ...(year === thisYear ? {} : { year: "numeric" }) };
  return date.toLocaleDateString(locale, { ...parts, timeZone });
}
