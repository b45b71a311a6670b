// Panels of the report: overview with cycle time and bound, stages, waits, joints, checks, notes.

import { jointLabel } from "./labels.js";
import { element, table, withCode } from "./dom.js";
import { actionOn, fixed, millimetres, percent, seconds, significant, word } from "./units.js";

/** @typedef {import("./types.js").Plan} Plan */
/** @typedef {(time: number) => void} Go */

/** Smallest saving or cost that is shown [s]. */
const MIN_SHOWN = 5e-4;

/**
 * Create a section with a title.
 * @param {string} title
 * @param {...(Node | string | null)} children
 */
export const block = (title, ...children) => element("section", { class: "block" }, element("h3", {}, title), ...children);

/** Create a paragraph. @param {string} text */
export const paragraph = (text) => element("p", {}, ...withCode(text));

/** Create a key figure. @param {string} value @param {string} label @param {string} [title] */
const figure = (value, label, title = "") =>
  element("div", { class: "figure", title: title || null }, element("b", {}, value), element("span", {}, label));

/**
 * Create a horizontal bar for a fraction.
 * @param {number} fraction
 * @param {string} [mark] class
 */
function fractionBar(fraction, mark = "") {
  const bar = element("span", { class: `share ${mark}` }, element("i"));
  bar.firstChild.style.width = `${Math.min(Math.max(fraction, 0), 1) * 100}%`;
  return bar;
}

/**
 * Create the overview panel: cycle time, gap to the bound, clearance.
 * @param {Plan} plan
 * @param {Go} go
 */
export function overview(plan, go) {
  const { report } = plan;
  const figures = [figure(seconds(report.cycle_time), report.closes ? "cycle time" : "duration")];
  if (report.parts_per_hour !== null && report.parts > 0) {
    figures.push(figure(fixed(report.parts_per_hour, 0), `parts per hour (${report.parts} per cycle)`));
  }
  if (report.lower_bound !== null) {
    const torque = report.torques ? "; torque limits keep it valid" : "";
    figures.push(figure(seconds(report.lower_bound), `lower bound: no plan of these stages is faster${torque}`, "Proven; see the notes for what it assumes. Limits of torques only make plans slower"));
  }
  const closest = report.smallest_clearance;
  if (closest) {
    const near = report.near_links;
    const further = near && !closest.near ? `; near links ${near.bodies.join(" – ")}: ${millimetres(near.clearance)}` : "";
    const label = `least clearance: ${closest.bodies.join(" – ")} (${millimetres(closest.required)} required)${further}`;
    figures.push(figure(millimetres(closest.clearance), label));
  }
  const remarks = report.collisions ? [sentence(`Collisions: ${report.collisions}`, closest?.time, go)] : [];
  if (report.skew) remarks.push(paragraph(`Late start: ${report.skew}`));
  const cost = report.clearance_cost;
  if (cost > MIN_SHOWN) {
    remarks.push(paragraph(`Clearance costs ${seconds(cost)} compared with the plan without collision checking.`));
  }
  const { text, mark } = verdict(report);
  if (mark === "warn") remarks.unshift(element("p", { class: mark }, ...withCode(`Plan ${text}.`)));
  if (report.bodies) remarks.push(paragraph(report.bodies.text.replace("b", "B")));
  if (report.varying) remarks.push(paragraph(`${report.varying.text}.`));
  const saved = savings(report).map(paragraph);
  return [
    element("div", { class: "figures" }, ...figures),
    ...remarks,
    ...saved,
    ...budget(report),
    arms(report),
    energy(plan),
    bottlenecks(plan),
    block("Settings", paragraph(settingsText(report))),
  ];
}

/**
 * Return the verdict of the verifier and its class: good, warn or bad.
 * @param {any} report
 * @returns {{text: string, mark: "good" | "warn" | "bad"}}
 */
export function verdict(report) {
  if (!report.verification) return { text: "not verified", mark: "bad" };
  const { passed, caveats = [] } = report.verification;
  if (!passed) return { text: "verification failed", mark: "bad" };
  return caveats.length ? { text: `verified, except that ${caveats.join("; ")}`, mark: "warn" } : { text: "verified", mark: "good" };
}

/**
 * Return the sentence on what the plan assumes; empty if nothing.
 * @param {any} report
 */
export function assumed(report) {
  return report.assumed?.length ? `assumed: ${report.assumed.join(", ")}` : "";
}

/**
 * Return the sentence on the time saved by blending, if any.
 * @param {any} report
 */
export function savings(report) {
  const sentences = [];
  const { blending } = report;
  if (blending && blending.gain > MIN_SHOWN) {
    sentences.push(`Blending saves ${seconds(blending.gain)} (${percent(blending.share)}) compared with stops at the outer ends of lines.`);
  }
  return sentences;
}

