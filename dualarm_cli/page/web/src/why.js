// Why pieces and stages take as long as they do: what decides the cycle, what limits a piece, its slack.

import { jointLabel } from "./labels.js";
import { countUpTo, stateAt } from "./trajectory.js";
import { percent, seconds, word } from "./units.js";

/** @typedef {import("./types.js").Plan} Plan */
/** @typedef {import("./types.js").Piece} Piece */

/** Slack up to which a piece decides the cycle time [s]. */
const CRITICAL = 1e-6;
/** Fraction of a limit from which a joint is at it. */
const AT_LIMIT = 0.98;
/** Least fraction of a motion at a limit for which the joint is named. */
const LEAST_SHARE = 0.2;
/** Motions, which joints limit. */
const MOTIONS = ["transfer", "approach", "retract", "return", "path", "seam"];

/** Return whether a delay of a piece makes the cycle longer. @param {Piece} piece */
export const isCritical = (piece) => piece.slack <= CRITICAL;

/**
 * Find the joint that is at one of its limits longest within a motion.
 * @param {Plan} plan
 * @param {string} group arm, or platform
 * @param {number} start s
 * @param {number} end s
 * @returns {{joint: string, limit: string, share: number} | null} null without joints or limits; share: of the time
 */
export function limitOf(plan, group, start, end) {
  const pace = plan.report.speed ?? 1;
  let most = null;
  for (const { name, knots, limits } of plan.joints.filter((joint) => joint.group === group)) {
    const times = [start, ...knots.time.slice(countUpTo(knots.time, start), countUpTo(knots.time, end, true)), end];
    const spent = { velocity: 0, acceleration: 0, jerk: 0 };
    for (let k = 1; k < times.length; k++) {
      const state = stateAt(knots, (times[k - 1] + times[k]) / 2);
      const at = /** @type {const} */ (["velocity", "acceleration", "jerk"]).find((limit, i) => {
        const most = limits[limit];
        return most !== null && Math.abs(state[limit]) >= AT_LIMIT * most * pace ** (i + 1);
      });
      if (at) spent[at] += times[k] - times[k - 1];
    }
    const share = Object.values(spent).reduce((sum, time) => sum + time, 0) / (end - start);
    const [limit] = Object.entries(spent).sort((a, b) => b[1] - a[1])[0];
    if (!most || share > most.share) most = { joint: name, limit, share };
  }
  return most;
}

/** Describe the slack of a piece. @param {Plan} plan @param {Piece} piece */
function slackText(plan, piece) {
  if (isCritical(piece)) return "decides the cycle time";
  return `slack ${plan.report.mode === "free" ? "at most " : ""}${seconds(piece.slack)}`;
}

/**
 * Describe why a piece takes as long as it does.
 * @param {Plan} plan
 * @param {Piece} piece
 * @param {string} group arm, or platform
 * @param {{start: number, end: number, kind: string}} bar
 */
export function whyText(plan, piece, group, { start, end, kind }) {
  const texts = [slackText(plan, piece)];
  if (kind === "dwell") texts.push("its time is in the task file");
  if (piece.length < end - start - CRITICAL) {
    const other = kind === "return" ? "the other arm or the platform" : "the platform";
    texts.push(`${seconds(piece.length)} by itself, slowed to arrive with ${other}`);
  } else if (MOTIONS.includes(kind) || group === "platform") {
    const limit = limitOf(plan, group, start, end);
    const { bottleneck } = plan.stages[piece.stage] ?? {};
    // Limits that a task or a held part lowers are not those of the joints.
    const isBottleneck = kind === "transfer" && plan.joints.some((joint) => joint.name === bottleneck && joint.group === group);
    const care = isBottleneck && plan.report.stages?.[piece.stage]?.care;
    if (bottleneck === "duration" && kind === "transfer") texts.push("its time is in the task file");
    else if (bottleneck === "tool_speed" && kind === "transfer") texts.push("limited by the tool speed");
    else if (care) texts.push(`limited by ${care}`);
    else if (limit && limit.share >= LEAST_SHARE) texts.push(`limited by ${jointLabel(plan.joints, limit.joint)}: at a limit ${percent(limit.share, 0)} of the time, mostly ${limit.limit}`);
    else texts.push("no joint is at a limit for long");
  }
  return texts.join("; ");
}

/**
 * Describe what decides a stage, and the slack of all else.
 * @param {Plan} plan
 * @param {number} number index of the stage
 */
export function stageWhy(plan, number) {
  const { start, end } = plan.stages[number];
  const inside = plan.pieces.filter((piece) => piece.stage === number);
  const groupOf = (/** @type {Piece} */ piece) => plan.segments[piece.segment]?.arm ?? "platform";
  const decided = new Map();
  const slack = new Map();
  for (const piece of inside) {
    const group = groupOf(piece);
    if (isCritical(piece)) decided.set(group, [...(decided.get(group) ?? []), word(plan.segments[piece.segment]?.kind ?? "turn")]);
    else slack.set(group, Math.min(piece.slack, slack.get(group) ?? Infinity));
  }
  const free = plan.report.mode === "free" ? "slack at most" : "slack";
  const texts = [...decided].map(([group, kinds]) => `decided by ${group}: ${[...new Set(kinds)].join(", ")}`);
  for (const [group, time] of slack) if (!decided.has(group)) texts.push(`${group}: ${free} ${seconds(time)}`);
  return [`stage ${number + 1}: ${seconds(end - start)}`, ...texts].join("\n");
}
