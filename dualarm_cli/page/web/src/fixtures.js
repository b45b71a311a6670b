// Drawn surroundings that a cell file does not have: trays and cartons, legs of tables, foot plates, the part of a seam.

import * as THREE from "three";
import { block, drum, ribbon } from "./outlines.js";
import { IDENTITY, WORLD, compose, forwardKinematics, inverse, rotate } from "./poses.js";
import { geometryOf, place } from "./shapes.js";
import { positionsAt } from "./trajectory.js";

/** @typedef {import("./types.js").Plan} Plan */
/** @typedef {import("./types.js").Pose} Pose */
/** @typedef {import("./shapes.js").Materials} Materials */

/** Half the side of a part without a shape [m]. */
const HALF = 0.015;
/** Room around the parts of a tray, thickness of its plate and walls, and least height of its rim [m]. */
const AROUND = 0.022;
const PLATE = 0.006;
const RIM = 0.01;
/** Largest distance of a part from the frame of its tray, and from another part where there is no frame [m]. */
const FAR = 0.5;
const BESIDE = 0.12;
/** Smallest area of a board with legs [m²], its largest thickness and its least height above the floor [m]. */
const BOARD = 0.15;
const THICK = 0.12;
const RAISED = 0.25;
/** Gap up to which links of the base stand on each other, and difference in height of those that share a floor [m]. */
const JOINED = 0.02;
const LEVEL = 0.01;
/** Cosine of the tilt up to which a base counts as standing or hanging; length of the column of a hanging base [m]. */
const VERTICAL = 0.97;
const HANGER = 0.18;

/**
 * Compute the bounds of parts in a frame.
 * @param {import("./types.js").CarriedObject} object
 * @param {Pose} pose of the object in that frame
 * @param {Plan} plan
 */
function boundsIn(object, pose, plan) {
  const box = new THREE.Box3();
  if (object.solids.length === 0) {
    const half = new THREE.Vector3(HALF, HALF, HALF);
    return box.setFromCenterAndSize(new THREE.Vector3(...pose.xyz), half.multiplyScalar(2));
  }
  for (const solid of object.solids) {
    const { xyz, quat } = compose(pose, solid);
    const geometry = geometryOf(solid, plan.hulls).applyQuaternion(new THREE.Quaternion(...quat)).translate(...xyz);
    geometry.computeBoundingBox();
    box.union(/** @type {THREE.Box3} */ (geometry.boundingBox));
  }
  return box;
}

/**
 * Find the parts that wait or lie at each frame, or at a place of their own, as bounds in the frame.
 * @param {Plan} plan
 * @returns {{name: string, frame: Pose, boxes: THREE.Box3[], isFilled: boolean}[]} isFilled: parts are placed there
 */
export function loads(plan) {
  const frames = Object.entries(plan.frames).map(([name, frame]) => ({ name, frame, boxes: /** @type {THREE.Box3[]} */ ([]), isFilled: false, far: FAR }));
  for (const object of plan.objects.filter(({ role }) => role === "part")) {
    object.keyframes.forEach((keyframe, i) => {
      if (keyframe.body !== WORLD || Math.hypot(...keyframe.velocity) > 0) return;
      const distance = (/** @type {{frame: Pose}} */ { frame }) => Math.hypot(...frame.xyz.map((x, k) => x - keyframe.xyz[k]));
      const [nearest] = [...frames].sort((a, b) => distance(a) - distance(b));
      const isNear = nearest && distance(nearest) < nearest.far;
      const load = isNear ? nearest : { name: `place of ${object.name}`, frame: { ...IDENTITY, xyz: keyframe.xyz }, boxes: [], isFilled: false, far: BESIDE };
      if (!isNear) frames.push(load);
      load.boxes.push(boundsIn(object, compose(inverse(load.frame), keyframe), plan));
      if (i > 0) load.isFilled = true;
    });
  }
  return frames.filter(({ frame, boxes }) => boxes.length > 0 && 1 - 2 * (frame.quat[0] ** 2 + frame.quat[1] ** 2) > 0.98);
}

/**
 * Compute the bounds of a solid of a body with a given pose.
 * @param {import("./types.js").Solid} solid
 * @param {Pose} pose
 * @param {Plan} plan
 */
function placedBox(solid, pose, plan) {
  const mesh = new THREE.Mesh(geometryOf(solid, plan.hulls));
  place(mesh, compose(pose, solid));
  mesh.updateMatrixWorld(true);
  return new THREE.Box3().setFromObject(mesh, true);
}

