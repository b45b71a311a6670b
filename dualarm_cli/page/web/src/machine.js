// Drawn robot: housings, joint discs and grippers, from the axes of the joints and the sizes of the collision shapes.

import * as THREE from "three";
import { block, drum, housing, lay, turned } from "./outlines.js";
import { jointLabel } from "./labels.js";
import { WORLD, compose, inverse } from "./poses.js";
import { geometryOf, place } from "./shapes.js";

/** @typedef {import("./types.js").Plan} Plan */
/** @typedef {import("./types.js").Solid} Solid */
/** @typedef {import("./types.js").Pose} Pose */
/** @typedef {import("./types.js").CarriedObject} CarriedObject */
/** @typedef {import("./shapes.js").Materials} Materials */

/** Cosine above which a joint turns about its link, rather than bends it. */
const ALONG = 0.8;
/** Widest part that fingers hold [m]; wider ones are held by a suction cup. */
const WIDEST = 0.09;
/** Opening of the fingers beyond the part [m], and longest time to close or open [s]. */
const OPENING = 0.022;
const CLOSING = 0.25;

/** Kinds of solids whose first size is a radius. */
const ROUND = ["capsule", "cylinder", "sphere"];

/** Drawing of the robot and its grippers. */
export class Machine {
  /**
   * @param {Plan} plan
   * @param {Materials} materials
   */
  constructor(plan, materials) {
    this.plan = plan;
    this.materials = materials;
    /** @type {{body: number, mesh: THREE.Mesh}[]} */
    this.pieces = [];
    const looks = new Set(plan.visuals.map(({ name }) => name));
    for (const solid of plan.visuals) place(this.add(solid.body ?? WORLD, geometryOf(solid, plan.hulls), this.hueOf(solid), this.nameOf(solid)), solid);
    for (const solid of plan.solids) if (solid.role === "link" && !looks.has(solid.name ?? "")) this.drawLink(solid);
    if (looks.size === 0) this.drawShoulders();
    this.grippers = Object.keys(plan.tcps).map((arm) => new Gripper(plan, arm, materials));
    for (const gripper of this.grippers) this.pieces.push({ body: gripper.body, mesh: /** @type {any} */ (gripper.group) });
  }

  /**
   * @param {number} body
   * @param {THREE.BufferGeometry} geometry
   * @param {string} colour
   * @param {string} name
   */
  add(body, geometry, colour, name) {
    const mesh = new THREE.Mesh(geometry, this.materials.solid(colour));
    mesh.name = name;
    this.pieces.push({ body, mesh });
    return mesh;
  }

  /** Colours of the links and tools. */
  get colours() {
    return ["base", "flange", "tool-solid", ...Object.keys(this.plan.tcps).flatMap((arm) => [`${arm}-link`, `${arm}-arm`])];
  }

  /** Name a link with the joint that moves it. @param {Solid} solid */
  nameOf({ name = "", body = WORLD }) {
    const { joints, bodies } = this.plan;
    const joint = joints[bodies[body]?.joint ?? -1];
    return joint ? `${name}: joint ${jointLabel(joints, joint.name)}` : name;
  }

  /** Return the colour of a link. @param {Solid} solid */
  hueOf({ arm }) {
    return arm ? `${arm}-link` : "base";
  }

