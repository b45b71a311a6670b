// Poses of bodies in double precision, and where tools and things are.

/** @typedef {import("./types.js").Vector} Vector */
/** @typedef {import("./types.js").Quaternion} Quaternion */
/** @typedef {import("./types.js").Pose} Pose */
/** @typedef {import("./types.js").Body} Body */
/** @typedef {import("./types.js").Thing} Thing */

export const WORLD = -1;

/** @type {Pose} */
export const IDENTITY = { xyz: [0, 0, 0], quat: [0, 0, 0, 1] };

/**
 * Returns a vector turned by a unit quaternion.
 * @param {Quaternion} quat
 * @param {Vector} v
 * @returns {Vector}
 */
export function rotate([x, y, z, w], [a, b, c]) {
  const tx = 2 * (y * c - z * b);
  const ty = 2 * (z * a - x * c);
  const tz = 2 * (x * b - y * a);
  return [
    a + w * tx + y * tz - z * ty,
    b + w * ty + z * tx - x * tz,
    c + w * tz + x * ty - y * tx,
  ];
}

/**
 * Returns the product of two quaternions: first the right one, then the left one.
 * @param {Quaternion} p
 * @param {Quaternion} q
 * @returns {Quaternion}
 */
export function product([ax, ay, az, aw], [bx, by, bz, bw]) {
  return [
    aw * bx + ax * bw + ay * bz - az * by,
    aw * by - ax * bz + ay * bw + az * bx,
    aw * bz + ax * by - ay * bx + az * bw,
    aw * bw - ax * bx - ay * by - az * bz,
  ];
}

/**
 * Returns the point of a frame in the frame that the pose is given in.
 * @param {Pose} pose
 * @param {Vector} point
 * @returns {Vector}
 */
export function transform(pose, point) {
  const [x, y, z] = rotate(pose.quat, point);
  return [pose.xyz[0] + x, pose.xyz[1] + y, pose.xyz[2] + z];
}

/**
 * Returns outer · inner.
 * @param {Pose} outer
 * @param {Pose} inner
 * @returns {Pose}
 */
export function compose(outer, inner) {
  return { xyz: transform(outer, inner.xyz), quat: product(outer.quat, inner.quat) };
}

/**
 * Returns the turn by an angle about a unit axis.
 * @param {Vector} axis
 * @param {number} angle rad
 * @returns {Quaternion}
 */
export function turn(axis, angle) {
  const s = Math.sin(angle / 2);
  return [axis[0] * s, axis[1] * s, axis[2] * s, Math.cos(angle / 2)];
}

/**
 * Returns the poses of all bodies in the world.
 * @param {Body[]} bodies parents first
 * @param {ArrayLike<number>} positions of the joints [rad or m]
 * @returns {Pose[]}
 */
export function forwardKinematics(bodies, positions) {
  /** @type {Pose[]} */
  const found = [];
  for (const body of bodies) {
    const placed = body.parent === WORLD ? body : compose(found[body.parent], body);
    const q = body.joint < 0 ? 0 : positions[body.joint];
    if (q === 0) {
      found.push({ xyz: placed.xyz, quat: placed.quat });
    } else if (body.slides) {
      const [x, y, z] = body.axis;
      found.push({ xyz: transform(placed, [x * q, y * q, z * q]), quat: placed.quat });
    } else {
      found.push({ xyz: placed.xyz, quat: product(placed.quat, turn(body.axis, q)) });
    }
  }
  return found;
}

/**
 * Returns where a thing is in the world at a time; null while it is not there.
 * @param {Thing} thing its keyframes are in the order of time
 * @param {number} time s
 * @param {Pose[]} poses of the bodies at that time
 * @returns {Pose | null}
 */
export function thingPose(thing, time, poses) {
  let current = thing.keyframes[0];
  for (const keyframe of thing.keyframes) if (keyframe.time <= time) current = keyframe;
  if (current === undefined || current.time > time || current.body === null) return null;
  if (current.body !== WORLD) return compose(poses[current.body], current);
  const dt = time - current.time;
  const [x, y, z] = current.xyz;
  const [u, v, w] = current.velocity;
  return { xyz: [x + u * dt, y + v * dt, z + w * dt], quat: current.quat };
}
