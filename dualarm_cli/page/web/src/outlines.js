// Geometries of drawings: turned and rounded solids, rods between points, and ribbons along curves.

import * as THREE from "three";
import { RoundedBoxGeometry } from "three/addons/geometries/RoundedBoxGeometry.js";

/** Segments around turned solids. */
const AROUND = 20;

/**
 * Turn a profile about the z axis.
 * @param {[number, number][]} profile radius and height of each point, from below [m]
 * @returns {THREE.BufferGeometry}
 */
export function turned(profile) {
  return new THREE.LatheGeometry(profile.map(([radius, height]) => new THREE.Vector2(Math.max(radius, 0), height)), AROUND).rotateX(Math.PI / 2);
}

/**
 * Create a cylinder along z with bevelled edges.
 * @param {number} radius
 * @param {number} length
 * @param {number} [bevel]
 */
export function drum(radius, length, bevel = 0.12 * radius) {
  const half = length / 2;
  const edge = Math.min(bevel, half);
  // Doubled points keep the faces flat.
  const lower = /** @type {[number, number][]} */ ([[0, -half], [radius - edge, -half], [radius - edge, -half], [radius - 0.3 * edge, -half + 0.3 * edge], [radius, -half + edge], [radius, -half + edge]]);
  return turned([...lower, ...lower.map(([r, z]) => /** @type {[number, number]} */ ([r, -z])).reverse()]);
}

/**
 * Create the housing of a link: within its capsule, with collars at both ends and a narrower waist.
 * @param {number} radius of the capsule
 * @param {number} length between the centres of its caps
 */
export function housing(radius, length) {
  const end = length / 2 + 0.96 * radius;
  const points = 18;
  const waist = Math.min(0.2, (0.12 * length) / radius);
  return turned(
    Array.from({ length: points + 1 }, (_, i) => {
      const z = -end * Math.cos((Math.PI * i) / points);
      const cap = Math.min(Math.max((Math.abs(z) - length / 2) / (0.96 * radius), 0), 1);
      const middle = Math.max(1 - Math.abs(z) / (length / 2 + 0.3 * radius), 0);
      const narrowing = 1 - waist * (middle * middle * (3 - 2 * middle));
      return /** @type {[number, number]} */ ([0.97 * radius * narrowing * (1 - cap ** 2.6) ** (1 / 2.6), z]);
    }),
  );
}

/** Rounding below which a block has sharp edges [m]. */
const SHARP = 0.0055;

/** @param {number} x @param {number} y @param {number} z @param {number} [rounding] */
export function block(x, y, z, rounding = 0.12 * Math.min(x, y, z)) {
  const radius = Math.min(rounding, 0.49 * Math.min(x, y, z));
  return radius < SHARP ? new THREE.BoxGeometry(x, y, z) : new RoundedBoxGeometry(x, y, z, 2, radius);
}

/**
 * Place a geometry along z on the line between two points, centred.
 * @param {THREE.Object3D} object
 * @param {THREE.Vector3} from
 * @param {THREE.Vector3} to
 */
export function lay(object, from, to) {
  object.position.copy(from).add(to).multiplyScalar(0.5);
  const along = to.clone().sub(from).normalize();
  object.quaternion.setFromUnitVectors(new THREE.Vector3(0, 0, 1), along);
}

/**
 * Create a surface between two curves with equally many points.
 * @param {THREE.Vector3[]} one
 * @param {THREE.Vector3[]} another
 */
export function ribbon(one, another) {
  const count = one.length;
  const corners = [...one, ...another].flatMap((point) => point.toArray());
  const faces = Array.from({ length: count - 1 }, (_, i) => [i, i + 1, count + i, i + 1, count + i + 1, count + i]).flat();
  const geometry = new THREE.BufferGeometry();
  geometry.setAttribute("position", new THREE.Float32BufferAttribute(corners, 3));
  geometry.setIndex(faces);
  geometry.computeVertexNormals();
  return geometry;
}
