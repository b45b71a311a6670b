// The 3-D view: the cell at the cursor's time, seen by a camera that people move.

import * as THREE from "three";
import { OrbitControls } from "three/addons/controls/OrbitControls.js";
import { clearanceColour } from "./clearance.js";
import { Belt, ClosestPair, Skeleton, traces } from "./scene_parts.js";
import { Things } from "./scene_things.js";
import { Materials, meshOf, place } from "./shapes.js";
import { WORLD, compose, forwardKinematics } from "./poses.js";
import { positionsAt } from "./trajectory.js";
import { armsOf } from "./data.js";

/** @typedef {import("./types.js").Plan} Plan */
/** @typedef {import("./types.js").Pose} Pose */
/** @typedef {import("./types.js").Solid} Solid */

/** Pictures that follow each other more slowly than this are drawn more coarsely [ms]. */
const SLOW = 26;
/** Pixels drawn per pixel of the page while things move slowly on this machine, and at first. */
const COARSE = 0.6;
const FIRST = 1;
/** Length of the axes of a frame, for a cell of 1 m. */
const AXIS = 0.06;
/** Diagonal of solids that need not be in sight as a whole [m]. */
const LARGE = 3;
/** Postures of the plan that are brought in sight. */
const POSTURES = 60;
/** Share of the view that the cell fills. */
const FILLED = 0.9;
/** Pixels of a fine picture. */
const MOST_PIXELS = 8e6;
/** How long nothing must move before a fine picture is drawn [ms]. */
const STILL = 300;

/** What stands in the cell at a time, and how it is seen. */
export class Scene {
  /**
   * @param {Plan} plan
   * @param {HTMLElement} holder takes the canvas
   * @throws {Error} the browser has no WebGL
   */
  constructor(plan, holder) {
    this.plan = plan;
    this.holder = holder;
    this.time = 0;
    /** @type {Pose[]} */
    this.poses = [];
    this.drawn = 0;
    this.slow = 0;
    this.moving = FIRST;
    this.materials = new Materials();
    this.renderer = new THREE.WebGLRenderer({ antialias: false, powerPreference: "high-performance" });
    this.renderer.debug.checkShaderErrors = false;
    this.ratio = FIRST;
    this.renderer.setPixelRatio(this.ratio);
    this.renderer.domElement.className = "view";
    holder.append(this.renderer.domElement);
    this.world = new THREE.Scene();
    this.camera = new THREE.PerspectiveCamera(35, 1, 0.02, 100);
    this.camera.up.set(0, 0, 1);
    this.controls = new OrbitControls(this.camera, this.renderer.domElement);
    this.controls.addEventListener("change", () => this.request());
    this.requested = false;
    const { materials } = this;
    this.frames = plan.bodies.map(() => new THREE.Group());
    this.add(this.frames);
    this.meshes = plan.solids.map((solid) => {
      const at = solid.body === WORLD || solid.body === undefined ? this.world : this.frames[solid.body];
      const mesh = meshOf(solid, plan.hulls, this.materialOf(solid));
      at.add(mesh);
      return mesh;
    });
    this.things = new Things(plan, materials);
    this.add(this.things.meshes);
    this.belts = plan.conveyors.map((conveyor) => new Belt(conveyor, materials));
    this.skeleton = new Skeleton(plan, materials);
    this.traces = traces(plan, materials);
    this.add([this.skeleton.group, ...this.belts.map((belt) => belt.group)]);
    this.add(this.traces.flatMap((trace) => trace.lines));
    this.tips = armsOf(plan).map(() => tripod(materials));
    this.add(this.tips);
    this.pairs = plan.clearances.map((clearance) => new ClosestPair(clearance, materials.solid(clearanceColour(clearance))));
    this.add(this.pairs.map((pair) => pair.group));
    const floor = new THREE.GridHelper(8, 32, 0xffffff, 0xffffff).rotateX(Math.PI / 2);
    floor.material = materials.line("floor");
    floor.position.z = -0.001;
    this.world.add(floor);
    this.floor = floor;
    this.size = 1;
    this.setTime(0);
    this.setSize();
    this.fitted = false;
    new ResizeObserver(() => this.resize()).observe(holder);
  }

