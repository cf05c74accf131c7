// Times in words, in the zone of the browser.

const ZONED = { hour: "2-digit", minute: "2-digit", second: "2-digit", timeZoneName: "short" };

/** Return a time with its zone, and its day unless that is today. */
export function inZone(at) {
  const date = new Date(at);
  const isToday = date.toDateString() === new Date().toDateString();
  return date.toLocaleString("en-GB", isToday ? ZONED : { day: "numeric", month: "short", year: "numeric", ...ZONED });
}

/** Return the name of the zone. */
export const zone = () =>
  new Intl.DateTimeFormat("en-GB", { timeZoneName: "short" }).formatToParts().find(({ type }) => type === "timeZoneName").value;
