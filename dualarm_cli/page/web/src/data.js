// Reader of the page's data: base64 texts become typed arrays, everything else stays as it is.

/** @typedef {import("./types.js").Plan} Plan */

export const FORMAT = "dualarm.page/1";

/**
 * Decode a base64 text.
 * @param {string} text
 * @returns {ArrayBuffer}
 */
function bytes(text) {
  const binary = atob(text);
  const result = new Uint8Array(binary.length);
  for (let i = 0; i < binary.length; i++) result[i] = binary.charCodeAt(i);
  return result.buffer;
}

/** @param {string} text */
export const f64 = (text) => new Float64Array(bytes(text));
/** @param {string} text */
export const f32 = (text) => new Float32Array(bytes(text));
/** @param {string} text */
export const u32 = (text) => new Uint32Array(bytes(text));

/**
 * Read a plan.
 * @param {string} text JSON of format dualarm.page/1
 * @returns {Plan}
 * @throws {Error} on another format, or without the texts of the header
 */
export function readPlan(text) {
  const raw = JSON.parse(text);
  if (raw.format !== FORMAT) {
    throw new Error(`the data have the format ${raw.format}, but this page reads ${FORMAT}`);
  }
  const absent = ["title", "robot"].find((name) => typeof raw[name] !== "string");
  if (absent) throw new Error(`${absent} is missing`);
  const joints = raw.joints.map((/** @type {any} */ joint) => ({
    ...joint,
    knots: {
      time: f64(joint.knots.time),
      position: f64(joint.knots.position),
      velocity: f64(joint.knots.velocity),
      acceleration: f64(joint.knots.acceleration),
    },
  }));
  const hulls = raw.hulls.map((/** @type {any} */ hull) => ({
    corners: f32(hull.corners),
    triangles: u32(hull.triangles),
  }));
  const clearances = raw.clearances.map((/** @type {any} */ clearance) => ({
    ...clearance,
    time: f64(clearance.time),
    distance: f32(clearance.distance),
    pair: u32(clearance.pair),
    points: f32(clearance.points),
  }));
  const torques = raw.torques && { ...raw.torques, time: f64(raw.torques.time), values: raw.torques.values.map(f32) };
  return { ...raw, joints, hulls, clearances, torques };
}

/**
 * Say that the data of a page do not fit its program, and what to do.
 * @param {string} text the data
 * @param {unknown} error
 */
export function unfit(text, error) {
  const version = /"version":"([^"]*)"/.exec(text)?.[1];
  const made = version ? ` by dualarm ${version}` : "";
  return `This page cannot be shown: its data were written${made} and do not fit its program (${error instanceof Error ? error.message : error}). Write it again: dualarm report PLAN`;
}

/**
 * Return the names of the arms in the order of the page.
 * @param {Plan} plan
 * @returns {string[]}
 */
export function armsOf(plan) {
  return Object.keys(plan.tcps);
}
