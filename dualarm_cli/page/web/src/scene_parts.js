// Parts of the 3-D view other than solids: skeleton, tool traces, closest pairs, conveyor belts.

import * as THREE from "three";
import { clearanceAt } from "./clearance.js";
import { WORLD, compose, forwardKinematics } from "./poses.js";
import { place } from "./shapes.js";
import { countUpTo, positionsAt } from "./trajectory.js";

/** @typedef {import("./types.js").Plan} Plan */
/** @typedef {import("./types.js").Pose} Pose */
/** @typedef {import("./shapes.js").Materials} Materials */

/** Sampling rate of a trace [1/s], and maximum number of samples. */
const SAMPLE_RATE = 40;
const MAX_SAMPLES = 8000;
/** Visible part of a trace before and after the cursor, and bold part behind the tool [s]. */
const VISIBLE = 20;
const TAIL = 1.5;
/** Radius of the bold part, as a fraction of the size of the cell. */
const TAIL_RADIUS = 0.0013;

/** Joints of the robot as dots, connected by lines. */
export class Skeleton {
  /** @param {Plan} plan @param {Materials} materials */
  constructor(plan, materials) {
    this.plan = plan;
    this.group = new THREE.Group();
    /** @type {{from: number, to: number, tip?: Pose, arm: string}[]} */
    this.bones = [];
    const armOf = (/** @type {number} */ i) => {
      const joint = plan.joints[plan.bodies[i].joint];
      return joint ? joint.group : "platform";
    };
    plan.bodies.forEach((body, i) => {
      if (body.parent !== WORLD) this.bones.push({ from: body.parent, to: i, arm: armOf(i) });
    });
    for (const [arm, tcp] of Object.entries(plan.tcps)) {
      this.bones.push({ from: tcp.body, to: tcp.body, tip: tcp, arm });
    }
    const withSolids = new Set(plan.solids.filter((s) => s.role === "link").map((s) => s.arm));
    this.bare = new Set(Object.keys(plan.tcps).filter((arm) => !withSolids.has(arm)));
    if (!plan.solids.some((solid) => solid.role === "link")) this.bare.add("platform");
    const size = this.bare.size > 0 ? 0.018 : 0.008;
    const bone = new THREE.CylinderGeometry(size, size, 1, 10).rotateX(Math.PI / 2);
    const dot = new THREE.SphereGeometry(size * 1.8, 14, 10);
    this.parts = this.bones.map(({ arm }) => {
      const material = materials.solid(`${arm}-trace`);
      const parts = { line: new THREE.Mesh(bone, material), dot: new THREE.Mesh(dot, material) };
      this.group.add(parts.line, parts.dot);
      return parts;
    });
    this.setVisible(false);
  }

  /** Show or hide the skeleton of arms that have solids. @param {boolean} isVisible */
  setVisible(isVisible) {
    this.bones.forEach(({ arm }, i) => {
      const visible = isVisible || this.bare.has(arm);
      this.parts[i].line.visible = visible;
      this.parts[i].dot.visible = visible;
    });
  }

  /** @param {Pose[]} poses poses of the bodies */
  setPoses(poses) {
    this.bones.forEach(({ from, to, tip }, i) => {
      const a = new THREE.Vector3(...poses[from].xyz);
      const b = new THREE.Vector3(...(tip ? compose(poses[to], tip) : poses[to]).xyz);
      const { line, dot } = this.parts[i];
      if (!dot.visible) return;
      dot.position.copy(b);
      line.position.copy(a).add(b).multiplyScalar(0.5);
      line.scale.z = Math.max(a.distanceTo(b), 1e-6);
      line.lookAt(b);
    });
  }
}

/**
 * Create the traces of the tool centre points.
 * @param {Plan} plan
 * @param {Materials} materials
 * @returns {Trace[]} one per arm
 */
export function traces(plan, materials) {
  const count = Math.min(Math.ceil(plan.duration * SAMPLE_RATE) + 1, MAX_SAMPLES);
  const times = Float64Array.from({ length: count }, (_, i) => (plan.duration * i) / (count - 1 || 1));
  const arms = Object.entries(plan.tcps);
  const points = arms.map(() => new Float32Array(3 * count));
  times.forEach((time, i) => {
    const poses = forwardKinematics(plan.bodies, positionsAt(plan.joints, time));
    arms.forEach(([, tcp], k) => points[k].set(compose(poses[tcp.body], tcp).xyz, 3 * i));
  });
  return arms.map(([arm], k) => new Trace(times, points[k], arm, materials));
}

/** Path of a tool centre point: faint around the cursor, bold in the recent past. */
class Trace {
  /**
   * @param {Float64Array} times
   * @param {Float32Array} points three numbers per time
   * @param {string} arm
   * @param {Materials} materials
   */
  constructor(times, points, arm, materials) {
    this.times = times;
    this.points = points;
    this.radius = TAIL_RADIUS;
    this.path = new THREE.BufferGeometry().setAttribute("position", new THREE.BufferAttribute(points, 3));
    const step = times.length > 1 ? times[1] - times[0] : 1;
    const maxRods = Math.min(Math.ceil(TAIL / step) + 2, times.length);
    const rod = new THREE.CylinderGeometry(1, 1, 1, 6, 1, true).rotateX(Math.PI / 2);
    this.tail = new THREE.InstancedMesh(rod, materials.solid(`${arm}-trace`), maxRods);
    this.lines = [new THREE.Line(this.path, materials.line(`${arm}-path`)), this.tail];
    for (const line of this.lines) line.frustumCulled = false;
  }

