// Layout of the Gantt chart: rows, bars and the tasks above them, without drawing.

import { armsOf } from "./data.js";
import { movingIntervals } from "./trajectory.js";
import { actionOn, fixed, waitText, word } from "./units.js";
import { isCritical, whyText } from "./why.js";

/** @typedef {import("./types.js").Plan} Plan */
/** @typedef {import("./types.js").Segment} Segment */

/**
 * @typedef {object} Bar
 * @property {number} start s
 * @property {number} end s
 * @property {string} kind that of its segment; "move" for the platform
 * @property {string} family colour: pick, place, give, take, tool, path, seam, or empty for none
 * @property {string} label shown if it fits
 * @property {string} text full description
 * @property {boolean} [critical] whether its delay makes the cycle longer
 * @property {() => string} [why] describes why it takes as long as it does; missing without slack
 */

/** @typedef {{start: number, end: number, task: string, action: string, family: string}} Visit */
/** @typedef {{name: string, arm: string, bars: Bar[], visits: Visit[]}} GanttRow */

const FAMILIES = /** @type {Object<string, string>} */ ({
  pick: "pick",
  place: "place",
  give: "give",
  take: "take",
  take_tool: "tool",
  leave_tool: "tool",
});

/** Kinds of segments that name their action. */
const ALONG = ["path", "seam"];

/**
 * Return the family of a segment or an event, which selects its colour.
 * @param {string} action
 * @param {string} kind
 */
export function familyOf(action, kind = "") {
  if (kind === "seam" || action.startsWith("seam")) return "seam";
  if (kind === "path" || action.startsWith("path")) return "path";
  return FAMILIES[action] ?? "move";
}

/**
 * Describe what an arm does in a segment.
 * @param {Plan} plan
 * @param {Segment} segment
 */
export function workText(plan, segment) {
  const { arm, kind, task, action, reason = "" } = segment;
  if (kind === "wait") return waitText(reason, waitsFor(plan, segment));
  if (kind === "seam") {
    const isMaster = plan.report.seams?.some((/** @type {any} */ row) => row.task === task && row.master === arm);
    return `${isMaster ? "holds the part of" : "follows"} ${task === "seam" ? "the seam" : actionOn("seam", task)}`;
  }
  if (kind === "path") return `follows ${task === "path" ? "the path" : actionOn("path", task)}`;
  if (!task) return word(kind);
  const signal = signalOf(plan, segment);
  return `${actionOn(action, task)}: ${word(kind)}${signal && ` → ${signal}`}`;
}

/** Describe a segment with its arm and times. @param {Plan} plan @param {Segment} segment */
export function segmentText(plan, segment) {
  const { arm, start, end } = segment;
  return `${arm}: ${workText(plan, segment)}, ${fixed(start, 3)}–${fixed(end, 3)} s (${fixed(end - start, 3)} s)`;
}

/**
 * Build the rows: one per arm, and one for the platform if it moves.
 * @param {Plan} plan
 * @returns {GanttRow[]}
 */
export function ganttRows(plan) {
  const pieces = new Map((plan.pieces ?? []).map((piece) => [piece.segment < 0 ? `stage ${piece.stage}` : piece.segment, piece]));
  const reasons = (/** @type {string | number} */ key, /** @type {string} */ group, /** @type {{start: number, end: number, kind: string}} */ bar) => {
    const piece = pieces.get(key);
    return piece ? { critical: isCritical(piece), why: () => whyText(plan, piece, group, bar) } : {};
  };
  const rows = armsOf(plan).map((arm) => {
    const segments = plan.segments
      .filter((segment) => segment.arm === arm)
      .sort((a, b) => a.start - b.start);
    const bars = segments.map((segment) => ({
      start: segment.start,
      end: segment.end,
      kind: segment.kind,
      family: segment.kind === "wait" ? "" : familyOf(segment.action, segment.kind),
      label: segment.kind === "wait" ? word(segment.reason ?? "wait") : "",
      text: segmentText(plan, segment),
      ...reasons(plan.segments.indexOf(segment), arm, segment),
    }));
    return { name: arm, arm, bars, visits: visits(segments) };
  });
  const platform = plan.joints.filter((joint) => joint.group === "platform");
  const moves = platform
    .flatMap((joint) => movingIntervals(joint.knots).map((move) => ({ ...move, name: joint.name })))
    .sort((a, b) => a.start - b.start);
  if (moves.length > 0) {
    const bars = moves.map(({ start, end, name }) => ({
      start,
      end,
      kind: "move",
      family: "",
      label: "",
      text: `platform: ${name} moves, ${fixed(start, 3)}–${fixed(end, 3)} s (${fixed(end - start, 3)} s)`,
      ...reasons(`stage ${plan.stages?.findIndex((stage) => stage.start <= start + 1e-6 && start < stage.end - 1e-6)}`, "platform", { start, end, kind: "move" }),
    }));
    rows.push({ name: "platform", arm: "", bars, visits: [] });
  }
  return rows;
}

/**
 * Return the arm and task that an arm waits for, as in the report.
 * @param {Plan} plan
 * @param {Segment} segment
 */
function waitsFor(plan, segment) {
  if (segment.kind !== "wait") return "";
  const wait = (plan.report.waits ?? []).find(
    (/** @type {any} */ w) => w.arm === segment.arm && Math.abs(w.start - segment.start) < 1e-6,
  );
  if (!wait || !wait.for) return "";
  return [wait.for.arm && `the ${wait.for.arm} arm`, wait.for.task].filter(Boolean).join(", ");
}

/**
 * Return the signal set at the start of a dwell, or an empty text.
 * @param {Plan} plan
 * @param {Segment} segment
 */
function signalOf(plan, { kind, arm, task, action }) {
  if (kind !== "dwell") return "";
  const dwellEvent = plan.events.find((event) => event.arm === arm && event.task === task && event.action === action);
  return dwellEvent?.signal ?? "";
}

/**
 * Group the segments of an arm into visits: consecutive segments of one task and action, without waits at their ends.
 *
 * Paths and seams are visits of their own.
 * @param {Segment[]} segments of one arm, in order of time
 * @returns {Visit[]}
 */
export function visits(segments) {
  /** @type {Visit[]} */
  const grouped = [];
  for (const { task, kind, start, end, ...segment } of segments) {
    if (!task || kind === "wait") continue;
    const action = ALONG.includes(kind) ? kind : segment.action;
    const last = grouped.at(-1);
    if (last && last.task === task && last.action === action) last.end = end;
    else grouped.push({ start, end, task, action, family: familyOf(action, kind) });
  }
  return grouped;
}

/**
 * Return the bar at a time, or undefined.
 * @param {Bar[]} bars
 * @param {number} time
 * @param {number} tolerance s
 * @returns {Bar | undefined}
 */
export function barAt(bars, time, tolerance = 0) {
  return (
    bars.find((bar) => bar.start <= time && time <= bar.end) ??
    bars.find((bar) => bar.start - tolerance <= time && time <= bar.end + tolerance)
  );
}

/**
 * Return the segment of each arm at a time.
 * @param {Plan} plan
 * @param {number} time
 * @returns {Object<string, Segment | undefined>}
 */
export function segmentsAt(plan, time) {
  const current = /** @type {Object<string, Segment | undefined>} */ ({});
  for (const arm of armsOf(plan)) {
    for (const segment of plan.segments) {
      if (segment.arm === arm && segment.start <= time && time <= segment.end) current[arm] = segment;
    }
  }
  return current;
}
