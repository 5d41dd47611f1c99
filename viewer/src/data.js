// Decoding of what src/ostiform/report/viewer.py writes, and the shapes that follow from it.

function bytesOf(text) {
  const binary = atob(text);
  const bytes = new Uint8Array(binary.length);
  for (let i = 0; i < binary.length; i += 1) bytes[i] = binary.charCodeAt(i);
  return bytes;
}

function numbersOf({ unit, data }) {
  const integers = new Int16Array(bytesOf(data).buffer);
  return Float32Array.from(integers, (value) => value * unit);
}

function indicesOf(text) {
  return new Uint32Array(bytesOf(text).buffer);
}

const MISSING = -32768;

// Numbers with gaps: NaN where a point has no value.
function valuesOf({ unit, data }) {
  const integers = new Int16Array(bytesOf(data).buffer);
  return Float32Array.from(integers, (value) => (value === MISSING ? NaN : value * unit));
}

export function readModel(text) {
  const raw = JSON.parse(text);
  return {
    ...raw,
    mean: numbersOf(raw.mean),
    basis: raw.basis.map(numbersOf),
    faces: indicesOf(raw.faces),
    openings: raw.openings.map(({ part, loop }) => ({ part, loop: indicesOf(loop) })),
    error: raw.error && numbersOf(raw.error),
    fields: raw.fields.map((field) => ({
      ...field,
      mean: valuesOf(field.mean),
      shapes: field.shapes.map(valuesOf),
    })),
    sets: raw.sets.map((set) => ({ ...set, spread: numbersOf(set.spread) })),
  };
}

// target = mean + sum_k coefficients[k] * basis[k]
export function fillShape(model, coefficients, target) {
  target.set(model.mean);
  const count = Math.min(coefficients.length, model.basis.length);
  for (let k = 0; k < count; k += 1) {
    const amount = coefficients[k];
    if (amount === 0) continue;
    const mode = model.basis[k];
    for (let i = 0; i < target.length; i += 1) target[i] += amount * mode[i];
  }
}

// Distance in mm between corresponding points of two shapes.
export function fillDistances(first, second, target) {
  for (let i = 0; i < target.length; i += 1) {
    target[i] = Math.hypot(
      first[3 * i] - second[3 * i],
      first[3 * i + 1] - second[3 * i + 1],
      first[3 * i + 2] - second[3 * i + 2],
    );
  }
}

// The value that a share of the values does not exceed.
export function quantile(values, share) {
  const sorted = Float32Array.from(values).sort();
  return sorted[Math.min(sorted.length - 1, Math.floor(share * sorted.length))];
}

export function addScaled(target, amount, values) {
  for (let k = 0; k < values.length; k += 1) target[k] += amount * values[k];
}

// Shapes of a cycle between its frames, on the closed cycle.
export function cycleAt(frames, time) {
  const position = (((time % 1) + 1) % 1) * frames.length;
  const first = Math.floor(position) % frames.length;
  const second = (first + 1) % frames.length;
  const share = position - Math.floor(position);
  return frames[first].map((value, k) => (1 - share) * value + share * frames[second][k]);
}

// Inner product in mm^2 per point of two displacements in coordinates of the basis.
function inner(model, first, second) {
  let sum = 0;
  for (let k = 0; k < model.deviations.length; k += 1) {
    sum += model.deviations[k] ** 2 * first[k] * second[k];
  }
  return sum;
}

// Scores of a shape along the modes of a set, in standard deviations.
export function scoresIn(model, set, coefficients) {
  const offset = coefficients.map((value, k) => value - set.mean[k]);
  return set.modes.map((mode) => {
    const own = inner(model, mode.coefficients, mode.coefficients);
    return own > 0 ? inner(model, mode.coefficients, offset) / own : 0;
  });
}

// RMS distance in mm of corresponding points of two shapes, weighted by area.
export function distance(model, first, second) {
  const offset = first.map((value, k) => value - second[k]);
  return Math.sqrt(inner(model, offset, offset));
}