  /** @param {number} time */
  setTime(time) {
    const between = (/** @type {number} */ from, /** @type {number} */ to) => {
      const first = Math.max(countUpTo(this.times, from) - 1, 0);
      return { first, count: Math.max(countUpTo(this.times, to) - first, 0) };
    };
    const path = between(time - VISIBLE, time + VISIBLE);
    this.path.setDrawRange(path.first, path.count);
    const tail = between(time - TAIL, time);
    this.tail.count = Math.max(tail.count - 1, 0);
    const [a, b, rod] = [new THREE.Vector3(), new THREE.Vector3(), new THREE.Object3D()];
    for (let i = 0; i < this.tail.count; i++) {
      const offset = 3 * (tail.first + i);
      a.fromArray(this.points, offset);
      b.fromArray(this.points, offset + 3);
      rod.position.addVectors(a, b).multiplyScalar(0.5);
      rod.scale.set(this.radius, this.radius, a.distanceTo(b));
      rod.lookAt(b);
      rod.updateMatrix();
      this.tail.setMatrixAt(i, rod.matrix);
    }
    this.tail.instanceMatrix.needsUpdate = true;
  }

  /** @param {number} size of the cell [m] */
  setSize(size) {
    this.radius = TAIL_RADIUS * size;
  }

  /** @param {boolean} visible */
  setVisible(visible) {
    for (const line of this.lines) line.visible = visible;
  }

  bounds() {
    return new THREE.Box3().setFromArray(this.points);
  }
}

/** Radii of the end points of a closest pair and of the line between them, as fractions of the size of the cell. */
const DOT = 0.006;
const ROD = 0.0025;

/** Closest points of a pair with the line between them. */
export class ClosestPair {
  /** @param {import("./types.js").Clearance} clearance @param {THREE.ShaderMaterial} material its own */
  constructor(clearance, material) {
    this.clearance = clearance;
    this.group = new THREE.Group();
    this.line = new THREE.Mesh(new THREE.CylinderGeometry(1, 1, 1, 8), material);
    this.ends = [0, 1].map(() => new THREE.Mesh(new THREE.SphereGeometry(1, 12, 8), material));
    this.group.add(this.line, ...this.ends);
    // Drawn in front of everything, because solids would hide the narrow gap.
    material.depthTest = false;
    for (const part of this.group.children) part.renderOrder = 1;
    this.setSize(1);
  }

  /** @param {number} size of the cell [m] */
  setSize(size) {
    for (const end of this.ends) end.scale.setScalar(DOT * size);
    this.line.scale.x = this.line.scale.z = ROD * size;
  }

  /** @param {number} time */
  setTime(time) {
    const { points } = clearanceAt(this.clearance, time);
    const a = new THREE.Vector3().fromArray(points, 0);
    const b = new THREE.Vector3().fromArray(points, 3);
    this.ends[0].position.copy(a);
    this.ends[1].position.copy(b);
    this.line.position.copy(a).add(b).multiplyScalar(0.5);
    const along = b.sub(a);
    const length = along.length();
    this.line.scale.y = Math.max(length, 1e-6);
    if (length > 1e-9) this.line.quaternion.setFromUnitVectors(new THREE.Vector3(0, 1, 0), along.divideScalar(length));
  }
}

/** Distance of the stripes and thickness of a belt [m]. */
const STRIPE = 0.12;
const THICKNESS = 0.012;

/** Conveyor belt with moving stripes. */
export class Belt {
  /** @param {import("./types.js").Conveyor} conveyor @param {Materials} materials */
  constructor(conveyor, materials) {
    this.group = new THREE.Group();
    this.speed = Math.hypot(...conveyor.velocity);
    this.length = conveyor.length;
    const belt = new THREE.Mesh(
      new THREE.BoxGeometry(conveyor.length, conveyor.width, THICKNESS),
      materials.solid("belt"),
    );
    belt.position.z = -THICKNESS / 2;
    belt.name = conveyor.name;
    const stripe = new THREE.BoxGeometry(0.012, conveyor.width, 0.002);
    const count = Math.floor(conveyor.length / STRIPE);
    this.stripes = Array.from({ length: count }, () => new THREE.Mesh(stripe, materials.solid("stripe")));
    this.group.add(belt, ...this.stripes);
    place(this.group, conveyor);
    this.setTime(0);
  }

  /** @param {number} time */
  setTime(time) {
    const period = this.stripes.length * STRIPE;
    this.stripes.forEach((stripe, i) => {
      stripe.position.x = ((i * STRIPE + this.speed * time) % period) - period / 2;
    });
  }
}
