// Geometries and materials of solids for the 3-D view.

import * as THREE from "three";

/** @typedef {import("./types.js").Solid} Solid */
/** @typedef {import("./types.js").Hull} Hull */

/** Number of segments around round solids. */
const SEGMENTS = 18;
/** Side of the plane that shows a half-space [m]. */
const GROUND = 20;
/** Opacity of the robot around its skeleton. */
const GHOST = 0.22;

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

// Light from the sky and from one side with a soft gloss. Colours are those of the style sheet, without conversion.
const SUN = "vec3(0.35, -0.42, 0.84)";
const PLACED = `
  mat4 placed = modelMatrix;
#ifdef USE_INSTANCING
  placed = modelMatrix * instanceMatrix;
#endif
  vec4 at = placed * vec4(position, 1.0);`;
const VERTEX = `
varying vec3 turned;
varying vec3 eye;
void main() {${PLACED}
  turned = mat3(placed) * normal;
  eye = cameraPosition - at.xyz;
  gl_Position = projectionMatrix * viewMatrix * at;
}`;
const FRAGMENT = `
uniform vec3 colour;
uniform float opacity;
varying vec3 turned;
varying vec3 eye;
void main() {
  vec3 n = normalize(turned);
  vec3 e = normalize(eye);
  if (dot(n, e) < 0.0) n = -n;
  float rim = smoothstep(0.0, 0.55, abs(dot(n, e)));
  float light = (0.62 + 0.16 * n.z + 0.30 * max(dot(n, ${SUN}), 0.0)) * (0.80 + 0.20 * rim);
  float gloss = pow(max(dot(n, normalize(e + ${SUN})), 0.0), 32.0);
  gl_FragColor = vec4(colour * light + 0.10 * gloss, opacity);
}`;
// A shadow is the object pressed along the light onto a level of the world, and cut at the edges of what it falls on.
const SHADOW_VERTEX = `
uniform float level;
varying vec2 where;
varying float above;
void main() {${PLACED}
  above = at.z - level;
  at.xyz -= ${SUN} * (above / ${SUN}.z);
  where = at.xy;
  gl_Position = projectionMatrix * viewMatrix * at;
}`;
const SHADOW_FRAGMENT = `
uniform vec3 colour;
uniform vec4 edges;
varying vec2 where;
varying float above;
void main() {
  if (above < 0.0 || where.x < edges.x || where.y < edges.y || where.x > edges.z || where.y > edges.w) discard;
  gl_FragColor = vec4(colour, 1.0);
}`;

/** Materials by the name of their colour in the style sheet, which changes with the theme. */
export class Materials {
  constructor() {
    /** @type {Map<string, THREE.ShaderMaterial>} */
    this.solids = new Map();
    /** @type {Map<string, THREE.LineBasicMaterial>} */
    this.lines = new Map();
    /** @type {{name: string, material: THREE.ShaderMaterial}[]} */
    this.shadows = [];
  }

  /**
   * Create the material of shadows on a level surface.
   * @param {string} name of its colour
   * @param {number} level height of the surface [m]
   * @param {[number, number, number, number]} edges least x and y, greatest x and y [m]
   */
  shadow(name, level, edges) {
    const uniforms = { colour: { value: new THREE.Color() }, level: { value: level }, edges: { value: new THREE.Vector4(...edges) } };
    const bias = { polygonOffset: true, polygonOffsetFactor: -1, polygonOffsetUnits: -4 };
    const material = new THREE.ShaderMaterial({ uniforms, vertexShader: SHADOW_VERTEX, fragmentShader: SHADOW_FRAGMENT, side: THREE.DoubleSide, ...bias });
    this.shadows.push({ name, material });
    return material;
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

  /** Make solids translucent, or opaque again. @param {string[]} names of their colours @param {boolean} on */
  setGhost(names, on) {
    for (const material of names.map((name) => this.solid(name))) {
      material.transparent = on;
      material.depthWrite = !on;
      material.uniforms.opacity.value = on ? GHOST : 1;
    }
  }

  /** @param {(name: string) => string} colour */
  recolour(colour) {
    for (const [name, material] of [...this.solids, ...this.shadows.map((shadow) => /** @type {const} */ ([shadow.name, shadow.material]))]) {
      material.uniforms.colour.value.setStyle(colour(name), THREE.LinearSRGBColorSpace);
    }
    for (const [name, material] of this.lines) material.color.set(colour(name));
  }
}

function newSolid() {
  return new THREE.ShaderMaterial({
    uniforms: { colour: { value: new THREE.Color() }, opacity: { value: 1 } },
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
