// 3-D view of the cell at the time of the cursor.

import * as THREE from "three";
import { OrbitControls } from "three/addons/controls/OrbitControls.js";
import { clearanceColour } from "./clearance.js";
import { Fixtures, seamParts } from "./fixtures.js";
import { Machine } from "./machine.js";
import { Belt, ClosestPair, Skeleton, traces } from "./scene_parts.js";
import { CarriedObjects } from "./scene_objects.js";
import { Materials, meshOf, place } from "./shapes.js";
import { WORLD, compose, forwardKinematics } from "./poses.js";
import { positionsAt } from "./trajectory.js";
import { armsOf } from "./data.js";
import { PHONE } from "./layout.js";

/** @typedef {import("./types.js").Plan} Plan */
/** @typedef {import("./types.js").Pose} Pose */
/** @typedef {import("./types.js").Solid} Solid */

/** Interval between frames above which the resolution is lowered [ms]. */
const SLOW_FRAME = 26;
/** Pixel ratio in motion: on slow machines, and at first. */
const COARSE_RATIO = 0.6;
const FIRST_RATIO = 1;
/** Length of the axes of a frame, as a fraction of the size of the cell. */
const AXIS = 0.06;
/** Diagonal above which solids are ignored by `fit` [m]. */
const LARGE = 5;
/** Number of sampled postures that `fit` brings into view. */
const POSTURES = 60;
/** Directions from the cell to the camera, by preference: over both front corners, from both sides, over the back corners. */
const VIEWS = /** @type {[number, number, number][]} */ ([[1.25, -0.95, 0.75], [1.25, 0.95, 0.75], [0.3, -1.54, 0.75], [0.3, 1.54, 0.75], [-1.25, -0.95, 0.75], [-1.25, 0.95, 0.75]]);
/** Maximum number of targets, and number of instants, that views are judged by. */
const SAMPLES = 12;
/** Share of hidden targets that a preferred view may have in excess. */
const EXCESS = 0.05;
/** Distance from a target within which a body hides nothing: the tool and its part [m]. */
const AT_TARGET = 0.08;
/** Fraction of the view that the cell fills. */
const FILLED = 0.9;
/** Layer of the objects that cast shadows, and smallest area that shows them [m²]. */
const CASTS = 1;
const SHADED = 0.1;
/** Height of the texts over the view above and below the cell on a phone [px]. */
const ABOVE = 52;
const BELOW = 92;
/** Maximum number of pixels of a still frame. */
const MAX_PIXELS = 8e6;
/** Rendered pixels per pixel of a still. */
const SMOOTHING = 2;
/** Time without motion after which a still frame is drawn at full resolution [ms]. */
const STILL = 300;