/** Drawings around the robot. */
export class Fixtures {
  /**
   * @param {Plan} plan
   * @param {Materials} materials
   */
  constructor(plan, materials) {
    this.plan = plan;
    this.materials = materials;
    this.group = new THREE.Group();
    /** Obstacles as bounds in the world. */
    this.obstacles = plan.solids.filter((solid) => solid.role === "obstacle" && solid.kind !== "half_space").map((solid) => {
      const mesh = new THREE.Mesh(geometryOf(solid, plan.hulls));
      place(mesh, solid);
      mesh.updateMatrixWorld(true);
      return { solid, box: new THREE.Box3().setFromObject(mesh, true) };
    });
    const root = plan.bodies[0];
    this.feet = plan.solids.filter((solid) => solid.role === "link" && solid.body === 0).map((solid) => {
      const mesh = new THREE.Mesh(geometryOf(solid, plan.hulls));
      place(mesh, compose(root, solid));
      mesh.updateMatrixWorld(true);
      return { mesh, box: new THREE.Box3().setFromObject(mesh, true), up: new THREE.Vector3(0, 0, 1) };
    });
    orient(this.feet, plan);
    const lowest = [...this.obstacles.map(({ box }) => box.min.z), ...this.feet.map(({ box }) => box.min.z)];
    /** Height of the floor [m]: the lowest body, but not above zero. */
    this.floor = Math.min(0, ...lowest);
    for (const load of loads(plan)) this.drawTray(load);
    for (const obstacle of this.obstacles) this.drawLegs(obstacle);
    this.drawFeet();
  }

  /**
   * @param {THREE.BufferGeometry} geometry
   * @param {string} colour
   * @param {string} name
   * @param {[number, number, number]} at
   * @param {THREE.Object3D} [parent]
   */
  add(geometry, colour, name, at, parent = this.group) {
    const mesh = new THREE.Mesh(geometry, this.materials.solid(colour));
    mesh.position.set(...at);
    mesh.name = `${name}: drawn, not checked`;
    parent.add(mesh);
  }

  /** Draw a tray, or a carton where parts are placed, and what it stands on. @param {ReturnType<typeof loads>[number]} load */
  drawTray({ name, frame, boxes, isFilled }) {
    const all = boxes.reduce((union, box) => union.union(box), new THREE.Box3());
    const { min, max } = all;
    const tray = new THREE.Group();
    place(tray, frame);
    tray.updateMatrixWorld(true);
    const footprint = all.clone().expandByVector(new THREE.Vector3(AROUND, AROUND, 0)).applyMatrix4(tray.matrixWorld);
    const overlapping = this.obstacles.filter(({ box }) => box.max.x > footprint.min.x && box.min.x < footprint.max.x && box.max.y > footprint.min.y && box.min.y < footprint.max.y);
    const below = overlapping.filter(({ box }) => box.max.z <= footprint.min.z + 0.002).map(({ box }) => box.max.z);
    const gap = footprint.min.z - Math.max(this.floor, ...below);
    // A cell with a modelled bin, or whose parts lie on an obstacle, needs no tray.
    const isModelled = overlapping.some(({ box }) => box.max.z > footprint.min.z + 0.002 && box.min.z < footprint.max.z);
    if (isModelled || gap < PLATE) return;
    const [x, y] = [(min.x + max.x) / 2, (min.y + max.y) / 2];
    const [wide, deep] = [max.x - min.x + 2 * AROUND, max.y - min.y + 2 * AROUND];
    const colour = isFilled ? "carton" : "tray";
    const rim = isFilled ? Math.max(0.85 * (max.z - min.z), RIM) : Math.max(0.35 * (max.z - min.z), RIM);
    this.add(block(wide, deep, PLATE, 0.002), colour, name, [x, y, min.z - PLATE / 2], tray);
    const tall = rim + PLATE;
    const middle = min.z - PLATE + tall / 2;
    for (const side of [-1, 1]) {
      this.add(block(wide, PLATE, tall, 0.002), colour, name, [x, y + (side * (deep - PLATE)) / 2, middle], tray);
      this.add(block(PLATE, deep, tall, 0.002), colour, name, [x + (side * (wide - PLATE)) / 2, y, middle], tray);
    }
    const stand = gap - PLATE;
    const top = min.z - PLATE;
    const label = `stand of ${name}`;
    if (stand > RAISED) {
      this.add(drum(0.03, stand), "frame", label, [x, y, top - stand / 2], tray);
      this.add(drum(Math.min(0.16, 0.5 * Math.max(wide, deep)), 0.02), "frame", label, [x, y, top - stand + 0.01], tray);
    } else if (stand > 0.002) {
      this.add(block(0.86 * wide, 0.86 * deep, stand, 0.004), "frame", label, [x, y, top - stand / 2], tray);
    }
    this.group.add(tray);
  }

