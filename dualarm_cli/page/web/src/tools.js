// Motion of the tool centre points: position and velocity in the world.

import { WORLD, compose, forwardKinematics, rotate } from "./poses.js";
import { stateAt } from "./trajectory.js";

/**
 * Compute the position and the speed of a tool centre point at a time.
 * @param {Pick<import("./types.js").Plan, "bodies" | "joints" | "tcps">} plan
 * @param {string} arm
 * @param {number} time s
 * @returns {{xyz: number[], speed: number}} m and m/s
 */
export function toolState({ bodies, joints, tcps }, arm, time) {
  const states = joints.map((joint) => stateAt(joint.knots, time));
  const poses = forwardKinematics(bodies, states.map(({ position }) => position));
  const tcp = tcps[arm];
  const { xyz } = compose(poses[tcp.body], tcp);
  const velocity = [0, 0, 0];
  for (let k = tcp.body; k !== WORLD; k = bodies[k].parent) {
    const rate = states[bodies[k].joint]?.velocity ?? 0;
    const [x, y, z] = rotate(poses[k].quat, bodies[k].axis);
    const [a, b, c] = xyz.map((value, i) => value - poses[k].xyz[i]);
    const along = bodies[k].slides ? [x, y, z] : [y * c - z * b, z * a - x * c, x * b - y * a];
    along.forEach((value, i) => (velocity[i] += rate * value));
  }
  return { xyz, speed: Math.hypot(...velocity) };
}
