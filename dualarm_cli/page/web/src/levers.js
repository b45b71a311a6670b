// Panel of levers: what would make the plan faster, with sliders that answer from estimates.

import { block, paragraph } from "./panels.js";
import { button, element, table } from "./dom.js";
import { fixed, percent, seconds } from "./units.js";

/** @typedef {import("./types.js").Plan} Plan */
/** @typedef {import("./types.js").Levers} Levers */
/** @typedef {import("./types.js").Lever} Lever */

/** Maximum number of levers in the table. */
const MOST_LEVERS = 15;

/**
 * Create the panel.
 * @param {Plan} plan
 */
export function levers(plan) {
  const { levers: known, report } = plan;
  if (!known) return [paragraph("What would help is not in this page. Run `dualarm why PLAN`, which estimates and re-plans changes, or plan with `--why`.")];
  const shown = known.levers.filter((lever) => lever.status || (lever.estimate ?? 0) > 0).slice(0, MOST_LEVERS);
  const rows = shown.map((lever) => ({ cells: [nameOf(lever), gainText(lever.estimate, "?"), lever.gain === null ? (lever.status ? "no plan" : "") : gainText(lever.gain), percent((lever.gain ?? lever.estimate ?? 0) / report.cycle_time)] }));
  const together = known.combinations.map((row) => ({ cells: [row.levers.map((k) => nameOf(known.levers[k])).join(", "), row.gain === null ? "no plan" : gainText(row.gain), percent((row.gain ?? 0) / report.cycle_time)] }));
  return [
    ...known.sentences.map((text) => paragraph(`${text}.`)),
    known.levers.some((lever) => lever.stops) && block("What would help", sliders(plan, known)),
    block("Levers", paragraph("Gains in seconds: estimated with the decisions of this plan, and of a new plan, verified."), table(["lever", "estimated #", "verified #", "% #"], rows, () => {})),
    together.length > 0 && block("Together, verified", table(["levers", "gain #", "% #"], together, () => {})),
  ].filter(Boolean);
}

/** @param {Lever} lever */
const nameOf = (lever) => `${lever.name} ${lever.change}`;

/** @param {number | null} gain s @param {string} [none] */
const gainText = (gain, none = "–") => (gain === null ? none : fixed(gain, 3));

/**
 * Sum the gains of chosen stops, or look up the verified gain of exactly these levers.
 * @param {Levers} known
 * @param {Map<number, {share: number, estimate: number}>} chosen stops by index of the lever
 * @returns {{gain: number, verified: boolean}}
 */
export function together(known, chosen) {
  const indices = [...chosen.keys()];
  const whole = [...chosen.values()].every((stop) => stop.share === 1);
  const single = indices.length === 1 ? known.levers[indices[0]].gain : null;
  const found = known.combinations.find((row) => row.levers.length === indices.length && row.levers.every((k) => chosen.has(k)));
  const verified = single ?? found?.gain ?? null;
  if (whole && verified !== null) return { gain: verified, verified: true };
  return { gain: [...chosen.values()].reduce((sum, stop) => sum + stop.estimate, 0), verified: false };
}

/**
 * Create the sliders, with the answer below them.
 * @param {Plan} plan
 * @param {Levers} known
 */
function sliders(plan, known) {
  /** @type {Map<number, {share: number, change: string, estimate: number}>} */
  const chosen = new Map();
  /** @type {Map<number, () => void>} */
  const reset = new Map();
  const answer = element("p", { class: "answer", role: "status" });
  const verified = element("p", { class: "answer", role: "status" });
  const { cycle_time: now } = plan.report;
  const rows = known.levers.flatMap((lever, k) => {
    if (!lever.stops) return [];
    const stops = [...lever.stops, { share: 0, change: "as it is", estimate: 0 }].sort((a, b) => a.share - b.share);
    const none = stops.findIndex((stop) => stop.share === 0);
    const value = element("output", {});
    const show = () => {
      const stop = stops[Number(input.value)];
      value.textContent = stop.share === 0 ? stop.change : `${stop.change}: ${gainOf(stop.estimate)}`;
      input.setAttribute("aria-valuetext", value.textContent ?? "");
      if (stop.share === 0) chosen.delete(k);
      else chosen.set(k, stop);
    };
    const change = () => {
      // Levers that change the same values do not add up.
      if (Number(input.value) !== none) for (const other of lever.excludes ?? []) reset.get(other)?.();
      show();
      tell();
    };
    const input = element("input", { type: "range", min: 0, max: stops.length - 1, value: none, step: 1, "aria-label": lever.name, oninput: change });
    reset.set(k, () => {
      input.value = String(none);
      show();
    });
    show();
    return [element("label", { class: "slider" }, element("span", {}, lever.name), input, value)];
  });
  function tell() {
    const { gain, verified: isVerified } = together(known, chosen);
    verified.textContent = "";
    if (chosen.size === 0) answer.textContent = "Move a slider: its stops are estimates with the decisions of this plan.";
    else answer.textContent = `${seconds(now - gain)} (${gainOf(gain)}), ${isVerified ? "verified" : chosen.size > 1 ? "estimated: the sum of the gains" : "estimated"}.`;
  }
  tell();
  const token = new URLSearchParams(location.search).get("token");
  const plans = token && button("plan it", "Plan the job with these values, and verify it; the files stay as they are", async () => {
    if (chosen.size === 0) return;
    const asked = [...chosen].map(([k, stop]) => [nameOf(known.levers[k]), stop.share]);
    verified.textContent = "Planning …";
    verified.textContent = await replanned(token, asked, now);
  });
  return element("div", { class: "sliders" }, ...rows, answer, plans || null, verified);
}

/** @param {number} gain s */
const gainOf = (gain) => `${gain > 0 ? "−" : "+"}${seconds(Math.abs(gain))}`;

/**
 * Let `dualarm plan --watch` plan the job with levers, and describe the result.
 * @param {string} token
 * @param {(string | number)[][]} asked names of levers, and shares of their changes
 * @param {number} now cycle time of the plan [s]
 */
async function replanned(token, asked, now) {
  try {
    const response = await fetch(`replan?token=${encodeURIComponent(token)}`, { method: "POST", body: JSON.stringify({ levers: asked }) });
    if (!response.ok) return `The command refuses: ${response.status} ${response.statusText}.`;
    const { error, status, cycle_time: time, findings } = await response.json();
    if (error) return `Not planned: ${error}.`;
    if (status !== "planned") return `No plan (${status.replace("_", " ")}): ${findings.join("; ")}`;
    return `${seconds(time)} (${gainOf(now - time)}), planned and verified. The files are as they were.`;
  } catch {
    return "The command that watches the files has ended.";
  }
}
