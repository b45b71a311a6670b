// Poses of bodies, tools and carried objects in double precision.

/** @typedef {import("./types.js").Vector} Vector */
/** @typedef {import("./types.js").Quaternion} Quaternion */
/** @typedef {import("./types.js").Pose} Pose */
/** @typedef {import("./types.js").Body} Body */
/** @typedef {import("./types.js").CarriedObject} CarriedObject */

export const WORLD = -1;

/** @type {Pose} */
export const IDENTITY = { xyz: [0, 0, 0], quat: [0, 0, 0, 1] };

/**
 * Rotate a vector by a unit quaternion.
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
 * Multiply two quaternions: the right rotation is applied first.
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
 * Transform a point from a frame to the frame in which its pose is given.
 * @param {Pose} pose
 * @param {Vector} point
 * @returns {Vector}
 */
export function transform(pose, point) {
  const [x, y, z] = rotate(pose.quat, point);
  return [pose.xyz[0] + x, pose.xyz[1] + y, pose.xyz[2] + z];
}

/**
 * Compute outer · inner.
 * @param {Pose} outer
 * @param {Pose} inner
 * @returns {Pose}
 */
export function compose(outer, inner) {
  return { xyz: transform(outer, inner.xyz), quat: product(outer.quat, inner.quat) };
}

/** Compute the inverse of a pose. @param {Pose} pose @returns {Pose} */
export function inverse({ xyz, quat: [x, y, z, w] }) {
  const quat = /** @type {Quaternion} */ ([-x, -y, -z, w]);
  return { xyz: rotate(quat, [-xyz[0], -xyz[1], -xyz[2]]), quat };
}

/**
 * Compute the quaternion of a rotation about a unit axis.
 * @param {Vector} axis
 * @param {number} angle rad
 * @returns {Quaternion}
 */
export function turn(axis, angle) {
  const s = Math.sin(angle / 2);
  return [axis[0] * s, axis[1] * s, axis[2] * s, Math.cos(angle / 2)];
}

/**
 * Compute the poses of all bodies in the world.
 * @param {Body[]} bodies parents first
 * @param {ArrayLike<number>} positions of the joints [rad or m]
 * @returns {Pose[]}
 */
export function forwardKinematics(bodies, positions) {
  /** @type {Pose[]} */
  const poses = [];
  for (const body of bodies) {
    const atZero = body.parent === WORLD ? body : compose(poses[body.parent], body);
    const q = body.joint < 0 ? 0 : positions[body.joint];
    if (q === 0) {
      poses.push({ xyz: atZero.xyz, quat: atZero.quat });
    } else if (body.slides) {
      const [x, y, z] = body.axis;
      poses.push({ xyz: transform(atZero, [x * q, y * q, z * q]), quat: atZero.quat });
    } else {
      poses.push({ xyz: atZero.xyz, quat: product(atZero.quat, turn(body.axis, q)) });
    }
  }
  return poses;
}

/**
 * Compute the pose of an object in the world at a time, or null while it is absent.
 * @param {CarriedObject} object keyframes in order of time
 * @param {number} time s
 * @param {Pose[]} poses of the bodies at that time
 * @returns {Pose | null}
 */
export function objectPose(object, time, poses) {
  let current = object.keyframes[0];
  for (const keyframe of object.keyframes) if (keyframe.time <= time) current = keyframe;
  if (current === undefined || current.time > time || current.body === null) return null;
  if (current.body !== WORLD) return compose(poses[current.body], current);
  const dt = time - current.time;
  const [x, y, z] = current.xyz;
  const [u, v, w] = current.velocity;
  return { xyz: [x + u * dt, y + v * dt, z + w * dt], quat: current.quat };
}
