// Parts and changed tools in the 3-D view: objects of the same shape are instances of one mesh.

import * as THREE from "three";
import { compose, objectPose } from "./poses.js";
import { block } from "./outlines.js";
import { geometryOf } from "./shapes.js";

/** @typedef {import("./types.js").Plan} Plan */
/** @typedef {import("./types.js").Pose} Pose */
/** @typedef {import("./types.js").Solid} Solid */
/** @typedef {import("./types.js").CarriedObject} CarriedObject */

/** Side of the cube that replaces an unknown shape [m]. */
const SIDE = 0.03;

/** @type {Solid} */
const UNKNOWN = { kind: "box", size: [SIDE, SIDE, SIDE], hull: null, xyz: [0, 0, 0], quat: [0, 0, 0, 1] };

/** Create the geometry of an object's solid; boxes have rounded edges. @param {Solid} solid @param {import("./types.js").Hull[]} hulls */
function outlineOf(solid, hulls) {
  return solid.kind === "box" ? block(solid.size[0], solid.size[1], solid.size[2], 0.006) : geometryOf(solid, hulls);
}

const HIDDEN = new THREE.Matrix4().makeScale(0, 0, 0);
const ONE = new THREE.Vector3(1, 1, 1);

/** Carried objects of a plan. */
export class CarriedObjects {
  /**
   * @param {Plan} plan
   * @param {import("./shapes.js").Materials} materials
   */
  constructor(plan, materials) {
    /** @type {Map<string, {solid: Solid, role: string, objects: CarriedObject[]}>} */
    const byShape = new Map();
    for (const object of plan.objects) {
      for (const solid of object.solids.length > 0 ? object.solids : [UNKNOWN]) {
        const key = JSON.stringify([object.role, solid]);
        const entry = byShape.get(key) ?? { solid, role: object.role, objects: [] };
        entry.objects.push(object);
        byShape.set(key, entry);
      }
    }
    this.kinds = [...byShape.values()].map(({ solid, role, objects }) => {
      const material = materials.solid(role === "part" ? "part" : "tool-solid");
      const mesh = new THREE.InstancedMesh(outlineOf(solid, plan.hulls), material, objects.length);
      mesh.frustumCulled = false;
      return { solid, objects, mesh };
    });
    this.meshes = this.kinds.map(({ mesh }) => mesh);
  }

  /**
   * @param {number} time s
   * @param {Pose[]} poses of the bodies
   */
  setTime(time, poses) {
    const [matrix, position, turn] = [new THREE.Matrix4(), new THREE.Vector3(), new THREE.Quaternion()];
    for (const { solid, objects, mesh } of this.kinds) {
      objects.forEach((object, i) => {
        const pose = objectPose(object, time, poses);
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
   * Return the name of the object that a ray hits.
   * @param {THREE.Intersection} hit
   * @returns {string}
   */
  nameOf(hit) {
    const kind = this.kinds.find(({ mesh }) => mesh === hit.object);
    return kind && hit.instanceId !== undefined ? kind.objects[hit.instanceId].name : "";
  }

  /** @returns {THREE.Vector3[]} positions of the objects */
  positions() {
    const matrix = new THREE.Matrix4();
    return this.kinds.flatMap(({ objects, mesh }) =>
      objects.flatMap((_, i) => {
        mesh.getMatrixAt(i, matrix);
        return matrix.determinant() === 0 ? [] : [new THREE.Vector3().setFromMatrixPosition(matrix)];
      }),
    );
  }
}
