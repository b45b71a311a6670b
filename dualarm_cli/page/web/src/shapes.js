// Geometries and materials of solids for the 3-D view.

import * as THREE from "three";

/** @typedef {import("./types.js").Solid} Solid */
/** @typedef {import("./types.js").Hull} Hull */

const SPANS = 18;
const GROUND = 20;

/** Side of the cube that stands for a thing of unknown shape [m]. */
export const UNKNOWN_SIDE = 0.03;

/**
 * Returns the geometry of a solid in its own frame.
 * @param {Pick<Solid, "kind" | "size" | "hull">} solid
 * @param {Hull[]} hulls
 * @returns {THREE.BufferGeometry}
 */
export function geometryOf({ kind, size, hull }, hulls) {
  if (kind === "box") return new THREE.BoxGeometry(size[0], size[1], size[2]);
  if (kind === "sphere") return new THREE.SphereGeometry(size[0], SPANS, SPANS / 2);
  if (kind === "cylinder") {
    return new THREE.CylinderGeometry(size[0], size[0], size[1], SPANS).rotateX(Math.PI / 2);
  }
  if (kind === "capsule") {
    return new THREE.CapsuleGeometry(size[0], size[1], 5, SPANS).rotateX(Math.PI / 2);
  }
  if (kind === "half_space") return new THREE.PlaneGeometry(GROUND, GROUND);
  const { corners, triangles } = hulls[/** @type {number} */ (hull)];
  const indexed = new THREE.BufferGeometry();
  indexed.setAttribute("position", new THREE.BufferAttribute(corners, 3));
  indexed.setIndex(new THREE.BufferAttribute(triangles, 1));
  const flat = indexed.toNonIndexed();
  flat.computeVertexNormals();
  return flat;
}

/**
 * Puts an object at a pose.
 * @param {THREE.Object3D} object
 * @param {import("./types.js").Pose} pose
 */
export function place(object, { xyz, quat }) {
  object.position.set(xyz[0], xyz[1], xyz[2]);
  object.quaternion.set(quat[0], quat[1], quat[2], quat[3]);
}

/** Materials by the name of their colour in the style sheet, so that a change of theme recolours them. */
export class Materials {
  constructor() {
    /** @type {Map<string, THREE.MeshLambertMaterial>} */
    this.solid = new Map();
    /** @type {Map<string, THREE.LineBasicMaterial>} */
    this.line = new Map();
  }

  /** @param {string} name @param {Partial<THREE.MeshLambertMaterialParameters>} [more] */
  solidOf(name, more = {}) {
    const found = this.solid.get(name) ?? new THREE.MeshLambertMaterial(more);
    this.solid.set(name, found);
    return found;
  }

  /** @param {string} name @param {number} [opacity] */
  lineOf(name, opacity = 1) {
    const key = `${name} ${opacity}`;
    const found =
      this.line.get(key) ??
      new THREE.LineBasicMaterial({ transparent: opacity < 1, opacity, depthWrite: opacity === 1 });
    this.line.set(key, found);
    return found;
  }

  /** @param {(name: string) => string} colour */
  recolour(colour) {
    for (const [name, material] of this.solid) material.color.set(colour(name));
    for (const [name, material] of this.line) material.color.set(colour(name.split(" ")[0]));
  }
}

/**
 * Returns the meshes of some solids in one frame.
 * @param {Solid[]} solids
 * @param {Hull[]} hulls
 * @param {THREE.Material} material
 * @returns {THREE.Mesh[]}
 */
export function meshesOf(solids, hulls, material) {
  return solids.map((solid) => {
    const mesh = new THREE.Mesh(geometryOf(solid, hulls), material);
    place(mesh, solid);
    mesh.name = solid.name ?? "";
    return mesh;
  });
}