  /** Draw the legs of a board in the air. @param {{solid: import("./types.js").Solid, box: THREE.Box3}} obstacle */
  drawLegs({ solid, box }) {
    const [wide, deep, thick] = solid.size;
    const height = box.min.z - this.floor;
    const isFlat = 1 - 2 * (solid.quat[0] ** 2 + solid.quat[1] ** 2) > 0.999;
    if (solid.kind !== "box" || !isFlat || wide * deep < BOARD || thick > THICK || height < RAISED) return;
    const legs = new THREE.Group();
    place(legs, solid);
    const side = 0.05;
    for (const x of [-1, 1]) {
      for (const y of [-1, 1]) {
        const at = /** @type {[number, number, number]} */ ([x * (wide / 2 - side), y * (deep / 2 - side), -thick / 2 - height / 2]);
        this.add(block(side, side, height, 0.006), "frame", `leg of ${solid.name}`, at, legs);
      }
      this.add(block(0.03, deep - 2 * side, 0.05, 0.004), "frame", `leg of ${solid.name}`, [x * (wide / 2 - side), 0, -thick / 2 - 0.03], legs);
      this.add(block(wide - 2 * side, 0.03, 0.05, 0.004), "frame", `leg of ${solid.name}`, [0, x * (deep / 2 - side), -thick / 2 - 0.03], legs);
    }
    this.group.add(legs);
  }

  /** Draw a foot plate and a column below each base that stands, a mount above those that hang, a plate behind tilted ones. */
  drawFeet() {
    const hanging = [];
    for (const foot of this.feet) {
      const { mesh, box, up } = foot;
      const size = box.getSize(new THREE.Vector3());
      const centre = box.getCenter(new THREE.Vector3());
      if (up.z < VERTICAL) {
        this.drawBack(mesh, centre, up);
        if (up.z < -VERTICAL) hanging.push({ centre, top: box.max.z, wide: 0.6 * Math.min(size.x, size.y) });
        continue;
      }
      // Legs and pedestals of the robot itself carry what is joined to them.
      const { lowest, count } = standing(foot, this.feet);
      if (box.min.z > lowest + LEVEL || this.feet.some((other) => other.box.min.z < box.min.z - LEVEL && other.box.containsPoint(centre.clone().setZ(other.box.min.z)))) continue;
      const height = box.min.z - this.floor;
      if (height <= LEVEL && count > 1) continue;
      if (height > LEVEL) this.add(block(0.8 * size.x, 0.8 * size.y, height, 0.01), "frame", "pedestal", [centre.x, centre.y, this.floor + height / 2]);
      this.add(block(1.3 * size.x, 1.3 * size.y, 0.014, 0.005), "frame", "foot plate", [centre.x, centre.y, this.floor + 0.007]);
    }
    if (hanging.length === 0) return;
    const beam = Math.max(...hanging.map(({ top }) => top)) + HANGER;
    const across = new THREE.Box3();
    for (const { centre, top, wide } of hanging) {
      this.add(block(wide, wide, beam - top, 0.01), "frame", "mount from above", [centre.x, centre.y, (beam + top) / 2]);
      across.expandByPoint(new THREE.Vector3(centre.x - wide, centre.y - wide, beam)).expandByPoint(new THREE.Vector3(centre.x + wide, centre.y + wide, beam));
    }
    const size = across.getSize(new THREE.Vector3());
    const { x, y } = across.getCenter(new THREE.Vector3());
    this.add(block(size.x, size.y, 0.06, 0.01), "frame", "beam above", [x, y, beam + 0.03]);
  }