  /** Draw a link, and the joint that moves it. @param {Solid} solid */
  drawLink(solid) {
    const { plan } = this;
    const number = solid.body ?? WORLD;
    const body = plan.bodies[number];
    const joint = plan.joints[body?.joint ?? -1];
    const name = this.nameOf(solid);
    const colour = this.hueOf(solid);
    const [radius, length = 0] = solid.size;
    const pose = new THREE.Quaternion(...solid.quat);
    const torso = this.torso;
    if (torso?.solid === solid) this.drawTorso(torso, name);
    else if (solid.kind === "capsule") place(this.add(number, housing(radius, length), colour, name), solid);
    else if (solid.kind === "box") place(this.add(number, block(solid.size[0], solid.size[1], solid.size[2]), colour, name), solid);
    else if (solid.kind !== "sphere") place(this.add(number, geometryOf(solid, plan.hulls), colour, name), solid);
    if (!joint || body.slides || !["capsule", "sphere"].includes(solid.kind) || !solid.arm) return;
    const axis = new THREE.Vector3(...body.axis).normalize();
    const along = new THREE.Vector3(0, 0, 1).applyQuaternion(pose);
    const centre = new THREE.Vector3(...solid.xyz);
    const turn = new THREE.Quaternion().setFromUnitVectors(new THREE.Vector3(0, 0, 1), axis);
    const ring = (/** @type {number} */ across, /** @type {number} */ tall, /** @type {string} */ hue, bevel = 0.06 * radius) => {
      const mesh = this.add(number, drum(across, tall, bevel), hue, name);
      mesh.quaternion.copy(turn);
      return mesh;
    };
    if (solid.kind === "sphere") {
      ring(0.92 * radius, 1.5 * radius, "flange").position.copy(centre);
    } else if (Math.abs(axis.dot(along)) > ALONG) {
      // A joint that turns the link about itself is a band where the link begins.
      const begin = centre.addScaledVector(along, (-Math.sign(centre.dot(along) || 1) * length) / 2);
      ring(0.985 * radius, 0.16 * radius, `${solid.arm}-arm`).position.copy(begin);
    } else {
      // As wide as both links that it joins.
      const before = plan.solids.find((link) => link.body === body.parent && link.role === "link" && link.arm && link.kind === "capsule");
      const wide = 2 * Math.max(radius, before?.size[0] ?? 0);
      ring(0.98 * radius, wide, colour, 0.12 * radius);
      ring(0.8 * radius, wide + 0.018, `${solid.arm}-arm`, 0.004);
      ring(0.46 * radius, wide + 0.026, colour, 0.003);
    }
  }

  /** Draw the bodies that carry arms, with a shoulder for each arm. */
  drawShoulders() {
    const { plan } = this;
    const first = Object.keys(plan.tcps).map((arm) => {
      const number = plan.bodies.findIndex((body) => plan.joints[body.joint]?.group === arm);
      const solid = plan.solids.find(({ body, role }) => body === number && role === "link");
      const radius = solid && ROUND.includes(solid.kind) ? solid.size[0] : 0;
      return { arm, parent: plan.bodies[number].parent, at: new THREE.Vector3(...plan.bodies[number].xyz), radius };
    });
    const carriers = plan.solids.filter(({ role, arm }) => role === "link" && !arm);
    const torso = this.torso;
    for (const { arm, parent, at, radius } of first) {
      const own = carriers.filter(({ body }) => body === parent).map(({ xyz }) => new THREE.Vector3(...xyz));
      const [start] = own.sort((a, b) => a.distanceTo(at) - b.distanceTo(at));
      if (!start || radius === 0) continue;
      if (torso?.body === parent) start.copy(torso.chest);
      const half = start.distanceTo(at) / 2;
      if (2 * half < radius) continue;
      const sleeve = turned([[1.1 * radius, -half], [1.0 * radius, 0], [0.96 * radius, half - 0.02], [0.9 * radius, half], [0, half]]);
      lay(this.add(parent, sleeve, "base", `shoulder of the ${arm} arm`), start, at);
    }
  }

  /** Shoulders between two arms that one round link carries, and that link; null if there is none. */
  get torso() {
    const { plan } = this;
    const shoulders = plan.bodies.filter((body) => plan.joints[body.joint] && plan.joints[body.joint].group in plan.tcps && plan.joints[plan.bodies[body.parent]?.joint]?.group === "platform");
    const solid = plan.solids.find(({ body, role, kind }) => role === "link" && kind === "capsule" && body === shoulders[0]?.parent);
    if (shoulders.length !== 2 || shoulders[0].parent !== shoulders[1].parent || !solid) return null;
    const [a, b] = shoulders.map(({ xyz }) => new THREE.Vector3(...xyz));
    return { body: shoulders[0].parent, solid, span: a.distanceTo(b), chest: a.clone().add(b).multiplyScalar(0.5), across: b.clone().sub(a).normalize() };
  }

