// Gantt chart: one row per arm with tasks above and motion segments below, and one for the platform.

import { colour } from "./colours.js";
import { barAt, ganttRows } from "./gantt_layout.js";
import { commonLevel, commonPrefix, fitting, forms } from "./labels.js";
import { actionOn, rulerTimes } from "./units.js";

/** @typedef {import("./types.js").Plan} Plan */
/** @typedef {import("./gantt_layout.js").GanttRow} GanttRow */
/** @typedef {import("./gantt_layout.js").Bar} Bar */

/** Scale of all sizes: that of the style sheet when the page opens. */
const SCALE = globalThis.document ? parseFloat(getComputedStyle(document.documentElement).fontSize) / 10 : 1;
export const scaled = (/** @type {number} */ size) => Math.round(size * SCALE);

export const GUTTER = scaled(92);
export const MARGIN = scaled(14);
export const FONT = `${scaled(11)}px system-ui, sans-serif`;
export const SMALL = `${scaled(10)}px system-ui, sans-serif`;

const RULER = scaled(20);
const STAGES = scaled(16);
/** Height of the stages of one arm if each arm has its own [px]. */
const ARM_STAGES = scaled(13);
const TASKS = scaled(17);
const BARS = scaled(24);
const PLATFORM = scaled(12);
const GAP = scaled(7);
/** Thickness of the line below what decides the cycle time [px]. */
const MARK = scaled(3);

/** Gantt chart on its canvas. */
export class Gantt {
  /**
   * @param {Plan} plan
   * @param {import("./clock.js").TimeWindow} timeWindow
   */
  constructor(plan, timeWindow) {
    this.plan = plan;
    this.timeWindow = timeWindow;
    this.rows = ganttRows(plan);
    this.prefixes = new Map(
      this.rows.map((row) => [row.name, commonPrefix(row.visits.map((visit) => visit.task))]),
    );
    this.canvas = document.createElement("canvas");
    this.canvas.className = "gantt";
    const arms = this.rows.filter((row) => row.arm).map((row) => row.arm);
    /** Arms with their own stages; empty if the arms share stages. */
    this.stageRows = plan.stages.some((stage) => stage.arm) ? arms : [];
    this.stagesHeight = this.stageRows.length ? this.stageRows.length * ARM_STAGES : STAGES;
    /** Height of ruler and stages, where a drag moves the time cursor [px]. */
    this.head = RULER + this.stagesHeight;
    let top = this.head + GAP;
    this.tops = this.rows.map((row) => {
      const rowTop = top;
      top += (row.arm ? TASKS + BARS : PLATFORM) + GAP;
      return rowTop;
    });
    this.height = top;
    this.width = 0;
  }

  /** @param {number} width px */
  resize(width) {
    const ratio = window.devicePixelRatio || 1;
    this.width = width;
    this.canvas.width = Math.round(width * ratio);
    this.canvas.height = Math.round(this.height * ratio);
    this.canvas.style.width = `${width}px`;
    this.canvas.style.height = `${this.height}px`;
    this.draw();
  }

  /** @param {number} time @returns {number} px */
  x(time) {
    const { from, to } = this.timeWindow;
    return GUTTER + ((time - from) / (to - from)) * (this.width - GUTTER - MARGIN);
  }

  /**
   * Return the bar at a point of the canvas.
   * @param {number} time s
   * @param {number} y px from the top of the canvas
   * @returns {Bar | undefined}
   */
  barAt(time, y) {
    const pixel = (this.timeWindow.to - this.timeWindow.from) / Math.max(this.width - GUTTER - MARGIN, 1);
    for (const [i, row] of this.rows.entries()) {
      const bottom = this.tops[i] + (row.arm ? TASKS + BARS : PLATFORM);
      if (y >= this.tops[i] && y <= bottom) return barAt(row.bars, time, 2 * pixel);
    }
    return undefined;
  }

