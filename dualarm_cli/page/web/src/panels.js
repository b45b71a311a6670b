// What the report says, as panels: cycle and bound, stages, waits, limits, checks, notes.

import { element, table } from "./dom.js";
import { actionOn, fixed, millimetres, percent, seconds, significant, word } from "./units.js";

/** @typedef {import("./types.js").Plan} Plan */
/** @typedef {(time: number) => void} Go */

/** What is saved, or costs, that is shown [s]. */
const SHOWN = 5e-4;

/**
 * Returns a title with what follows it.
 * @param {string} title
 * @param {...(Node | string | null)} children
 */
const block = (title, ...children) => element("section", { class: "block" }, element("h3", {}, title), ...children);

/** @param {string} text */
const paragraph = (text) => element("p", {}, text);

/** @param {string} value @param {string} label @param {string} [title] */
const figure = (value, label, title = "") =>
  element("div", { class: "figure", title: title || null }, element("b", {}, value), element("span", {}, label));

/**
 * Returns a horizontal bar for a share.
 * @param {number} share
 * @param {string} [mark] class
 */
function shareBar(share, mark = "") {
  const bar = element("span", { class: `share ${mark}` }, element("i"));
  bar.firstChild.style.width = `${Math.min(Math.max(share, 0), 1) * 100}%`;
  return bar;
}

/**
 * Returns the first panel: how fast, how good, how clear.
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
    figures.push(figure(seconds(report.lower_bound), "lower bound", "No plan of these stages is faster, as the notes say"));
    figures.push(figure(percent(report.gap), "gap to the bound: at most this could be saved"));
  }
  const nearest = report.smallest_clearance;
  if (nearest) figures.push(figure(millimetres(nearest.clearance), `least clearance (${millimetres(nearest.required)} required)`));
  const collisions = report.collisions ? [sentence(`Collisions: ${report.collisions}`, nearest?.time, go)] : [];
  if (report.skew) collisions.push(paragraph(`Skew: ${report.skew}`));
  const cost = report.clearance_cost;
  if (cost > SHOWN) {
    collisions.push(paragraph(`Clearance costs ${seconds(cost)} compared with the plan without collision checking.`));
  }
  const { text, mark } = verdict(report);
  if (mark === "warn") collisions.unshift(element("p", { class: mark }, `Plan ${text}.`));
  if (report.bodies) collisions.push(paragraph(report.bodies.text.replace("b", "B")));
  const saved = savings(report).map(paragraph);
  return [
    element("div", { class: "figures" }, ...figures),
    ...collisions,
    ...saved,
    ...budget(report),
    arms(report),
    bottlenecks(report),
    block("Settings", paragraph(settingsText(report))),
  ];
}

/**
 * Returns what the verifier says of the plan, and whether that is good, bad, or good with a warning.
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
 * Returns the sentence on what is saved as tools pass ends of lines in motion; none where nothing is.
 * @param {any} report
 */
export function savings(report) {
  const found = [];
  const { blending } = report;
  if (blending && blending.gain > SHOWN) {
    found.push(`Blending saves ${seconds(blending.gain)} (${percent(blending.share)}) compared with stops at the outer ends of lines.`);
  }
  return found;
}

/** @param {string} text @param {number | undefined} time @param {Go} go */
function sentence(text, time, go) {
  const made = paragraph(text);
  if (time !== undefined && time !== null) {
    made.classList.add("leads");
    made.addEventListener("click", () => go(time));
  }
  return made;
}

/** @param {any} report */
function settingsText(report) {
  const some = Object.entries(report.settings).filter(([, value]) => value !== null);
  const texts = some.map(([name, value]) => `${word(name)} ${value}`);
  const mode = report.mode === "free" ? "asynchronous arms" : "synchronous stages";
  return [mode, `order ${report.order}`, `speed ${percent(report.speed, 0)}`, ...texts].join(", ");
}

/** @param {any} report */
function budget(report) {
  if (!report.budget?.length) return [];
  const rows = report.budget.map((/** @type {any} */ row) => ({
    cells: [row.kept ? "kept" : "missed", row.text ?? row.name],
    mark: row.kept ? "" : "failed",
  }));
  return [block("Budget", table(["", "asked"], rows, () => {}))];
}

const TIMES = ["transfer", "approach", "dwell", "retract", "path", "seam", "return", "waiting"];

/** @param {any} report */
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
  rows.push({ cells: ["works", ...names.map((name) => percent(report.arms[name].utilisation))] });
  return block("Time of the arms", table(["", ...names.map((name) => `${name} #`)], rows, () => {}));
}

/** @param {any} report */
function bottlenecks(report) {
  const all = Object.entries(report.bottlenecks);
  if (all.length === 0) return null;
  const most = Math.max(...all.map(([, count]) => Number(count)));
  const rows = all.map(([joint, count]) => ({
    cells: [joint, String(count), shareBar(Number(count) / most)],
  }));
  return block("Bottlenecks", paragraph("Joint that decides the transfer, and in how many stages."), table(["joint", "stages #", ""], rows, () => {}));
}