/** Create a paragraph that leads to a time. @param {string} text @param {number | undefined} time @param {Go} go */
function sentence(text, time, go) {
  const node = paragraph(text);
  if (time !== undefined && time !== null) {
    node.classList.add("leads");
    node.addEventListener("click", () => go(time));
  }
  return node;
}

/** Summarise the settings. @param {any} report */
function settingsText(report) {
  const settings = Object.entries(report.settings).filter(([, value]) => value !== null);
  const texts = settings.map(([name, value]) => `${word(name)} ${value}`);
  const mode = report.mode === "free" ? "asynchronous arms" : "synchronous stages";
  return [mode, `order ${report.order}`, `speed ${percent(report.speed, 0)}`, ...texts].join(", ");
}

/** Create the block of the budget. @param {any} report */
function budget(report) {
  if (!report.budget?.length) return [];
  const rows = report.budget.map((/** @type {any} */ row) => ({
    cells: [row.kept ? "kept" : "missed", row.text ?? row.name],
    mark: row.kept ? "" : "failed",
  }));
  return [block("Budget", table(["", "required"], rows, () => {}))];
}

const TIMES = ["transfer", "approach", "dwell", "retract", "path", "seam", "return", "waiting"];

/** Create the table of the times of the arms. @param {any} report */
function arms(report) {
  const names = Object.keys(report.arms);
  const kinds = TIMES.filter((kind) => names.some((name) => report.arms[name][kind] > 0));
  const rows = kinds.map((kind) => ({
    cells: [word(kind), ...names.map((name) => seconds(report.arms[name][kind], 2))],
  }));
  const drawn = names.some((name) => report.arms[name].drawn_out_for_platform > 0);
  if (drawn) {
    const cells = names.map((name) => seconds(report.arms[name].drawn_out_for_platform, 2));
    rows.push({ cells: ["transfers slowed for the platform", ...cells] });
  }
  rows.push({ cells: ["busy", ...names.map((name) => percent(report.arms[name].utilisation))] });
  return block("Time of the arms", table(["", ...names.map((name) => `${name} #`)], rows, () => {}));
}

/** Create the table of mechanical work, or why there is none. @param {Plan} plan */
function energy({ report }) {
  const check = report.verification?.checks.find((/** @type {any} */ row) => row.name === "torque");
  const unknown = check?.verdict === "not checked" ? paragraph(`Torques are not limited: ${check.detail}.`) : null;
  if (!report.torques) return unknown && block("Torques", unknown);
  const names = Object.keys(report.torques.energy);
  const rows = ["work", "braking", "net"].map((key) => ({
    cells: [key, ...names.map((name) => `${fixed(report.torques.energy[name][key], 1)}\u202fJ`)],
  }));
  const text = "Mechanical work at the joints over the motion: positive work, work taken out in braking and lowering, and the difference. Losses of motors and gears are not included.";
  return block("Energy", unknown, paragraph(text), table(["", ...names.map((name) => `${name} #`)], rows, () => {}));
}

/** Create the table of bottleneck joints. @param {Plan} plan */
function bottlenecks({ report, joints }) {
  const counts = Object.entries(report.bottlenecks);
  if (counts.length === 0) return null;
  const maxCount = Math.max(...counts.map(([, count]) => Number(count)));
  const rows = counts.map(([joint, count]) => ({
    cells: [jointLabel(joints, joint), String(count), fractionBar(Number(count) / maxCount)],
  }));
  return block("Bottlenecks", paragraph("Joints that limit the transfers, and numbers of stages."), table(["joint", "stages #", ""], rows, () => {}));
}

/**
 * Create the panel of stages.
 * @param {Plan} plan
 * @param {Go} go
 */
export function stages(plan, go) {
  const clearances = new Map(
    (plan.report.verification?.clearances ?? []).map((/** @type {any} */ c) => [c.stage, c]),
  );
  const rows = plan.stages.map((stage, i) => ({
    cells: [
      String(i + 1),
      stageText(plan, stage),
      fixed(stage.start, 3),
      fixed(stage.end - stage.start, 3),
      jointLabel(plan.joints, stage.bottleneck) + (plan.report.stages[i]?.care ? ` (${plan.report.stages[i].care})` : ""),
      clearances.has(i) ? fixed(clearances.get(i).clearance * 1e3, 1) : "–",
      ...(plan.report.torques ? [stageTorque(plan, plan.report.stages[i]?.torque)] : []),
    ],
    time: stage.start,
  }));
  const heads = ["#", "tasks", "start [s] #", "duration [s] #", "bottleneck", "clearance [mm] #", ...(plan.report.torques ? ["most torque"] : [])];
  return [table(heads, rows, go)];
}

