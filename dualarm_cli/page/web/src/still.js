// Stills of the 3-D view with a caption, for pictures and for the frames of a video.

import { colour } from "./colours.js";
import { armsOf } from "./data.js";
import { assumed, verdict } from "./panels.js";
import { fixed, seconds } from "./units.js";

/** @typedef {import("./types.js").Plan} Plan */

/** Height of the caption and margin, as fractions of the picture's height. */
const CAPTION = 0.088;
const MARGIN = 0.022;
const SIGNS = { good: "✓", warn: "!", bad: "✗" };

/**
 * Draw the 3-D view with what is done, the time and the cycle below it.
 * @param {Plan} plan
 * @param {import("./scene.js").Scene} scene at its time
 * @param {(arm: string) => string} work what an arm does
 * @param {{width: number, height: number, bare?: boolean}} size px; bare: the view alone
 * @returns {HTMLCanvasElement}
 */
export function still(plan, scene, work, { width, height, bare = false }) {
  const canvas = document.createElement("canvas");
  [canvas.width, canvas.height] = [width, height];
  const g = /** @type {CanvasRenderingContext2D} */ (canvas.getContext("2d"));
  const low = bare ? height : Math.round(height * (1 - CAPTION));
  scene.drawInto(g, width, low);
  if (bare) return canvas;
  g.fillStyle = colour("panel");
  g.fillRect(0, low, width, height - low);
  g.fillStyle = colour("line");
  g.fillRect(0, low, width, 0.008 * height);
  g.fillStyle = colour("accent");
  g.fillRect(0, low, (width * scene.time) / plan.duration, 0.008 * height);
  const [size, margin] = [Math.round(0.032 * height), MARGIN * height];
  const middle = (low + 0.008 * height + height) / 2;
  g.textBaseline = "middle";
  const write = (/** @type {string} */ text, /** @type {number} */ x, /** @type {number} */ y, /** @type {CanvasTextAlign} */ align, /** @type {string} */ name, bold = false, room = Infinity) => {
    const setFont = (/** @type {number} */ px) => (g.font = `${bold ? "600 " : ""}${px}px system-ui, sans-serif`);
    setFont(size);
    setFont(size * Math.min(1, room / g.measureText(text).width));
    g.textAlign = align;
    g.fillStyle = colour(name);
    g.fillText(text, x, y);
    return g.measureText(text).width;
  };
  const left = 2 * margin + write(plan.title, margin, middle, "left", "text", true);
  const cycle = `${fixed(scene.time, 1)} / ${seconds(plan.duration, 1)}${plan.closes ? " cycle" : ""}`;
  const right = width - 2 * margin - write(cycle, width - margin, middle, "right", "text", true);
  const { text, mark } = verdict(plan.report);
  const caveat = assumed(plan.report);
  const words = [mark === "warn" ? "verified with exceptions" : text, caveat].filter(Boolean).join(" · ");
  write(`${SIGNS[mark]} ${words}`, (left + right) / 2, middle, "center", mark === "good" && caveat ? "warn" : mark, false, right - left);
  armsOf(plan).forEach((arm, i) => {
    const y = margin + size * (0.6 + 1.35 * i);
    write(arm, margin, y, "left", `${arm}-text`, true);
    write(work(arm), margin + 3.2 * size, y, "left", "text");
  });
  return canvas;
}
