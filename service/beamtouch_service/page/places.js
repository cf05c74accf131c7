// Places by axis: a beam has the axis `position`, a plate the axes `x` and `y`. No document here.

const BEAM = ["position"];
const PLATE = ["x", "y"];

/** The axes of a message, a contact, a channel or anything else that has figures of place. */
export const axesOf = (thing) => (thing && "x_mm" in thing ? PLATE : BEAM);

/** The axes of what the page shows now. */
export const axesShown = (shown) => (isPlate(shown) ? PLATE : BEAM);

/** Return whether the surface is a plate, as far as its newest message says. */
export const isPlate = (shown) => typeof shown.width === "number";

/** The coordinates of a thing, one an axis; null where they are not known. */
export const placeOf = (thing) => axesOf(thing).map((axis) => thing[`${axis}_mm`]);

/** The ends of the interval along an axis, bounded by the surface; null if there is none. */
export function intervalOf(contact, axis, length) {
  const [low, high] = [contact[`${axis}_low_mm`], contact[`${axis}_high_mm`]];
  if (typeof low !== "number" || typeof high !== "number") return null;
  return [low, high].map((at) => Math.min(Math.max(at, 0), length));
}

/** A place in words: "150.0", or "150.0, 75.0" on a plate. */
export const inWords = (place, digits) => place.map((at) => at.toFixed(digits)).join(", ");
