// Times in words, in the zone that the reader chose.

import { locale, timeZone } from "./settings.js";

const ZONED = { hour: "2-digit", minute: "2-digit", second: "2-digit", timeZoneName: "short", timeZone };
const DAY = { day: "numeric", month: "short", year: "numeric" };

/** Return a time with its zone, and its day unless that is today. */
export function inZone(at) {
  const date = new Date(at);
  return date.toLocaleString(locale, isToday(date) ? ZONED : { ...DAY, ...ZONED });
}

function isToday(date) {
  const [day, today] = [date, new Date()].map((one) => one.toLocaleDateString(locale, { timeZone }));
  return day === today;
}

/** Return the name of the zone. */
export const zone = () =>
  new Intl.DateTimeFormat(locale, { timeZoneName: "short", timeZone }).formatToParts().find(({ type }) => type === "timeZoneName").value;

/** Return a time without its zone, with its day unless that is today, and with its year unless that is this one. */
export function clock(date) {
  const time = date.toLocaleTimeString(locale, { timeZone });
  return isToday(date) ? time : `${day(date, "short")}, ${time}`;
}

/** Return the day in words, with its year unless that is this one; `month` is how long the name of the month is. */
export function day(at, month = "long") {
  const [date, now] = [new Date(at), new Date()];
  const [year, thisYear] = [date, now].map((one) => one.toLocaleDateString(locale, { year: "numeric", timeZone }));
  const parts = { day: "numeric", month, ...(year === thisYear ? {} : { year: "numeric" }) };
  return date.toLocaleDateString(locale, { ...parts, timeZone });
}