/** Describe the joint of a stage that is nearest to its effort. @param {Plan} plan @param {any} torque */
function stageTorque(plan, torque) {
  if (!torque) return "–";
  const load = torque.carrying ? `, carrying ${torque.carrying}` : "";
  return `${percent(torque.share, 0)} ${jointLabel(plan.joints, torque.joint)}${load}`;
}

/**
 * Describe the actions of a stage.
 * @param {Plan} plan
 * @param {import("./types.js").Stage} stage
 */
export function stageText(plan, stage) {
  if (stage.tasks.length === 0) return "return";
  const within = plan.events.filter((e) => e.time >= stage.start - 1e-9 && e.time < stage.end);
  /** @type {Map<string, string>} */
  const byAction = new Map();
  for (const task of stage.tasks) {
    const actions = new Set(within.filter((e) => e.task === task).map((e) => e.action));
    const action = [...actions].join(" and ");
    const previous = byAction.get(action);
    byAction.set(action, previous ? `${previous}, ${task}` : actionOn(action, task));
  }
  return [...byAction.values()].join("; ");
}

/**
 * Create the panel of waits with their reasons.
 * @param {Plan} plan
 * @param {Go} go
 */
export function waits(plan, go) {
  const { report } = plan;
  const names = Object.keys(report.arms);
  const reasons = [...new Set(names.flatMap((name) => Object.keys(report.arms[name].waited)))];
  const used = reasons.filter((reason) => names.some((name) => report.arms[name].waited[reason] > 1e-9));
  const totals = used.map((reason) => ({
    cells: [word(reason), ...names.map((name) => seconds(report.arms[name].waited[reason]))],
  }));
  const rows = report.waits.map((/** @type {any} */ wait) => ({
    cells: [
      wait.arm,
      fixed(wait.start, 3),
      fixed(wait.length, 3),
      word(wait.reason),
      [wait.for?.arm, wait.for?.task].filter(Boolean).join(": ") || "–",
      wait.task ?? "–",
    ],
    time: wait.start,
  }));
  if (rows.length === 0) return [paragraph("No arm waits.")];
  return [
    block("By reason", table(["reason", ...names.map((name) => `${name} #`)], totals, go)),
    block("All waits", table(["arm", "start [s] #", "duration [s] #", "reason", "waits for", "before"], rows, go)),
  ];
}

/**
 * Create the panel of joints: limit utilisation and sensitivity of the cycle time.
 * @param {Plan} plan
 * @param {Go} go
 */
export function limits(plan, go) {
  const { report } = plan;
  const used = plan.joints.map((joint) => {
    const fractions = report.limits_used[joint.name] ?? {};
    const cells = ["velocity", "acceleration", "jerk"].map((name) => percent(fractions[name], 0));
    return { cells: [jointLabel(plan.joints, joint.name), ...cells, joint.limits.source] };
  });
  const blocks = [block("Peak use of each limit", table(["joint", "velocity #", "acceleration #", "jerk #", "source"], used, go))];
  if (report.torques) blocks.push(torques(plan, go));
  if (report.sensitivity?.length) {
    const rows = report.sensitivity.map((/** @type {any} */ row) => ({
      cells: [row.joint ? jointLabel(plan.joints, row.joint) : "all joints", row.limit, fixed(row.lower, 3), fixed(row.higher, 3)],
    }));
    const heads = ["joint", "limit", "10 % lower [s] #", "10 % higher [s] #"];
    blocks.push(block("Cycle time with other limits", paragraph("With the same postures; a new plan may be faster."), table(heads, rows, go)));
  }
  const slower = slowed(report);
  if (slower) blocks.push(block("Cycle time with other limits", paragraph(slower)));
  return blocks;
}

/**
 * Return the sentence on assumed limits 10 % lower of asynchronous arms; empty where it does not apply.
 * @param {any} report
 */
export function slowed(report) {
  const isGiven = report.sensitivity?.length || report.conveyors?.length;
  if (report.mode !== "free" || !report.assumed_limits?.length || isGiven || !(report.cycle_time > 0)) return "";
  // Accelerations fall by the square, jerks by the cube.
  const longer = 1 / Math.sqrt(0.9);
  return `None for single joints of asynchronous arms. With all assumed limits 10 % lower the same motion, slowed, takes ${seconds(report.cycle_time * longer)} (+${percent(longer - 1)}).`;
}

/**
 * Return the joint that decides most stages, in words; empty without one.
 * @param {Plan} plan
 */
export function limiting({ report, joints }) {
  const [first] = Object.entries(report.bottlenecks ?? {}).sort((a, b) => Number(b[1]) - Number(a[1]));
  return first ? `limited by ${jointLabel(joints, first[0])} in ${first[1]} of ${report.stages.length} stages` : "";
}