  /**
   * Return the index of the stage at a point of the canvas, -1 outside the row of stages.
   * @param {number} time s
   * @param {number} y px from the top of the canvas
   */
  stageAt(time, y) {
    if (y < RULER || y >= this.head) return -1;
    const arm = this.stageRows[Math.floor(((y - RULER) / this.stagesHeight) * this.stageRows.length)];
    return this.plan.stages.findIndex((stage) => (!arm || !stage.arm || stage.arm === arm) && stage.start <= time && time <= stage.end);
  }

  draw() {
    if (this.width <= GUTTER + MARGIN) return;
    const g = /** @type {CanvasRenderingContext2D} */ (this.canvas.getContext("2d"));
    const ratio = this.canvas.width / this.width;
    g.setTransform(ratio, 0, 0, ratio, 0, 0);
    g.clearRect(0, 0, this.width, this.height);
    g.textBaseline = "middle";
    this.drawNames(g);
    g.save();
    g.beginPath();
    g.rect(GUTTER, 0, this.width - GUTTER - MARGIN + 1, this.height);
    g.clip();
    this.drawRuler(g);
    this.drawStages(g);
    this.drawVisits(g);
    for (const [i, row] of this.rows.entries()) {
      const top = this.tops[i];
      if (row.arm) {
        this.drawBars(g, row, top + TASKS);
      } else {
        g.fillStyle = colour("platform");
        for (const bar of this.visible(row.bars)) {
          g.fillRect(this.x(bar.start), top + 2, this.length(bar), PLATFORM - 4);
        }
      }
      // A line below marks what decides the cycle time, whatever its colour.
      g.fillStyle = colour("text");
      for (const bar of this.visible(row.bars.filter((bar) => bar.critical))) {
        g.fillRect(this.x(bar.start), top + (row.arm ? TASKS + BARS : PLATFORM) + 1, this.length(bar), MARK);
      }
    }
    g.restore();
  }

  /** @param {{start: number, end: number}} bar @returns {number} px, at least one */
  length(bar) {
    return Math.max(this.x(bar.end) - this.x(bar.start), 1);
  }

  /** @template {{start: number, end: number}} T @param {T[]} bars @returns {T[]} */
  visible(bars) {
    return bars.filter((bar) => bar.end >= this.timeWindow.from && bar.start <= this.timeWindow.to);
  }

  /** @param {CanvasRenderingContext2D} g */
  drawNames(g) {
    g.font = FONT;
    g.textAlign = "right";
    g.fillStyle = colour("muted");
    g.fillText("stage", GUTTER - 10, RULER + this.stagesHeight / 2);
    for (const [i, row] of this.rows.entries()) {
      const middle = row.arm ? TASKS + BARS / 2 : PLATFORM / 2;
      g.fillStyle = colour(row.arm ? `${row.arm}-trace` : "muted");
      if (row.arm) g.fillRect(GUTTER - 5, this.tops[i] + TASKS, 4, BARS);
      g.fillStyle = colour(row.arm ? `${row.arm}-text` : "muted");
      g.fillText(row.name, GUTTER - 10, this.tops[i] + middle);
    }
  }

  /** @param {CanvasRenderingContext2D} g */
  drawRuler(g) {
    const { from, to } = this.timeWindow;
    const { times, decimals } = rulerTimes(from, to, this.width / scaled(80));
    g.font = SMALL;
    g.textAlign = "center";
    for (const time of times) {
      const x = Math.round(this.x(time)) + 0.5;
      g.fillStyle = colour("muted");
      const text = time.toFixed(decimals);
      const half = g.measureText(text).width / 2;
      g.fillText(text, Math.min(Math.max(x, GUTTER + half + 1), this.width - MARGIN - half), 0.45 * RULER);
      g.strokeStyle = colour("grid");
      g.beginPath();
      g.moveTo(x, RULER - 4);
      g.lineTo(x, this.height);
      g.stroke();
    }
  }