  /** @param {THREE.Object3D[]} objects that stand in the world, perhaps none */
  add(objects) {
    for (const object of objects) this.world.add(object);
  }

  /** @param {Solid} solid */
  materialOf(solid) {
    if (solid.kind === "half_space") return this.materials.solid("ground");
    if (solid.role === "obstacle") return this.materials.solid("obstacle");
    if (solid.role === "tool") return this.materials.solid("tool-solid");
    return this.materials.solid(solid.arm ? `${solid.arm}-arm` : "link");
  }

  /** @param {(name: string) => string} colour */
  recolour(colour) {
    this.world.background = new THREE.Color(colour("view"));
    this.materials.recolour(colour);
    this.request();
  }

  /** @param {number} time s */
  setTime(time) {
    this.time = time;
    this.poses = forwardKinematics(this.plan.bodies, positionsAt(this.plan.joints, time));
    const poses = this.poses;
    this.frames.forEach((frame, i) => place(frame, poses[i]));
    this.things.setTime(time, poses);
    for (const belt of this.belts) belt.setTime(time);
    for (const trace of this.traces) trace.setTime(time);
    this.skeleton.setPoses(poses);
    armsOf(this.plan).forEach((arm, i) => {
      const tcp = this.plan.tcps[arm];
      place(this.tips[i], compose(poses[tcp.body], tcp));
    });
    for (const pair of this.pairs) pair.setTime(time);
    this.request();
  }

  /**
   * Shows or hides a kind of help.
   * @param {"traces" | "frames" | "skeleton" | "pair"} name
   * @param {boolean} on
   */
  show(name, on) {
    if (name === "traces") for (const trace of this.traces) trace.setVisible(on);
    if (name === "frames") for (const tip of this.tips) tip.visible = on;
    if (name === "skeleton") this.skeleton.setWanted(on);
    if (name === "pair") for (const pair of this.pairs) pair.group.visible = on;
    this.setTime(this.time);
  }

  /** Draws once, before the next picture of the browser. */
  request() {
    if (this.requested) return;
    this.requested = true;
    requestAnimationFrame(() => {
      this.requested = false;
      this.render();
    });
  }

  /**
   * Draws now. What moves is drawn as finely as this machine can without delay; what stands still is drawn with two
   * by two pixels for each of the page, which smooths edges at a lower price than multisampling in software.
   */
  render() {
    const now = performance.now();
    const gap = now - this.drawn;
    this.drawn = now;
    if (gap < STILL) {
      this.slow = gap > SLOW ? this.slow + 1 : 0;
      if (this.slow >= 3) this.moving = COARSE;
      this.setRatio(this.moving);
    }
    this.renderer.render(this.world, this.camera);
    clearTimeout(this.finer);
    this.finer = setTimeout(() => {
      this.setRatio(this.fine());
      this.renderer.render(this.world, this.camera);
    }, STILL);
  }

  /** Returns what is seen now as the address of a picture, for paper. */
  picture() {
    this.renderer.render(this.world, this.camera);
    return this.renderer.domElement.toDataURL();
  }

  /** Returns how finely what stands still is drawn: two by two pixels per pixel of the page, less on very large screens. */
  fine() {
    const { clientWidth: width, clientHeight: height } = this.holder;
    return Math.min(Math.max(Math.sqrt(MOST_PIXELS / (width * height || 1)), 1), 2);
  }

  /** @param {number} ratio pixels drawn per pixel of the page */
  setRatio(ratio) {
    if (ratio === this.ratio) return;
    this.ratio = ratio;
    this.renderer.setPixelRatio(ratio);
  }

  resize() {
    const { clientWidth: width, clientHeight: height } = this.holder;
    if (width === 0 || height === 0) return;
    this.renderer.setSize(width, height);
    this.camera.aspect = width / height;
    this.camera.updateProjectionMatrix();
    if (!this.fitted) this.fit();
    this.fitted = true;
    this.render();
  }