  /** Draw a trunk up to the shoulders and a chest between them. @param {NonNullable<Machine["torso"]>} torso @param {string} name */
  drawTorso({ body, solid, span, chest, across }, name) {
    const [radius, length] = solid.size;
    const along = new THREE.Vector3(0, 0, 1).applyQuaternion(new THREE.Quaternion(...solid.quat));
    const middle = new THREE.Vector3(...solid.xyz);
    const ends = [1, -1].map((sign) => middle.clone().addScaledVector(along, sign * (length / 2 + 0.9 * radius)));
    const [foot] = ends.sort((a, b) => b.distanceTo(chest) - a.distanceTo(chest));
    const half = foot.distanceTo(chest) / 2;
    lay(this.add(body, turned([[0, -half], [0.95 * radius, -half], [0.95 * radius, -0.82 * half], [0.7 * radius, -0.45 * half], [0.66 * radius, half]]), "base", name), foot, chest);
    const chestBlock = this.add(body, block(0.62 * span, 1.25 * radius, 1.2 * radius, 0.2 * radius), "base", name);
    const up = chest.clone().sub(foot);
    up.addScaledVector(across, -up.dot(across)).normalize();
    chestBlock.quaternion.setFromRotationMatrix(new THREE.Matrix4().makeBasis(across, up.clone().cross(across), up));
    chestBlock.position.copy(chest);
  }

  /** Move the fingers. @param {number} time s */
  setTime(time) {
    for (const gripper of this.grippers) gripper.setTime(time);
  }
}

/**
 * Compute the extents of a held part in the frame of the tool, from its solids; null if it has none or is never held.
 * @param {Plan} plan
 * @param {CarriedObject} object
 * @param {string} arm
 * @returns {THREE.Box3 | null}
 */
function heldExtents(plan, object, arm) {
  const tcp = plan.tcps[arm];
  const held = object.keyframes.find((keyframe) => keyframe.body === tcp.body);
  if (!held || object.solids.length === 0) return null;
  const box = new THREE.Box3();
  for (const solid of object.solids) {
    const { xyz, quat } = compose(compose(inverse(tcp), held), solid);
    const geometry = geometryOf(solid, plan.hulls);
    geometry.applyQuaternion(new THREE.Quaternion(...quat)).translate(...xyz);
    geometry.computeBoundingBox();
    box.union(/** @type {THREE.Box3} */ (geometry.boundingBox));
  }
  return box;
}

/**
 * List when the fingers of an arm begin and end to close (to 1) or open (to 0), in order of time.
 * @param {import("./types.js").Event[]} events
 * @param {string} arm
 * @returns {{from: number, to: number, closed: number, task: string, width: number}[]} widths 0 where not known
 */
export function grips(events, arm) {
  return events.flatMap((event) => {
    const length = Math.min(event.dwell || CLOSING / 2, CLOSING);
    if (event.arm !== arm) return [];
    const { task, width = 0 } = event;
    if (event.action === "pick" || event.action === "take") return [{ from: event.time, to: event.time + length, closed: 1, task, width }];
    if (event.action === "give") return [{ from: event.time, to: event.time + length, closed: 0, task, width }];
    const end = event.time + event.dwell;
    return event.action === "place" ? [{ from: end - length, to: end, closed: 0, task, width }] : [];
  });
}

/**
 * Compute how far fingers are closed at a time: 0 open, 1 on the part.
 * @param {ReturnType<typeof grips>} changes
 * @param {number} time s
 */
export function closedAt(changes, time) {
  const last = changes.filter((change) => change.from <= time).at(-1);
  if (!last) return changes.length > 0 ? 1 - changes[0].closed : 0;
  const done = Math.min((time - last.from) / Math.max(last.to - last.from, 1e-9), 1);
  return last.closed === 1 ? done : 1 - done;
}

/** Gripper with two fingers, a suction cup for wide parts, or a pointed tool for an arm that grips nothing. */
class Gripper {
  /**
   * @param {Plan} plan
   * @param {string} arm
   * @param {Materials} materials
   */
  constructor(plan, arm, materials) {
    this.materials = materials;
    this.arm = arm;
    const tcp = plan.tcps[arm];
    this.body = tcp.body;
    this.group = new THREE.Group();
    place(this.group, tcp);
    this.changes = grips(plan.events, arm);
    const T_tcp_flange = compose(inverse(tcp), plan.flanges[arm]);
    this.flange = new THREE.Vector3(...T_tcp_flange.xyz);
    this.changesTools = plan.objects.some((object) => object.role === "tool" && object.keyframes.some((keyframe) => keyframe.body === tcp.body));
    const boxes = plan.objects.filter((object) => object.role === "part").flatMap((object) => heldExtents(plan, object, arm) ?? []);
    const sides = /** @type {("x" | "y")[]} */ (["x", "y"]).map((side) => Math.max(0.03, ...boxes.map((box) => box.max[side] - box.min[side])));
    this.side = sides[1] <= sides[0] ? 1 : 0;
    this.width = Math.max(...this.changes.map(({ width }) => width), 0) || Math.min(...sides);
    this.depth = Math.max(0.008, ...boxes.map((box) => Math.min(box.max.z, 0.03)));
    this.top = boxes.length ? Math.min(...boxes.map((box) => box.min.z)) : -0.015;
    /** @type {THREE.Mesh[]} */
    this.fingers = [];
    const reach = -this.flange.z;
    if (tcp.hand && !this.changesTools) return;
    if (reach < 0.02 || this.changesTools) this.add(drum(0.032, 0.014), "tool-solid", new THREE.Vector3(0, 0, -reach + 0.007));
    else if (this.changes.length === 0) this.drawPointed(reach);
    else this.drawGripper(reach);
    this.setTime(0);
  }