  /** @param {CanvasRenderingContext2D} g */
  drawStages(g) {
    g.font = SMALL;
    g.textAlign = "center";
    const rows = this.stageRows.length ? this.stageRows : [""];
    rows.forEach((arm, row) => {
      const height = this.stagesHeight / rows.length;
      const top = RULER + row * height;
      const all = this.plan.stages.map((stage, i) => ({ ...stage, text: String(i + 1) }));
      const armStages = all.filter((stage) => !arm || !stage.arm || stage.arm === arm);
      const bars = armStages.map((stage, i) => ({ ...stage, odd: i % 2 === 1 }));
      for (const bar of this.visible(bars)) {
        g.fillStyle = colour(bar.odd ? "band-odd" : "band-even");
        g.fillRect(this.x(bar.start), top, this.length(bar), height - 1);
      }
      g.fillStyle = colour("muted");
      let end = -Infinity;
      for (const bar of this.visible(bars)) {
        const half = g.measureText(bar.text).width / 2;
        const middle = Math.min(this.x(bar.start) + this.length(bar) / 2, this.width - MARGIN - half);
        if (middle - half < end + 4) continue;
        end = middle + half;
        g.fillText(bar.text, middle, top + height / 2);
      }
    });
  }

  /**
   * Draw the tasks of both arms: action and id, all shortened to the same level.
   * @param {CanvasRenderingContext2D} g
   */
  drawVisits(g) {
    g.font = FONT;
    g.textAlign = "center";
    const width = (/** @type {string} */ text) => g.measureText(text).width;
    const labels = this.rows.flatMap((row, i) =>
      this.visible(row.visits).map((visit) => {
        const from = Math.max(this.x(visit.start), GUTTER);
        const to = Math.min(this.x(visit.end), this.width - MARGIN);
        const candidates = forms(visit.task, actionOn(visit.action, visit.task), this.prefixes.get(row.name) ?? 0);
        return { visit, from, to, candidates, space: to - from - 4, top: this.tops[i] };
      }),
    );
    const level = commonLevel(labels, width);
    let [row, end] = [-1, -Infinity];
    for (const { visit, from, to, candidates, space, top } of labels) {
      if (top !== row) [row, end] = [top, -Infinity];
      const allowed = candidates.slice(Math.min(level, candidates.length - 1));
      // A label that still does not fit covers its neighbours, which are then left out.
      const text = fitting(allowed, space, width);
      const half = width(text) / 2;
      const middle = Math.min(Math.max((from + to) / 2, GUTTER + half), this.width - MARGIN - half);
      if (middle - half < end + 4) continue;
      end = middle + half;
      g.fillStyle = colour(`${visit.family}-text`);
      g.fillText(text, middle, top + TASKS / 2);
    }
  }

  /**
   * Draw the segments of an arm: low transfers, rising approaches, full dwells, falling retracts, hatched waits.
   * @param {CanvasRenderingContext2D} g
   * @param {GanttRow} row
   * @param {number} top
   */
  drawBars(g, row, top) {
    g.font = SMALL;
    g.textAlign = "center";
    for (const bar of this.visible(row.bars)) {
      drawBar(g, bar, this.x(bar.start), this.length(bar), top);
    }
  }
}

/**
 * Draw a segment.
 * @param {CanvasRenderingContext2D} g
 * @param {Bar} bar
 * @param {number} x
 * @param {number} width
 * @param {number} top
 */
function drawBar(g, bar, x, width, top) {
  const low = Math.round(BARS * 0.36);
  const right = x + Math.max(width - (width > 3 ? 0.75 : 0), 0.5);
  const bottom = top + BARS;
  g.beginPath();
  if (bar.kind === "approach") outline(g, [x, bottom - low], [right, top], [right, bottom], [x, bottom]);
  else if (bar.kind === "retract") outline(g, [x, top], [right, bottom - low], [right, bottom], [x, bottom]);
  else if (bar.kind === "transfer" || bar.kind === "return") g.rect(x, bottom - low, right - x, low);
  else if (bar.kind === "critical") g.rect(x, bottom - 0.4 * BARS, right - x, 0.2 * BARS);
  else if (bar.kind === "wait") g.rect(x, bottom - 0.62 * BARS, right - x, 0.62 * BARS);
  else g.rect(x, top, right - x, BARS);
  if (bar.kind === "wait") {
    hatch(g, x, right, bottom - 0.62 * BARS, bottom);
    if (g.measureText(bar.label).width + 8 <= width) {
      const half = g.measureText(bar.label).width / 2 + 3;
      g.fillStyle = colour("panel");
      g.fillRect(x + width / 2 - half, bottom - 0.56 * BARS, 2 * half, 0.5 * BARS);
      g.fillStyle = colour("text");
      g.fillText(bar.label, x + width / 2, bottom - 0.31 * BARS);
    }
    return;
  }
  const line = bar.kind === "approach" || bar.kind === "retract";
  g.fillStyle = colour(fillName(bar, line));
  g.fill();
  if (bar.kind === "return") {
    g.strokeStyle = colour("muted");
    g.stroke();
  }
}

