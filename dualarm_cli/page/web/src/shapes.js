// Geometries and materials of solids for the 3-D view.

import * as THREE from "three";

/** @typedef {import("./types.js").Solid} Solid */
/** @typedef {import("./types.js").Hull} Hull */

/** Number of segments around round solids. */
const SEGMENTS = 18;
/** Side of the plane that shows a half-space [m]. */
const GROUND = 20;

/**
 * Create the geometry of a solid in its own frame.
 * @param {Pick<Solid, "kind" | "size" | "hull">} solid
 * @param {Hull[]} hulls
 * @returns {THREE.BufferGeometry}
 */
export function geometryOf({ kind, size, hull }, hulls) {
  if (kind === "box") return new THREE.BoxGeometry(size[0], size[1], size[2]);
  if (kind === "sphere") return new THREE.SphereGeometry(size[0], SEGMENTS, SEGMENTS / 2);
  if (kind === "cylinder") {
    return new THREE.CylinderGeometry(size[0], size[0], size[1], SEGMENTS).rotateX(Math.PI / 2);
  }
  if (kind === "capsule") {
    return new THREE.CapsuleGeometry(size[0], size[1], 5, SEGMENTS).rotateX(Math.PI / 2);
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
 * Set the pose of an object.
 * @param {THREE.Object3D} object
 * @param {import("./types.js").Pose} pose
 */
export function place(object, { xyz, quat }) {
  object.position.set(xyz[0], xyz[1], xyz[2]);
  object.quaternion.set(quat[0], quat[1], quat[2], quat[3]);
}

// Light from above and from one side, computed per vertex: fast without a graphics card and quick to compile.
// Colours are those of the style sheet, without conversion.
const VERTEX = `
varying float light;
void main() {
  mat4 placed = modelMatrix;
#ifdef USE_INSTANCING
  placed = modelMatrix * instanceMatrix;
#endif
  vec3 n = normalize(mat3(placed) * normal);
  light = 0.70 + 0.14 * n.z + 0.26 * max(dot(n, vec3(0.32, -0.49, 0.81)), 0.0);
  gl_Position = projectionMatrix * viewMatrix * placed * vec4(position, 1.0);
}`;
const FRAGMENT = `
uniform vec3 colour;
varying float light;
void main() { gl_FragColor = vec4(colour * light, 1.0); }`;

/** Materials by the name of their colour in the style sheet, which changes with the theme. */
export class Materials {
  constructor() {
    /** @type {Map<string, THREE.ShaderMaterial>} */
    this.solids = new Map();
    /** @type {Map<string, THREE.LineBasicMaterial>} */
    this.lines = new Map();
  }

  /** @param {string} name @returns {THREE.ShaderMaterial} */
  solid(name) {
    const material = this.solids.get(name) ?? newSolid();
    this.solids.set(name, material);
    return material;
  }

  /** @param {string} name @returns {THREE.LineBasicMaterial} */
  line(name) {
    const material = this.lines.get(name) ?? new THREE.LineBasicMaterial();
    this.lines.set(name, material);
    return material;
  }

  /** @param {(name: string) => string} colour */
  recolour(colour) {
    for (const [name, material] of this.solids) {
      material.uniforms.colour.value.setStyle(colour(name), THREE.LinearSRGBColorSpace);
    }
    for (const [name, material] of this.lines) material.color.set(colour(name));
  }
}

function newSolid() {
  return new THREE.ShaderMaterial({
    uniforms: { colour: { value: new THREE.Color() } },
    vertexShader: VERTEX,
    fragmentShader: FRAGMENT,
    side: THREE.DoubleSide,
  });
}

/**
 * Create the mesh of a solid at its pose.
 * @param {Solid} solid
 * @param {Hull[]} hulls
 * @param {THREE.Material} material
 */
export function meshOf(solid, hulls, material) {
  const mesh = new THREE.Mesh(geometryOf(solid, hulls), material);
  place(mesh, solid);
  mesh.name = solid.name ?? "";
  return mesh;
}
