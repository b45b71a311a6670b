// Curves of selected joints with their limits, and of the clearance: one plot per quantity, on the timeline's axis.

import uPlot from "uplot";
import { clearanceAt, clearanceColour } from "./clearance.js";
import { DASHES, colour } from "./colours.js";
import { armsOf } from "./data.js";
import { GUTTER, MARGIN, SMALL, scaled } from "./gantt.js";
import { toolState } from "./tools.js";
import { sampleCurves } from "./trajectory.js";
import { jointUnit, rulerTimes } from "./units.js";

/** @typedef {import("./types.js").Plan} Plan */
/** @typedef {import("./types.js").Joint} Joint */
/** @typedef {import("./trajectory.js").Quantity} Quantity */

/** Width of an axis label [px]. */
const LABEL = scaled(20);

/**
 * Return the limits of a joint's quantity in SI units.
 * @param {Joint} joint
 * @param {Quantity} quantity
 * @returns {number[]}
 */
export function limitsOf(joint, quantity) {
  const { lower, upper } = joint.limits;
  const values = quantity === "position" ? [lower, upper] : [joint.limits[quantity]];
  const limits = /** @type {number[]} */ (values.filter((limit) => limit !== null));
  return quantity === "position" ? limits : limits.flatMap((limit) => [-limit, limit]);
}

/**
 * Return the style of a joint's curve: the colour of its arm, the dashes of its number in the arm.
 * @param {Joint[]} joints of the robot
 * @param {Joint} joint
 */
export function curveStyle(joints, joint) {
  const number = joints.filter(({ group }) => group === joint.group).indexOf(joint);
  return { colour: colour(`${joint.group}-trace`), dash: DASHES[number % DASHES.length] };
}

/** @typedef {{width: number, height: number}} Size of a plot [px] */

/**
 * @typedef {object} Plot
 * @property {string} name quantity, or "clearance"
 * @property {HTMLElement} element
 * @property {() => void} update draws the visible time window
 * @property {(width: number, height: number) => void} resize
 * @property {() => void} destroy
 */

/**
 * Create a plot on the timeline's axis.
 * @param {object} options
 * @param {string} options.name
 * @param {string} options.title of its axis
 * @param {import("./clock.js").TimeWindow} options.timeWindow
 * @param {Size} options.size
 * @param {{colour: string, dash: number[], steps?: boolean}[]} options.series
 * @param {{value: number, colour: string}[]} options.limits dashed lines
 * @param {(from: number, to: number, count: number) => uPlot.AlignedData} options.data
 * @param {boolean} [options.fromZero]
 * @returns {Plot}
 */
function makePlot({ name, title, timeWindow, size, series, limits, data, fromZero }) {
  const container = document.createElement("div");
  container.className = "plot";
  container.dataset.name = name;
  const axis = { stroke: colour("muted"), font: SMALL };
  const grid = { stroke: colour("grid"), width: 1 };
  const levels = limits.map((limit) => limit.value);
  const plot = new uPlot(
    {
      ...size,
      pxAlign: 0,
      padding: [8, MARGIN, 6, 0],
      legend: { show: false },
      cursor: { show: false },
      select: { show: false, left: 0, top: 0, width: 0, height: 0 },
      scales: {
        x: { time: false, range: () => [timeWindow.from, timeWindow.to] },
        y: {
          range: (_, low, high) => {
            const ends = [low ?? 0, high ?? 1, ...levels];
            const min = fromZero ? 0 : Math.min(...ends);
            const max = Math.max(...ends);
            const padding = (max - min || 1) * 0.06;
            return [fromZero ? 0 : min - padding, max + padding];
          },
        },
      },
      axes: [
        {
          size: 0,
          ...axis,
          grid,
          ticks: { show: false },
          values: () => [],
          splits: (u) => rulerTimes(timeWindow.from, timeWindow.to, u.width / scaled(80)).times,
        },
        {
          size: GUTTER - LABEL,
          ...axis,
          grid,
          ticks: { show: false },
          label: title,
          labelSize: LABEL,
          labelFont: SMALL,
          space: scaled(16),
          gap: 6,
        },
      ],
      series: [
        {},
        ...series.map(({ colour: stroke, dash }) => ({
          stroke,
          dash,
          width: scaled(15) / 10,
          points: { show: false },
        })),
      ],
      hooks: { draw: [(/** @type {uPlot} */ u) => drawLimits(u, limits)] },
    },
    data(timeWindow.from, timeWindow.to, size.width),
    container,
  );
  return {
    name,
    element: container,
    update: () => plot.setData(data(timeWindow.from, timeWindow.to, Math.max(plot.width - GUTTER, 50))),
    resize: (width, height) => plot.setSize({ width, height }),
    destroy: () => plot.destroy(),
  };
}

/**
 * Draw limits as dashed lines.
 * @param {uPlot} u
 * @param {{value: number, colour: string}[]} limits
 */
function drawLimits(u, limits) {
  const { ctx, bbox } = u;
  ctx.save();
  ctx.setLineDash([5 * devicePixelRatio, 4 * devicePixelRatio]);
  ctx.lineWidth = devicePixelRatio;
  for (const { value, colour: stroke } of limits) {
    const y = Math.round(u.valToPos(value, "y", true)) + 0.5;
    if (y < bbox.top || y > bbox.top + bbox.height) continue;
    ctx.strokeStyle = stroke;
    ctx.beginPath();
    ctx.moveTo(bbox.left, y);
    ctx.lineTo(bbox.left + bbox.width, y);
    ctx.stroke();
  }
  ctx.restore();
}