/** @param {Bar} bar @param {boolean} line */
function fillName(bar, line) {
  if (bar.kind === "transfer") return "transfer";
  if (bar.kind === "critical") return "text";
  if (bar.kind === "return") return "panel";
  return line ? `${bar.family}-light` : bar.family;
}

/** @param {CanvasRenderingContext2D} g @param {...[number, number]} points */
function outline(g, ...points) {
  points.forEach(([x, y], i) => (i ? g.lineTo(x, y) : g.moveTo(x, y)));
  g.closePath();
}

/**
 * Fill the current path with diagonal lines.
 * @param {CanvasRenderingContext2D} g
 * @param {number} left
 * @param {number} right
 * @param {number} top
 * @param {number} bottom
 */
function hatch(g, left, right, top, bottom) {
  g.save();
  g.clip();
  g.strokeStyle = colour("wait");
  g.lineWidth = 1.25;
  const height = bottom - top;
  g.beginPath();
  for (let x = Math.floor((left - height) / 5) * 5; x < right; x += 5) {
    g.moveTo(x, bottom);
    g.lineTo(x + height, top);
  }
  g.stroke();
  g.restore();
  g.strokeStyle = colour("wait");
  g.lineWidth = 1;
  g.strokeRect(left + 0.5, top + 0.5, Math.max(right - left - 1, 0), height - 1);
}

/** Entries of the legend: families and kinds as the chart draws them. */
export const LEGEND = [
  { label: "transfer", bar: { kind: "transfer", family: "" } },
  { label: "approach", bar: { kind: "approach", family: "pick" } },
  { label: "pick", bar: { kind: "dwell", family: "pick" } },
  { label: "retract", bar: { kind: "retract", family: "pick" } },
  { label: "place", bar: { kind: "dwell", family: "place" } },
  { label: "give", bar: { kind: "dwell", family: "give" } },
  { label: "take", bar: { kind: "dwell", family: "take" } },
  { label: "tool change", bar: { kind: "dwell", family: "tool" } },
  { label: "path", bar: { kind: "path", family: "path" } },
  { label: "seam", bar: { kind: "seam", family: "seam" } },
  { label: "via", bar: { kind: "dwell", family: "move" } },
  { label: "wait", bar: { kind: "wait", family: "" } },
  { label: "return", bar: { kind: "return", family: "" } },
  { label: "decides the cycle time", bar: { kind: "critical", family: "" } },
];

/**
 * Draw an entry of the legend.
 * @param {HTMLCanvasElement} canvas
 * @param {{kind: string, family: string}} bar
 */
export function drawLegendEntry(canvas, bar) {
  const ratio = window.devicePixelRatio || 1;
  canvas.width = Math.round(scaled(18) * ratio);
  canvas.height = Math.round(scaled(12) * ratio);
  const g = /** @type {CanvasRenderingContext2D} */ (canvas.getContext("2d", { willReadFrequently: true }));
  g.setTransform(ratio, 0, 0, ratio * (scaled(12) / BARS), 0, 0);
  g.font = SMALL;
  drawBar(g, { ...bar, start: 0, end: 0, label: "wait", text: "" }, 0, scaled(18), 0);
}