  /** @param {THREE.BufferGeometry} geometry @param {string} colour @param {THREE.Vector3} at */
  add(geometry, colour, at) {
    const mesh = new THREE.Mesh(geometry, this.materials.solid(colour));
    mesh.position.copy(at);
    mesh.name = `tool of the ${this.arm} arm: drawn, not checked`;
    this.group.add(mesh);
    return mesh;
  }

  /** Draw what joins the flange to a point on the tool's axis. @param {number} z */
  drawNeck(z) {
    const to = new THREE.Vector3(0, 0, z);
    lay(this.add(drum(0.024, Math.max(this.flange.distanceTo(to), 0.004)), "tool-solid", to), this.flange, to);
    this.add(drum(0.034, 0.012), "flange", this.flange.clone().setZ(this.flange.z + 0.006));
  }

  /** @param {number} reach from the flange to the tool centre point [m] */
  drawPointed(reach) {
    const size = Math.min(0.026, 0.25 * reach);
    this.drawNeck(-0.62 * reach);
    this.add(turned([[0, -0.66 * reach], [size, -0.66 * reach], [size, -0.4 * reach], [0.62 * size, -0.3 * reach], [0.42 * size, -0.12 * reach], [0.0025, 0], [0, 0]]), "tool-solid", new THREE.Vector3());
    this.add(drum(1.03 * size, 0.1 * reach, 0.002), `${this.arm}-arm`, new THREE.Vector3(0, 0, -0.5 * reach));
  }

  /** @param {number} reach from the flange to the tool centre point [m] */
  drawGripper(reach) {
    const isWide = this.width > WIDEST && !this.changes.some(({ width }) => width > 0);
    const below = Math.max(Math.min(reach + this.top, 0.08), 0.3 * reach);
    const palm = Math.min(0.06, reach - 0.4 * below, 0.55 * reach);
    const start = -Math.min(below, 0.052) - palm;
    this.drawNeck(start);
    const across = isWide ? 0.05 : Math.max(Math.min(this.width + 2 * OPENING + 0.014, 0.12), this.width + 0.02);
    const size = this.side === 1 ? [0.042, across] : [across, 0.042];
    this.add(block(size[0], size[1], palm, 0.007), "tool-solid", new THREE.Vector3(0, 0, start + palm / 2));
    this.add(block(size[0] + 0.002, size[1] + 0.002, 0.007, 0.002), `${this.arm}-arm`, new THREE.Vector3(0, 0, start + 0.3 * palm));
    const tip = isWide ? this.top : this.depth;
    const length = tip - (start + palm);
    if (isWide) {
      const cup = Math.min(0.022, 0.3 * this.width);
      this.add(turned([[0.008, -length], [0.008, -0.5 * length], [0.6 * cup, -0.4 * length], [0.55 * cup, -0.3 * length], [cup, -0.004], [cup, 0], [0, 0]]), "flange", new THREE.Vector3(0, 0, tip));
      return;
    }
    for (const sign of [1, -1]) {
      const [thick, broad] = [0.009, 0.022];
      const finger = this.add(block(this.side ? broad : thick, this.side ? thick : broad, length, 0.003), "flange", new THREE.Vector3(0, 0, tip - length / 2));
      finger.userData.sign = sign;
      this.fingers.push(finger);
    }
  }

  /** @param {number} time s */
  setTime(time) {
    const change = this.changes.filter(({ from }) => from <= time).at(-1) ?? this.changes[0];
    const [open, held] = [this.width + OPENING, change?.width || this.width];
    const gap = (open + closedAt(this.changes, time) * (held - open)) / 2 + 0.0045;
    for (const finger of this.fingers) finger.position.setComponent(this.side, finger.userData.sign * gap);
  }
}