/** 3-D scene of the cell with its camera. */
export class Scene {
  /**
   * @param {Plan} plan
   * @param {HTMLElement} container parent of the canvas
   * @throws {Error} without WebGL
   */
  constructor(plan, container) {
    this.plan = plan;
    this.container = container;
    this.time = 0;
    /** @type {Pose[]} */
    this.poses = [];
    this.drawn = 0;
    this.slow = 0;
    this.moving = FIRST_RATIO;
    this.materials = new Materials();
    this.renderer = new THREE.WebGLRenderer({ antialias: false, powerPreference: "high-performance" });
    this.renderer.debug.checkShaderErrors = false;
    this.ratio = FIRST_RATIO;
    this.renderer.setPixelRatio(this.ratio);
    this.renderer.domElement.className = "view";
    container.append(this.renderer.domElement);
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
      const parent = solid.body === WORLD || solid.body === undefined ? this.world : this.frames[solid.body];
      const mesh = meshOf(solid, plan.hulls, this.materialOf(solid));
      parent.add(mesh);
      return mesh;
    });
    this.objects = new CarriedObjects(plan, materials);
    this.add(this.objects.meshes);
    this.machine = new Machine(plan, materials);
    this.fixtures = new Fixtures(plan, materials);
    this.drawings = [...this.machine.pieces, ...seamParts(plan, materials)].map(({ body, mesh }) => {
      this.frames[body].add(mesh);
      return mesh;
    });
    this.drawings.push(/** @type {any} */ (this.fixtures.group));
    this.world.add(this.fixtures.group);
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
    floor.position.z = this.fixtures.floor - 0.001;
    this.world.add(floor);
    this.floor = floor;
    this.size = 1;
    this.setTime(0);
    this.setSize();
    for (const object of [...this.frames, ...this.objects.meshes, ...this.meshes, this.fixtures.group]) {
      object.traverse((part) => part.layers.enable(CASTS));
    }
    this.shadows = this.makeShadows();
    this.show("checked", false);
    this.show("frames", false);
    /** Direction from the cell to the camera of the fitted view; null after the reader has moved the camera. */
    this.direction = /** @type {[number, number, number] | null} */ (this.leastHidden());
    this.controls.addEventListener("start", () => (this.direction = null));
    this.controls.addEventListener("end", () => this.clearView());
    this.materials.setGhost(["obstacle-clear"], true);
    new ResizeObserver(() => this.resize()).observe(container);
  }

  /** Create a material of shadows for the floor and for each large level top of an obstacle. */
  makeShadows() {
    const { materials, fixtures } = this;
    const reach = 1.5 * this.size;
    const tops = fixtures.obstacles.flatMap(({ solid, box }) => {
      const size = box.getSize(new THREE.Vector3());
      const isLevel = solid.kind === "box" && size.toArray().every((side, k) => Math.abs(side - solid.size[k]) < 1e-6);
      if (!isLevel || size.x * size.y < SHADED) return [];
      return materials.shadow("obstacle-shadow", box.max.z, [box.min.x, box.min.y, box.max.x, box.max.y]);
    });
    return [materials.shadow("view-shadow", fixtures.floor, [-reach, -reach, reach, reach]), ...tops];
  }

  /** Draw the world, and its shadows over it. @param {boolean} [plain] without shadows */
  draw(plain = false) {
    const { renderer, world, camera } = this;
    renderer.autoClear = true;
    renderer.render(world, camera);
    if (plain) return;
    renderer.autoClear = false;
    camera.layers.set(CASTS);
    for (const shadow of this.shadows) {
      world.overrideMaterial = shadow;
      renderer.render(world, camera);
    }
    world.overrideMaterial = null;
    camera.layers.set(0);
  }

  /** Add objects to the world. @param {THREE.Object3D[]} objects */
  add(objects) {
    for (const object of objects) this.world.add(object);
  }

  /** Return the material of a solid. @param {Solid} solid */
  materialOf(solid) {
    if (solid.kind === "half_space") return this.materials.solid("ground");
    if (solid.role === "obstacle") return this.materials.solid("obstacle");
    if (solid.role === "tool") return this.materials.solid("tool-solid");
    return this.materials.solid(solid.arm ? `${solid.arm}-arm` : "base");
  }

  /** @param {(name: string) => string} colour */
  recolour(colour) {
    this.renderer.setClearColor(new THREE.Color(colour("view")));
    this.materials.recolour(colour);
    this.request();
  }

  /** @param {number} time s */
  setTime(time) {
    this.time = time;
    this.poses = forwardKinematics(this.plan.bodies, positionsAt(this.plan.joints, time));
    const poses = this.poses;
    this.frames.forEach((frame, i) => place(frame, poses[i]));
    this.objects.setTime(time, poses);
    this.machine.setTime(time);
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
   * Show or hide a visual aid.
   * @param {"traces" | "frames" | "skeleton" | "pair" | "checked"} name checked: the shapes that collisions are checked with
   * @param {boolean} on
   */
  show(name, on) {
    if (name === "traces") for (const trace of this.traces) trace.setVisible(on);
    if (name === "frames") for (const tip of this.tips) tip.visible = on;
    if (name === "skeleton") {
      this.skeleton.setVisible(on);
      this.materials.setGhost(this.machine.colours, on);
    }
    if (name === "pair") for (const pair of this.pairs) pair.group.visible = on;
    if (name === "checked") {
      for (const drawing of this.drawings) drawing.visible = !on;
      this.meshes.forEach((mesh, i) => (mesh.visible = on || this.plan.solids[i].role === "obstacle"));
    }
    this.setTime(this.time);
  }

  /** Request one rendering before the next frame of the browser. */
  request() {
    if (this.requested) return;
    this.requested = true;
    requestAnimationFrame(() => {
      this.requested = false;
      this.render();
    });
  }

  /**
   * Render now. In motion the pixel ratio is as high as this machine can render without delay. A still frame has up to
   * 2 x 2 pixels per pixel of the page, which smooths edges at a lower cost than multisampling in software.
   */
  render() {
    const now = performance.now();
    const gap = now - this.drawn;
    this.drawn = now;
    if (gap < STILL) {
      this.slow = gap > SLOW_FRAME ? this.slow + 1 : 0;
      if (this.slow >= 3) this.moving = COARSE_RATIO;
      this.setRatio(this.moving);
    }
    this.draw(this.moving < FIRST_RATIO);
    clearTimeout(this.finer);
    this.finer = setTimeout(() => {
      this.setRatio(this.fine());
      this.draw();
    }, STILL);
  }

  /** Render the current view for paper; return it as a data URL. */
  picture() {
    this.draw();
    return this.renderer.domElement.toDataURL();
  }

  /**
   * Draw the current view into another canvas, smoothed.
   * @param {CanvasRenderingContext2D} g
   * @param {number} width px
   * @param {number} height px
   */
  drawInto(g, width, height) {
    const size = this.renderer.getSize(new THREE.Vector2());
    const { ratio } = this;
    const { aspect } = this.camera;
    this.setRatio(SMOOTHING);
    this.renderer.setSize(width, height, false);
    this.camera.aspect = width / height;
    this.camera.updateProjectionMatrix();
    this.draw();
    g.drawImage(this.renderer.domElement, 0, 0, width, height);
    this.setRatio(ratio);
    this.renderer.setSize(size.x, size.y, false);
    this.camera.aspect = aspect;
    this.camera.updateProjectionMatrix();
    this.request();
  }

  /** Compute the pixel ratio of still frames: 2, less on very large screens. */
  fine() {
    const { clientWidth: width, clientHeight: height } = this.container;
    return Math.min(Math.max(Math.sqrt(MAX_PIXELS / (width * height || 1)), 1), 2);
  }

  /** @param {number} ratio rendered pixels per pixel of the page */
  setRatio(ratio) {
    if (ratio === this.ratio) return;
    this.ratio = ratio;
    this.renderer.setPixelRatio(ratio);
  }

  resize() {
    const { clientWidth: width, clientHeight: height } = this.container;
    if (width === 0 || height === 0) return;
    this.renderer.setSize(width, height);
    this.camera.aspect = width / height;
    this.camera.updateProjectionMatrix();
    if (this.direction) this.fit(this.direction);
    this.render();
  }

  /** Collect points around the robot, carried objects, tool paths and all but very large solids. */
  outline() {
    this.world.updateMatrixWorld(true);
    /** @type {THREE.Vector3[]} */
    const points = [...this.traces.flatMap((trace) => corners(trace.bounds())), ...this.objects.positions()];
    for (let i = 0; i <= POSTURES; i++) {
      const positions = positionsAt(this.plan.joints, (this.plan.duration * i) / POSTURES);
      for (const pose of forwardKinematics(this.plan.bodies, positions)) points.push(new THREE.Vector3(...pose.xyz));
    }
    /** @type {THREE.Mesh[]} */
    const fixtures = [];
    this.fixtures.group.traverse((part) => part instanceof THREE.Mesh && fixtures.push(part));
    for (const mesh of [...this.meshes, ...fixtures]) {
      mesh.geometry.computeBoundingBox();
      const box = /** @type {THREE.Box3} */ (mesh.geometry.boundingBox);
      if (box.getSize(new THREE.Vector3()).length() > LARGE) continue;
      points.push(...corners(box).map((p) => p.applyMatrix4(mesh.matrixWorld)));
    }
    return points;
  }

  /** Scale the visual aids to the size of the cell. */
  setSize() {
    const box = new THREE.Box3().setFromPoints(this.outline());
    this.size = box.getSize(new THREE.Vector3()).length() || 1;
    for (const tip of this.tips) tip.scale.setScalar(AXIS * this.size);
    for (const part of [...this.pairs, ...this.traces]) part.setSize(this.size);
    this.floor.scale.setScalar(2 ** Math.round(Math.log2(this.size / 1.6)));
    this.setTime(this.time);
  }

  /** Select the preferred view in which bodies hide about as few targets as possible. */
  leastHidden() {
    const { events, duration } = this.plan;
    const count = Math.min(events.length, SAMPLES);
    const targets = Array.from({ length: count }, (_, i) => new THREE.Vector3(...events[Math.floor((i * events.length) / count)].xyz));
    const directions = VIEWS.map((view) => new THREE.Vector3(...view).normalize());
    const hidden = VIEWS.map(() => 0);
    for (let i = 0; i < SAMPLES; i++) {
      this.setTime(((i + 0.5) * duration) / SAMPLES);
      this.world.updateMatrixWorld(true);
      directions.forEach((direction, k) => {
        const isHidden = (/** @type {THREE.Vector3} */ target) => new THREE.Raycaster(target, direction, AT_TARGET).intersectObjects(this.meshes, false).length > 0;
        hidden[k] += targets.filter(isHidden).length;
      });
    }
    this.setTime(0);
    const least = Math.min(...hidden);
    return VIEWS[hidden.findIndex((number) => number <= least + EXCESS * SAMPLES * count)];
  }

  /**
   * Move the camera so that the whole cell is in view.
   * @param {[number, number, number]} [direction] from the cell to the camera
   */
  fit(direction = this.leastHidden()) {
    this.direction = direction;
    const points = this.outline();
    const centre = new THREE.Box3().setFromPoints(points).getCenter(new THREE.Vector3());
    const toCamera = new THREE.Vector3(...direction).normalize();
    const right = new THREE.Vector3(0, 0, 1).cross(toCamera).normalize();
    const up = toCamera.clone().cross(right);
    const { clientWidth: width, clientHeight: height } = this.container;
    const [above, below] = matchMedia(PHONE).matches ? [ABOVE / height, BELOW / height] : [0, 0];
    this.camera.setViewOffset(width, height, 0, ((below - above) / 2) * height, width, height);
    const wide = Math.tan((this.camera.fov * Math.PI) / 360) * FILLED * this.camera.aspect;
    const tall = (wide / this.camera.aspect) * (1 - above - below);
    let distance = 0;
    for (let round = 0; round < 4; round++) {
      const [x, y] = [[Infinity, -Infinity], [Infinity, -Infinity]];
      distance = 0;
      const from = points.map((point) => point.clone().sub(centre));
      for (const point of from) {
        const across = Math.max(Math.abs(point.dot(right)) / wide, Math.abs(point.dot(up)) / tall);
        distance = Math.max(distance, across + point.dot(toCamera));
      }
      // Perspective draws near points larger: the middle of the picture is not that of the cell.
      for (const point of from) {
        const depth = distance - point.dot(toCamera);
        for (const [axis, ends] of /** @type {const} */ ([[right, x], [up, y]])) {
          const seen = point.dot(axis) / depth;
          [ends[0], ends[1]] = [Math.min(ends[0], seen), Math.max(ends[1], seen)];
        }
      }
      centre.addScaledVector(right, (distance * (x[0] + x[1])) / 2).addScaledVector(up, (distance * (y[0] + y[1])) / 2);
    }
    this.controls.target.copy(centre);
    this.camera.position.copy(centre).addScaledVector(toCamera, distance);
    this.controls.update();
    this.clearView();
  }

  /** Draw obstacles translucent that hide targets from the camera, such as the back of a shelf. */
  clearView() {
    this.world.updateMatrixWorld(true);
    const hiding = new Set();
    for (const { xyz } of this.plan.events) {
      const target = new THREE.Vector3(...xyz);
      const sight = this.camera.position.clone().sub(target);
      const ray = new THREE.Raycaster(target, sight.clone().normalize(), AT_TARGET, sight.length());
      for (const { object } of ray.intersectObjects(this.meshes, false)) hiding.add(object);
    }
    this.meshes.forEach((mesh, i) => {
      const isClear = hiding.has(mesh) && this.plan.solids[i].role === "obstacle";
      mesh.material = isClear ? this.materials.solid("obstacle-clear") : this.materialOf(this.plan.solids[i]);
    });
    this.request();
  }

  /**
   * Return the name of the object under a point of the canvas, or an empty text.
   * @param {number} x px
   * @param {number} y px
   */
  nameAt(x, y) {
    const { clientWidth: width, clientHeight: height } = this.container;
    const caster = new THREE.Raycaster();
    caster.setFromCamera(new THREE.Vector2((2 * x) / width - 1, 1 - (2 * y) / height), this.camera);
    const hits = caster.intersectObjects([...this.world.children], true);
    const names = hits.filter(({ object }) => isShown(object)).map((hit) => this.objects.nameOf(hit) || hit.object.name);
    return names.find((name) => name !== "") ?? "";
  }
}

/** Whether an object and all that hold it are visible. @param {THREE.Object3D | null} object @returns {boolean} */
function isShown(object) {
  return object === null || (object.visible && isShown(object.parent));
}

/** Return the corners of a box. @param {THREE.Box3} box @returns {THREE.Vector3[]} */
function corners({ min, max }) {
  return [0, 1, 2, 3, 4, 5, 6, 7].map(
    (k) => new THREE.Vector3(k & 1 ? max.x : min.x, k & 2 ? max.y : min.y, k & 4 ? max.z : min.z),
  );
}

/**
 * Create the axes of a frame as lines: x, y, z.
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
