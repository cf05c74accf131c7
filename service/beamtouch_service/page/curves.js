// Curves along the beam: the deflected shape by the model, and a smooth one through measured points. No document here.

/**
 * Return the deflection in mm at each position under a contact.
 *
 * The table of the model gives it per newton. The stated force scales it; without one, the measured deflections do.
 */
export function shapeUnder(contact, { at_mm, load_mm, deflection_mm_per_n: table }, seen) {
  const unit = blend(load_mm, table, contact.position_mm).map((value) => [value]);
  const perNewton = (at) => blend(at_mm, unit, at)[0];
  const force = contact.force_n ?? bestScale(perNewton, seen);
  return (at) => force * perNewton(at);
}

/** Return the row at a position between the rows of a table, by linear interpolation; the nearest row outside. */
function blend(places, rows, at) {
  const last = places.length - 1;
  if (at <= places[0]) return rows[0];
  if (at >= places[last]) return rows[last];
  const i = places.findIndex((_, index) => at < places[index + 1]);
  const share = (at - places[i]) / (places[i + 1] - places[i]);
  return rows[i].map((value, column) => value + share * (rows[i + 1][column] - value));
}

/** Return the force in N with which a shape per newton fits the measured deflections best. */
function bestScale(perNewton, seen) {
  const units = seen.map((channel) => perNewton(channel.position_mm));
  const squares = units.reduce((sum, unit) => sum + unit * unit, 0);
  return squares > 0 ? units.reduce((sum, unit, i) => sum + unit * seen[i].deflection_mm, 0) / squares : 0;
}

/** Return the natural cubic spline through the channels, straight outside: no moment at a free or hinged end. */
export function spline(channels) {
  const x = channels.map((channel) => channel.position_mm);
  const y = channels.map((channel) => channel.deflection_mm);
  const bend = secondDerivatives(x, y);
  const slope = (i) => (y[i + 1] - y[i]) / (x[i + 1] - x[i]);
  const last = x.length - 1;
  const startSlope = slope(0) - ((x[1] - x[0]) * (2 * bend[0] + bend[1])) / 6;
  const endSlope = slope(last - 1) + ((x[last] - x[last - 1]) * (bend[last - 1] + 2 * bend[last])) / 6;
  return (at) => {
    if (at <= x[0]) return y[0] + startSlope * (at - x[0]);
    if (at >= x[last]) return y[last] + endSlope * (at - x[last]);
    const i = x.findIndex((_, index) => at < x[index + 1]);
    const h = x[i + 1] - x[i];
    const [a, b] = [(x[i + 1] - at) / h, (at - x[i]) / h];
    return a * y[i] + b * y[i + 1] + (((a ** 3 - a) * bend[i] + (b ** 3 - b) * bend[i + 1]) * h * h) / 6;
  };
}

/** Solve the tridiagonal system of a natural spline from front to back and back again. */
function secondDerivatives(x, y) {
  const bend = x.map(() => 0);
  const part = x.map(() => 0);
  for (let i = 1; i < x.length - 1; i++) {
    const share = (x[i] - x[i - 1]) / (x[i + 1] - x[i - 1]);
    const pivot = share * bend[i - 1] + 2;
    const change = (y[i + 1] - y[i]) / (x[i + 1] - x[i]) - (y[i] - y[i - 1]) / (x[i] - x[i - 1]);
    bend[i] = (share - 1) / pivot;
    part[i] = ((6 * change) / (x[i + 1] - x[i - 1]) - share * part[i - 1]) / pivot;
  }
  for (let i = x.length - 2; i >= 0; i--) bend[i] = bend[i] * bend[i + 1] + part[i];
  return bend;
}