  /**
   * Draw the plate behind a base that hangs or is tilted; it leads nowhere, because the file does not say to what.
   * @param {THREE.Mesh} mesh
   * @param {THREE.Vector3} centre
   * @param {THREE.Vector3} up direction from the plate into the arm
   */
  drawBack(mesh, centre, up) {
    const points = mesh.geometry.getAttribute("position");
    const corner = new THREE.Vector3();
    let [back, wide] = [0, 0];
    for (let i = 0; i < points.count; i++) {
      corner.fromBufferAttribute(points, i).applyMatrix4(mesh.matrixWorld).sub(centre);
      const height = corner.dot(up);
      back = Math.min(back, height);
      wide = Math.max(wide, corner.addScaledVector(up, -height).length());
    }
    const plate = new THREE.Group();
    plate.position.copy(centre).addScaledVector(up, back - 0.007);
    plate.quaternion.setFromUnitVectors(new THREE.Vector3(0, 0, 1), up);
    this.add(block(2 * wide, 2 * wide, 0.014, 0.005), "frame", "mounting plate", [0, 0, 0], plate);
    this.group.add(plate);
  }
}

/**
 * Find on what a link of the base stands: the lowest height of the links joined to it [m], and how many of them reach it.
 * @param {{box: THREE.Box3}} foot
 * @param {{box: THREE.Box3}[]} feet all links of the base
 */
function standing(foot, feet) {
  const joined = new Set([foot]);
  for (const { box } of joined) {
    const around = box.clone().expandByScalar(JOINED);
    for (const other of feet) if (around.intersectsBox(other.box)) joined.add(other);
  }
  const heights = [...joined].map(({ box }) => box.min.z);
  const lowest = Math.min(...heights);
  return { lowest, count: heights.filter((height) => height <= lowest + LEVEL).length };
}

/**
 * Find which way bases face: along the axis of their first joint. A base of several joints, as a torso, stands.
 * @param {{box: THREE.Box3, up: THREE.Vector3}[]} feet their directions are changed
 * @param {Plan} plan
 */
function orient(feet, plan) {
  const first = plan.bodies.filter(({ parent, slides }) => parent === 0 && !slides);
  const joints = first.map((body) => {
    const pose = compose(plan.bodies[0], body);
    // The origin of a joint may be anywhere on its axis; its link shows the side.
    const link = new THREE.Box3();
    for (const solid of plan.solids) if (solid.role === "link" && plan.bodies[solid.body] === body) link.union(placedBox(solid, pose, plan));
    const at = link.isEmpty() ? new THREE.Vector3(...pose.xyz) : link.getCenter(new THREE.Vector3());
    const distances = feet.map(({ box }) => box.getCenter(new THREE.Vector3()).distanceTo(at));
    return { at, axis: new THREE.Vector3(...rotate(pose.quat, body.axis)), foot: feet[distances.indexOf(Math.min(...distances))] };
  });
  for (const foot of feet) {
    const carried = joints.filter((joint) => joint.foot === foot);
    if (carried.length !== 1) continue;
    const [{ at, axis }] = carried;
    const towards = at.sub(foot.box.getCenter(new THREE.Vector3()));
    const along = towards.dot(axis);
    // The axis of a shoulder that lies across its base says nothing about the mount.
    if (Math.abs(along) > 0.7 * towards.length() && towards.length() > 0.02) foot.up.copy(axis).multiplyScalar(Math.sign(along));
  }
}

/** Samples of a seam. */
const SAMPLES = 60;

/**
 * Draw what the master of each seam holds: a surface from the seam back to its tool.
 * @param {Plan} plan
 * @param {Materials} materials
 * @returns {{body: number, mesh: THREE.Mesh}[]}
 */
export function seamParts(plan, materials) {
  return (plan.report.seams ?? []).flatMap((/** @type {any} */ seam) => {
    const segment = plan.segments.find(({ kind, task }) => kind === "seam" && task === seam.task);
    const [master, slave] = [plan.tcps[seam.master], plan.tcps[seam.slave]];
    if (!segment || !master || !slave) return [];
    const curve = Array.from({ length: SAMPLES + 1 }, (_, i) => {
      const time = segment.start + ((segment.end - segment.start) * i) / SAMPLES;
      const poses = forwardKinematics(plan.bodies, positionsAt(plan.joints, time));
      return new THREE.Vector3(...compose(inverse(poses[master.body]), compose(poses[slave.body], slave)).xyz);
    });
    const middle = curve.reduce((sum, point) => sum.add(point), new THREE.Vector3()).divideScalar(curve.length);
    const back = new THREE.Vector3(...master.xyz).sub(middle);
    const mesh = new THREE.Mesh(ribbon(curve, curve.map((point) => point.clone().add(back))), materials.solid("part"));
    mesh.name = `part of ${seam.task}: drawn, not checked`;
    return [{ body: master.body, mesh }];
  });
}