/** Create the table of torques. @param {Plan} plan @param {Go} go */
function torques({ report, joints }, go) {
  const rows = Object.entries(report.torques.joints).map(([name, row]) => ({
    cells: [
      jointLabel(joints, name),
      `${significant(row.torque)} of ${significant(row.effort)}`,
      percent(row.share, 0),
      row.rated === null ? significant(row.effective) : `${significant(row.effective)} of ${significant(row.rated)}`,
      row.carrying || "–",
      row.acceleration_factor === null ? "–" : `${fixed(row.acceleration_factor, 1)}×`,
    ],
    time: row.time,
  }));
  const lower = report.torques.lower_effort;
  const time = lower && (lower.cycle_time === null ? `${lower.joint} could not hold still` : seconds(lower.cycle_time));
  const texts = [
    "Largest and effective (RMS) torques, in N m or N. The last column is the factor by which the accelerations of this motion could rise until the joint reaches its effort.",
    lower && `With efforts ${percent(lower.share, 0)} lower: ${time}, with the same motion slowed; new transfers may be faster.`,
  ];
  const heads = ["joint", "peak of effort", "share #", "effective", "carrying", "permits #"];
  return block("Torques", ...texts.filter(Boolean).map((text) => paragraph(String(text))), table(heads, rows, go));
}

const VERDICTS = /** @type {Object<string, string>} */ ({ passed: "✓", failed: "✗", "not checked": "–" });

/**
 * Create the panel of the verifier's checks: failed ones first, then passed, then those not checked.
 * @param {Plan} plan
 * @param {Go} go
 */
export function checks(plan, go) {
  const { verification } = plan.report;
  if (!verification) return [paragraph("The plan was not verified.")];
  const order = ["failed", "passed", "not checked"];
  const rows = [...verification.checks]
    .sort((a, b) => order.indexOf(a.verdict) - order.indexOf(b.verdict))
    .map((check) => ({
      cells: [VERDICTS[check.verdict] ?? check.verdict, word(check.name) + (check.unit && ` [${check.unit}]`), significant(check.measured), significant(check.allowed), check.detail],
      mark: check.verdict.replace(" ", "-"),
      time: timeIn(check.detail),
    }));
  return [table(["", "check", "measured #", "allowed #", "where"], rows, go)];
}

/** @param {string} detail @returns {number | undefined} time in a text [s] */
export function timeIn(detail) {
  const match = / at ([0-9]+(?:\.[0-9]+)?) s/.exec(detail ?? "");
  return match ? Number(match[1]) : undefined;
}

/**
 * Create the panel of notes and assumptions, and of paths, seams, conveyors, buffers and tool changes.
 * @param {Plan} plan
 * @param {Go} go
 */
export function notes(plan, go) {
  const { report } = plan;
  const blocks = [];
  if (report.assumptions?.length) {
    blocks.push(block("Assumptions", ...report.assumptions.map(paragraph)));
  }
  if (report.without_jerk_limit?.length) {
    blocks.push(block("Without a jerk limit", paragraph(report.without_jerk_limit.join(", "))));
  }
  if (plan.tools?.length) {
    blocks.push(block("Tools", element("ul", {}, ...plan.tools.map((/** @type {string} */ tool) => element("li", {}, tool)))));
  }
  if (report.notes?.length) {
    blocks.push(block("Notes", element("ul", {}, ...report.notes.map((/** @type {string} */ note) => element("li", {}, ...withCode(note))))));
  }
  for (const kind of ["paths", "seams", "conveyors"]) {
    for (const row of report[kind] ?? []) {
      blocks.push(block(`${word(kind).replace(/s$/, "")} ${row.task}`, members(row, plan, go)));
    }
  }
  for (const kind of ["buffers", "tool_changes"]) {
    for (const [name, row] of Object.entries(report[kind] ?? {})) {
      blocks.push(block(`${word(kind)}: ${name}`, members(row, plan, go)));
    }
  }
  return blocks;
}

/** Create the table of an object's members. @param {any} row @param {Plan} plan @param {Go} go */
function members(row, plan, go) {
  const first = plan.segments.find((segment) => segment.task === row.task && (!row.arm || segment.arm === row.arm));
  const rows = Object.entries(row).map(([name, value]) => ({
    cells: [word(name), memberText(value)],
    time: row.time ?? first?.start,
  }));
  return element("div", {}, table(["SI units", ""], rows, go));
}

/** Format a member. @param {any} value @returns {string} */
function memberText(value) {
  if (Array.isArray(value)) return value.map(memberText).join(", ");
  if (value && typeof value === "object") {
    return Object.entries(value).map(([name, v]) => `${name} ${memberText(v)}`).join(", ");
  }
  return typeof value === "number" ? significant(value) : String(value ?? "–");
}
