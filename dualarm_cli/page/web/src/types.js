// Types of the page's data (format dualarm.page/1). SI units; quaternions are x, y, z, w.

/** @typedef {[number, number, number]} Vector */
/** @typedef {[number, number, number, number]} Quaternion */
/** @typedef {{xyz: Vector, quat: Quaternion}} Pose */

/**
 * @typedef {object} Knots Knots of a joint's motion, with constant jerk in between.
 * @property {Float64Array} time s
 * @property {Float64Array} position rad or m
 * @property {Float64Array} velocity per s
 * @property {Float64Array} acceleration per s²
 */

/**
 * @typedef {object} Limits Limits of a joint; null if it has none.
 * @property {number | null} lower
 * @property {number | null} upper
 * @property {number | null} velocity
 * @property {number | null} acceleration
 * @property {number | null} jerk
 * @property {string} source datasheet, measured, urdf or assumed
 */

/** @typedef {{name: string, group: string, slides: boolean, limits: Limits, knots: Knots}} Joint */

/**
 * @typedef {object} BodyData Body that moves with a joint; parents come first.
 * @property {string} name
 * @property {number} parent index of the parent, -1 for the world
 * @property {number} joint index of the joint, -1 if fixed
 * @property {Vector} axis
 * @property {boolean} slides
 */
/** @typedef {BodyData & Pose} Body */

/**
 * @typedef {object} SolidData
 * @property {number} [body] index of the body that carries it, -1 for the world
 * @property {string} [name]
 * @property {"link" | "tool" | "obstacle"} [role]
 * @property {string} [arm]
 * @property {"box" | "sphere" | "cylinder" | "capsule" | "mesh" | "half_space"} kind
 * @property {number[]} size box: full sides; sphere: radius; cylinder and capsule: radius, length [m]
 * @property {number | null} hull
 */
/** @typedef {SolidData & Pose} Solid */

/** @typedef {{corners: Float32Array, triangles: Uint32Array}} Hull */

/** @typedef {{time: number, body: number | null, velocity: Vector} & Pose} Keyframe */
/** @typedef {{name: string, role: "part" | "tool", solids: Solid[], keyframes: Keyframe[]}} CarriedObject */
/** @typedef {{name: string, length: number, width: number, velocity: Vector} & Pose} Conveyor */

/**
 * @typedef {object} Segment
 * @property {string} arm
 * @property {string} kind transfer, approach, dwell, retract, wait, return, path or seam
 * @property {string} task
 * @property {string} action
 * @property {number} start s
 * @property {number} end s
 * @property {string} [reason] reason of a wait
 */

/** @typedef {{time: number, arm: string, task: string, action: string, xyz: Vector, dwell: number, signal?: string, width?: number}} Event */

/**
 * @typedef {object} Stage
 * @property {number} start
 * @property {number} end
 * @property {string[]} tasks
 * @property {string} bottleneck
 * @property {string} [arm] missing if the stage is of both arms
 */

/**
 * @typedef {object} Piece Motion, dwell or wait with its slack.
 * @property {number} segment index of its segment, -1 for the platform
 * @property {number} stage index of its stage
 * @property {number} length time by itself, without waiting for others [s]
 * @property {number} slack delay that does not make the cycle longer [s]
 */

/**
 * @typedef {object} Lever Change of a file; null for what is not known.
 * @property {string} name
 * @property {string} change old and new value, or the difference
 * @property {number | null} estimate gain [s]
 * @property {number | null} gain of a new plan, verified [s]
 * @property {string} status of the new plan; empty without one
 * @property {{share: number, change: string, estimate: number}[]} [stops] parts of the change, of sliders
 * @property {number[]} [excludes] indices of sliders that change the same values
 */
/** @typedef {{levers: Lever[], combinations: {levers: number[], gain: number | null}[], sentences: string[]}} Levers */

/**
 * @typedef {object} Clearance Samples of the smallest distance of a group of pairs.
 * @property {string} name "clearance", or "near links" for links with few joints in between
 * @property {Float64Array} time
 * @property {Float32Array} distance m
 * @property {Uint32Array} pair index of the pair
 * @property {Float32Array} points nearest points in the world, six numbers per sample
 * @property {[string, string][]} pairs
 * @property {number[]} required required clearance of each pair [m]
 */

/**
 * @typedef {object} Torques Samples of the torques of all joints.
 * @property {Float64Array} time s; two samples at one time where a torque jumps
 * @property {Float32Array[]} values by joint [N m, or N where it slides]
 * @property {number[]} efforts largest torque of each joint
 */

/**
 * @typedef {object} Plan Data of the page.
 * @property {string} title
 * @property {string} robot
 * @property {string} version
 * @property {number} duration s
 * @property {boolean} closes
 * @property {Joint[]} joints
 * @property {Body[]} bodies
 * @property {Solid[]} solids
 * @property {Solid[]} visuals how links look, where their files show it
 * @property {Hull[]} hulls
 * @property {Object<string, {body: number, hand?: boolean} & Pose>} tcps hand: the tool is the robot's own hand
 * @property {Object<string, Pose>} flanges in the bodies of the tool centre points
 * @property {string[]} [tools] a sentence for each tool, with its reason
 * @property {Object<string, Pose>} frames of the cell, in the world
 * @property {CarriedObject[]} objects
 * @property {Conveyor[]} conveyors
 * @property {Segment[]} segments
 * @property {Event[]} events
 * @property {Stage[]} stages
 * @property {Piece[]} pieces
 * @property {Levers | null} [levers] what `dualarm why` found
 * @property {Clearance[]} clearances of none, one or both groups
 * @property {Torques | null} torques null where the robot has no efforts or masses
 * @property {any} report report.json as it is
 */

export {};
