// The few things that every part of the page needs of the document.

const SVG = "http://www.w3.org/2000/svg";

export const byId = (id) => document.getElementById(id);

/** Change a text only where it differs: what is unchanged stays selected, and is not announced again. */
export function setText(element, text) {
  if (element.textContent !== text) element.textContent = text;
}

/** Return an element; children are elements or text. */
export function html(tag, attributes = {}, ...children) {
  return filled(document.createElement(tag), attributes, children);
}

/** Return an SVG element. */
export function svg(tag, attributes = {}, ...children) {
  return filled(document.createElementNS(SVG, tag), attributes, children);
}

function filled(element, attributes, children) {
  for (const [name, value] of Object.entries(attributes)) element.setAttribute(name, value);
  element.append(...children);
  return element;
}

const SIGNS = {
  contact: ["M12 2v13m-6-6l6 6l6-6", "M2 17q10 7 20 0"],
  clear: ["M2 18h20", "M12 3a4.5 4.5 0 1 0 .01 0z"],
  unexplained: ["M7 6a5 5 0 1 1 7 4.5q-2 1-2 3m0 2v2", "M2 21h20"],
  good: ["M3 13l6 6L21 5"],
  bad: ["M4 4l16 16M20 4L4 20"],
  warning: ["M12 2.5L23 21.5H1z", "M12 9v6m0 2v2"],
  locked: ["M4 11h16v10H4z", "M7.5 11V7a4.5 4.5 0 0 1 9 0v4"],
  waiting: ["M3 12h4m3 0h4m3 0h4"],
  unknown: ["M7 8a5 5 0 1 1 7 4.5q-2 1-2 3.5m0 2.5v2.5"],
};

/** Return a sign as a drawing: fonts differ in which signs they have. */
export function sign(name) {
  const drawing = svg("svg", { viewBox: "0 0 24 24", "aria-hidden": "true" });
  for (const d of SIGNS[name]) {
    drawing.append(svg("path", { d, fill: "none", stroke: "currentColor", "stroke-width": "2.6" }));
  }
  return drawing;
}

/** Return at most about `count` round values within low .. high. */
export function roundTicks(low, high, count) {
  const rough = (high - low) / count;
  const power = 10 ** Math.floor(Math.log10(rough));
  const step = [1, 2, 5, 10].map((factor) => factor * power).find((candidate) => candidate >= rough * 0.999);
  const first = Math.ceil(low / step - 1e-9);
  const last = Math.floor(high / step + 1e-9);
  return Array.from({ length: last - first + 1 }, (_, index) => Number(((first + index) * step).toPrecision(6)));
}
