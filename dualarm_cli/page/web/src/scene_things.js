// Parts and changed tools in the 3-D view: things of the same shape are instances of one mesh.

import * as THREE from "three";
import { compose, thingPose } from "./poses.js";
import { block } from "./outlines.js";
import { geometryOf } from "./shapes.js";

/** @typedef {import("./types.js").Plan} Plan */
/** @typedef {import("./types.js").Pose} Pose */
/** @typedef {import("./types.js").Solid} Solid */
/** @typedef {import("./types.js").Thing} Thing */

/** Side of the cube that replaces an unknown shape [m]. */
const SIDE = 0.03;

/** @type {Solid} */
const UNKNOWN = { kind: "box", size: [SIDE, SIDE, SIDE], hull: null, xyz: [0, 0, 0], quat: [0, 0, 0, 1] };

/** Create the geometry of a thing's solid; boxes have rounded edges. @param {Solid} solid @param {import("./types.js").Hull[]} hulls */
function outlineOf(solid, hulls) {
  return solid.kind === "box" ? block(solid.size[0], solid.size[1], solid.size[2], 0.006) : geometryOf(solid, hulls);
}

const HIDDEN = new THREE.Matrix4().makeScale(0, 0, 0);
const ONE = new THREE.Vector3(1, 1, 1);

/** Things of a plan. */
export class Things {
  /**
   * @param {Plan} plan
   * @param {import("./shapes.js").Materials} materials
   */
  constructor(plan, materials) {
    /** @type {Map<string, {solid: Solid, role: string, things: Thing[]}>} */
    const byShape = new Map();
    for (const thing of plan.things) {
      for (const solid of thing.solids.length > 0 ? thing.solids : [UNKNOWN]) {
        const key = JSON.stringify([thing.role, solid]);
        const entry = byShape.get(key) ?? { solid, role: thing.role, things: [] };
        entry.things.push(thing);
        byShape.set(key, entry);
      }
    }
    this.kinds = [...byShape.values()].map(({ solid, role, things }) => {
      const material = materials.solid(role === "part" ? "part" : "tool-solid");
      const mesh = new THREE.InstancedMesh(outlineOf(solid, plan.hulls), material, things.length);
      mesh.frustumCulled = false;
      return { solid, things, mesh };
    });
    this.meshes = this.kinds.map(({ mesh }) => mesh);
  }

  /**
   * @param {number} time s
   * @param {Pose[]} poses of the bodies
   */
  setTime(time, poses) {
    const [matrix, position, turn] = [new THREE.Matrix4(), new THREE.Vector3(), new THREE.Quaternion()];
    for (const { solid, things, mesh } of this.kinds) {
      things.forEach((thing, i) => {
        const pose = thingPose(thing, time, poses);
        if (pose) {
          const { xyz, quat } = compose(pose, solid);
          matrix.compose(position.set(...xyz), turn.set(...quat), ONE);
        }
        mesh.setMatrixAt(i, pose ? matrix : HIDDEN);
      });
      mesh.instanceMatrix.needsUpdate = true;
      mesh.boundingSphere = null;
    }
  }

  /**
   * Return the name of the thing that a ray hits.
   * @param {THREE.Intersection} hit
   * @returns {string}
   */
  nameOf(hit) {
    const kind = this.kinds.find(({ mesh }) => mesh === hit.object);
    return kind && hit.instanceId !== undefined ? kind.things[hit.instanceId].name : "";
  }

  /** @returns {THREE.Vector3[]} positions of the things */
  positions() {
    const matrix = new THREE.Matrix4();
    return this.kinds.flatMap(({ things, mesh }) =>
      things.flatMap((_, i) => {
        mesh.getMatrixAt(i, matrix);
        return matrix.determinant() === 0 ? [] : [new THREE.Vector3().setFromMatrixPosition(matrix)];
      }),
    );
  }
}