  /** Returns points around robot, things, ways of the tools, and obstacles of no more than a few metres. */
  outline() {
    this.world.updateMatrixWorld(true);
    /** @type {THREE.Vector3[]} */
    const found = [...this.traces.flatMap((trace) => corners(trace.bounds())), ...this.things.places()];
    for (let i = 0; i <= POSTURES; i++) {
      const positions = positionsAt(this.plan.joints, (this.plan.duration * i) / POSTURES);
      for (const pose of forwardKinematics(this.plan.bodies, positions)) found.push(new THREE.Vector3(...pose.xyz));
    }
    for (const mesh of this.meshes) {
      mesh.geometry.computeBoundingBox();
      const box = /** @type {THREE.Box3} */ (mesh.geometry.boundingBox);
      if (box.getSize(new THREE.Vector3()).length() > LARGE) continue;
      found.push(...corners(box).map((p) => p.applyMatrix4(mesh.matrixWorld)));
    }
    return found;
  }

  /** Draws what helps to see at the size of the cell. */
  setSize() {
    const box = new THREE.Box3().setFromPoints(this.outline());
    this.size = box.getSize(new THREE.Vector3()).length() || 1;
    for (const tip of this.tips) tip.scale.setScalar(AXIS * this.size);
    for (const part of [...this.pairs, ...this.traces]) part.setSize(this.size);
    this.floor.scale.setScalar(2 ** Math.round(Math.log2(this.size / 1.6)));
    this.setTime(this.time);
  }

  /**
   * Moves the camera so that everything is in sight.
   * @param {[number, number, number]} [direction] from the cell to the camera
   */
  fit(direction = [1.25, -0.95, 0.75]) {
    const points = this.outline();
    const centre = new THREE.Box3().setFromPoints(points).getCenter(new THREE.Vector3());
    const away = new THREE.Vector3(...direction).normalize();
    const right = new THREE.Vector3(0, 0, 1).cross(away).normalize();
    const up = away.clone().cross(right);
    const tall = Math.tan((this.camera.fov * Math.PI) / 360) * FILLED;
    const wide = tall * this.camera.aspect;
    let distance = 0;
    for (const point of points) {
      const from = point.clone().sub(centre);
      const across = Math.max(Math.abs(from.dot(right)) / wide, Math.abs(from.dot(up)) / tall);
      distance = Math.max(distance, across + from.dot(away));
    }
    this.controls.target.copy(centre);
    this.camera.position.copy(centre).addScaledVector(away, distance);
    this.controls.update();
    this.request();
  }

  /**
   * Returns the name of what is under a point of the canvas, or nothing.
   * @param {number} x px
   * @param {number} y px
   */
  nameAt(x, y) {
    const { clientWidth: width, clientHeight: height } = this.holder;
    const caster = new THREE.Raycaster();
    caster.setFromCamera(new THREE.Vector2((2 * x) / width - 1, 1 - (2 * y) / height), this.camera);
    const hits = caster.intersectObjects([...this.world.children], true);
    const names = hits.map((hit) => this.things.nameOf(hit) || hit.object.name);
    return names.find((name) => name !== "") ?? "";
  }
}

/** @param {THREE.Box3} box @returns {THREE.Vector3[]} */
function corners({ min, max }) {
  return [0, 1, 2, 3, 4, 5, 6, 7].map(
    (k) => new THREE.Vector3(k & 1 ? max.x : min.x, k & 2 ? max.y : min.y, k & 4 ? max.z : min.z),
  );
}

/**
 * Returns the axes of a frame as lines: x, y, z.
 * @param {Materials} materials
 */
function tripod(materials) {
  const group = new THREE.Group();
  ["x", "y", "z"].forEach((name, i) => {
    const end = new THREE.Vector3().setComponent(i, 1);
    const line = new THREE.BufferGeometry().setFromPoints([new THREE.Vector3(), end]);
    group.add(new THREE.Line(line, materials.line(`axis-${name}`)));
  });
  return group;
}