/**
 * Returns the panel of stages.
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
      stage.bottleneck,
      clearances.has(i) ? fixed(clearances.get(i).clearance * 1e3, 1) : "–",
    ],
    time: stage.start,
  }));
  const heads = ["#", "tasks", "start [s] #", "length [s] #", "bottleneck", "clear [mm] #"];
  return [table(heads, rows, go)];
}

/**
 * Returns what is done in a stage.
 * @param {Plan} plan
 * @param {import("./types.js").Stage} stage
 */
export function stageText(plan, stage) {
  if (stage.tasks.length === 0) return "return";
  const within = plan.events.filter((e) => e.time >= stage.start - 1e-9 && e.time < stage.end);
  /** @type {Map<string, string>} */
  const done = new Map();
  for (const task of stage.tasks) {
    const actions = new Set(within.filter((e) => e.task === task).map((e) => e.action));
    const action = [...actions].join(" and ");
    const before = done.get(action);
    done.set(action, before ? `${before}, ${task}` : actionOn(action, task));
  }
  return [...done.values()].join("; ");
}

/**
 * Returns the panel of waits: who waits for whom, and why.
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
    block("One by one", table(["arm", "start [s] #", "length [s] #", "reason", "waits for", "before"], rows, go)),
  ];
}

/**
 * Returns the panel of joints: limits, how much of them is used, and what they are worth.
 * @param {Plan} plan
 * @param {Go} go
 */
export function limits(plan, go) {
  const { report } = plan;
  const used = plan.joints.map((joint) => {
    const shares = report.limits_used[joint.name] ?? {};
    const cells = ["velocity", "acceleration", "jerk"].map((name) => percent(shares[name], 0));
    return { cells: [joint.name, ...cells, joint.limits.source] };
  });
  const found = [block("Largest share of each limit", table(["joint", "velocity #", "acceleration #", "jerk #", "source"], used, go))];
  if (report.sensitivity?.length) {
    const rows = report.sensitivity.map((/** @type {any} */ row) => ({
      cells: [row.joint || "all together", row.limit, fixed(row.lower, 3), fixed(row.higher, 3)],
    }));
    const heads = ["joint", "limit", "10 % lower [s] #", "10 % higher [s] #"];
    found.push(block("Cycle time with other limits", paragraph("With the same postures; a new plan may be faster."), table(heads, rows, go)));
  }
  return found;
}

const VERDICTS = /** @type {Object<string, string>} */ ({ passed: "✓", failed: "✗", "not checked": "–" });

/**
 * Returns the panel of the verifier's checks: failed ones first, then passed, then those that do not apply.
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

/** @param {string} detail @returns {number | undefined} the time that a text names */
export function timeIn(detail) {
  const found = / at ([0-9]+(?:\.[0-9]+)?) s/.exec(detail ?? "");
  return found ? Number(found[1]) : undefined;
}

/**
 * Returns the panel of notes and assumptions, and what belongs to one kind of work.
 * @param {Plan} plan
 * @param {Go} go
 */
export function notes(plan, go) {
  const { report } = plan;
  const found = [];
  if (report.assumptions?.length) {
    found.push(block("Assumptions", ...report.assumptions.map(paragraph)));
  }
  if (report.without_jerk_limit?.length) {
    found.push(block("Without a jerk limit", paragraph(report.without_jerk_limit.join(", "))));
  }
  if (report.notes?.length) {
    found.push(block("Notes", element("ul", {}, ...report.notes.map((/** @type {string} */ note) => element("li", {}, note)))));
  }
  for (const kind of ["paths", "seams", "conveyors"]) {
    for (const row of report[kind] ?? []) {
      found.push(block(`${word(kind).replace(/s$/, "")} ${row.task}`, members(row, plan, go)));
    }
  }
  for (const kind of ["buffers", "tool_changes"]) {
    for (const [name, row] of Object.entries(report[kind] ?? {})) {
      found.push(block(`${word(kind)}: ${name}`, members(row, plan, go)));
    }
  }
  return found;
}

/** @param {any} row @param {Plan} plan @param {Go} go */
function members(row, plan, go) {
  const first = plan.segments.find((segment) => segment.task === row.task && (!row.arm || segment.arm === row.arm));
  const rows = Object.entries(row).map(([name, value]) => ({
    cells: [word(name), memberText(value)],
    time: row.time ?? first?.start,
  }));
  return element("div", {}, table(["SI units", ""], rows, go));
}

/** @param {any} value @returns {string} */
function memberText(value) {
  if (Array.isArray(value)) return value.map(memberText).join(", ");
  if (value && typeof value === "object") {
    return Object.entries(value).map(([name, v]) => `${name} ${memberText(v)}`).join(", ");
  }
  return typeof value === "number" ? significant(value) : String(value ?? "–");
}