/**
 * Create the plots of a quantity of the selected joints: one each for revolute and for prismatic joints.
 * @param {Quantity} quantity
 * @param {Joint[]} selected
 * @param {Joint[]} all joints of the robot
 * @param {import("./clock.js").TimeWindow} timeWindow
 * @param {Size} size
 * @returns {Plot[]}
 */
export function jointPlots(quantity, selected, all, timeWindow, size) {
  const groups = [false, true].map((slides) => selected.filter((joint) => joint.slides === slides));
  return groups.flatMap((joints) => {
    if (joints.length === 0) return [];
    const unit = jointUnit(joints[0].slides, quantity);
    const styles = joints.map((joint) => curveStyle(all, joint));
    const limits = joints.flatMap((joint, i) =>
      limitsOf(joint, quantity).map((value) => ({
        value: value * unit.perUnit,
        colour: styles[i].colour,
      })),
    );
    return makePlot({
      name: quantity,
      title: `${quantity === "acceleration" ? "accel." : quantity} [${unit.name}]`,
      timeWindow,
      size,
      series: styles,
      limits,
      data: (from, to, count) => {
        const { time, values } = sampleCurves(joints, quantity, from, to, Math.round(count));
        const rows = values.map((row) => row.map((value) => value * unit.perUnit));
        return /** @type {uPlot.AlignedData} */ ([time, ...rows]);
      },
    });
  });
}

/**
 * Create the plot of the torques of the selected joints, as shares of their efforts.
 * @param {Plan} plan with torques
 * @param {Joint[]} selected
 * @param {import("./clock.js").TimeWindow} timeWindow
 * @param {Size} size
 */
export function torquePlot(plan, selected, timeWindow, size) {
  const { time, values, efforts } = /** @type {import("./types.js").Torques} */ (plan.torques);
  const rows = selected.map((joint) => plan.joints.indexOf(joint));
  const shares = rows.map((row) => values[row].map((value) => (100 * value) / efforts[row]));
  return makePlot({
    name: "torque",
    title: "torque [% effort]",
    timeWindow,
    size,
    series: selected.map((joint) => curveStyle(plan.joints, joint)),
    limits: [-100, 100].map((value) => ({ value, colour: colour("muted") })),
    data: () => /** @type {uPlot.AlignedData} */ ([time, ...shares]),
  });
}

/** Curves of the tools, and the names of what each draws per arm. */
export const TOOLS = /** @type {Object<string, string[]>} */ ({ "tool speed": ["speed"], "tool path": ["x", "y", "z"] });

/**
 * Create the plot of the speed of the tool centre points, or of their coordinates in the world.
 * @param {Plan} plan
 * @param {string} name of TOOLS
 * @param {import("./clock.js").TimeWindow} timeWindow
 * @param {Size} size
 */
export function toolPlot(plan, name, timeWindow, size) {
  const arms = armsOf(plan);
  const isSpeed = name === "tool speed";
  const cap = plan.report.tool_speed_cap;
  return makePlot({
    name,
    title: isSpeed ? "tool [mm/s]" : "tool [mm]",
    timeWindow,
    size,
    fromZero: isSpeed,
    series: arms.flatMap((arm) => TOOLS[name].map((_, k) => ({ colour: colour(`${arm}-trace`), dash: DASHES[k] }))),
    limits: isSpeed && cap ? [{ value: cap * 1e3, colour: colour("muted") }] : [],
    data: (from, to, count) => {
      const times = Array.from({ length: count }, (_, i) => from + ((to - from) * i) / (count - 1));
      const states = times.map((time) => arms.map((arm) => toolState(plan, arm, time)));
      const values = (/** @type {ReturnType<typeof toolState>} */ { xyz, speed }) => (isSpeed ? [speed] : xyz);
      const rows = arms.flatMap((_, a) => TOOLS[name].map((_, k) => states.map((state) => values(state[a])[k] * 1e3)));
      return /** @type {uPlot.AlignedData} */ ([times, ...rows]);
    },
  });
}

/**
 * Create the plot of the clearances over time.
 * @param {Plan} plan with clearances
 * @param {import("./clock.js").TimeWindow} timeWindow
 * @param {Size} size
 * @returns {Plot}
 */
export function clearancePlot(plan, timeWindow, size) {
  const times = Float64Array.from(new Set(plan.clearances.flatMap(({ time }) => [...time]))).sort();
  const curves = plan.clearances.map((clearance) => times.map((time) => clearanceAt(clearance, time).distance * 1e3));
  const required = new Set(plan.clearances.flatMap((clearance) => clearance.required.filter((r) => r > 0)));
  return makePlot({
    name: "clearance",
    title: "clearance [mm]",
    timeWindow,
    size,
    fromZero: true,
    series: plan.clearances.map((clearance) => ({ colour: colour(clearanceColour(clearance)), dash: [] })),
    limits: [...required].map((value) => ({ value: value * 1e3, colour: colour("clearance") })),
    data: () => [times, ...curves],
  });
}
