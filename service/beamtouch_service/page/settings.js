// What a reader chose for this device: the language of the page, and the zone of its times. No document here.

/** What may be chosen, the default first. `device`: the zone of the browser. */
const OFFERED = { language: ["en", "de"], zone: ["device", "utc"] };
const key = (name) => `beamtouch-${name}`;

function chosen(name) {
  let value = null;
  try {
    value = window.localStorage.getItem(key(name));
  } catch {
    // A browser may forbid to keep anything: then its own settings decide.
  }
  return OFFERED[name].includes(value) ? value : null;
}

const spoken = () => navigator.languages.map((tag) => tag.split("-")[0]).find((one) => OFFERED.language.includes(one));

export const settings = {
  language: chosen("language") ?? spoken() ?? OFFERED.language[0],
  zone: chosen("zone") ?? OFFERED.zone[0],
};

/** How dates are written in the language of the page; UTC or undefined, as the zone of times. */
export const locale = { en: "en-GB", de: "de-DE" }[settings.language];
export const timeZone = { device: undefined, utc: "UTC" }[settings.zone];

/** Keep a choice on this device, and show the page anew with it; return false if the browser forbids to keep it. */
export function choose(name, value) {
  try {
    window.localStorage.setItem(key(name), value);
  } catch {
    return false;
  }
  window.location.reload();
  return true;
}
