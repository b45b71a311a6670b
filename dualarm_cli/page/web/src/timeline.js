// Timeline: Gantt chart and curves on a common time axis with one cursor.

import { DASHES, colour } from "./colours.js";
import { TOOLS, clearancePlot, curveStyle, jointPlots, toolPlot, torquePlot } from "./curves.js";
import { armsOf } from "./data.js";
import { button, element, lineSample, toggle } from "./dom.js";
import { GUTTER, Gantt, LEGEND, MARGIN, drawLegendEntry, scaled } from "./gantt.js";
import { jointLabel } from "./labels.js";
import { QUANTITIES, countUpTo, stateAt } from "./trajectory.js";
import { fixed, jointValue, millimetres } from "./units.js";
import { clearanceAt, clearanceColour } from "./clearance.js";
import { stageWhy } from "./why.js";

/** @typedef {import("./types.js").Plan} Plan */
/** @typedef {import("./trajectory.js").Quantity} Quantity */

/**
 * Select the initially displayed joints: the most frequent bottleneck of each group, or its first joint.
 * @param {Plan} plan
 * @returns {string[]}
 */
export function firstJoints(plan) {
  const byFrequency = Object.entries(plan.report.bottlenecks ?? {}).sort((a, b) => b[1] - a[1]);
  const groups = [...new Set(plan.joints.map((joint) => joint.group))];
  return groups.flatMap((group) => {
    const names = plan.joints.filter((joint) => joint.group === group).map((joint) => joint.name);
    return byFrequency.find(([name]) => names.includes(name))?.[0] ?? names[0] ?? [];
  });
}

/** Descriptions of the clearances. */
const DESCRIPTIONS = /** @type {Object<string, string>} */ ({
  clearance: "Smallest distance between arms, tools, parts and obstacles",
  "near links": "Smallest distance between the robot's own bodies with at most three joints between them: it depends on these joints alone",
});

/** Printed width [px]. */
const PAPER = 740;
/** Limits of the height of a plot [px]. */
const MIN_HEIGHT = scaled(78);
const MAX_HEIGHT = scaled(400);

/** Describe a bar, and why it takes as long as it does. @param {import("./gantt_layout.js").Bar} bar */
const barText = (bar) => [bar.text, bar.why?.()].filter(Boolean).join("\n");

/** Gantt chart and curves with their selection. */
export class Timeline {
  /**
   * @param {Plan} plan
   * @param {import("./clock.js").Clock} clock
   * @param {import("./clock.js").TimeWindow} timeWindow
   */
  constructor(plan, clock, timeWindow) {
    this.plan = plan;
    this.clock = clock;
    this.timeWindow = timeWindow;
    this.gantt = new Gantt(plan, timeWindow);
    this.joints = firstJoints(plan);
    /** @type {string[]} */
    this.quantities = ["velocity", ...(plan.clearances.length ? ["clearance"] : [])];
    /** @type {import("./curves.js").Plot[]} */
    this.plots = [];
    this.folded = false;
    this.cursor = element("div", { class: "cursor" });
    this.hint = element("div", { class: "hint", role: "status", hidden: true });
    this.plotArea = element("div", { class: "plots" });
    const keys = "Gantt chart. Up and down step through stages, tasks or events; the hint says why each takes as long as it does";
    this.stack = element("div", { class: "stack", tabindex: 0, role: "group", "aria-label": keys }, this.gantt.canvas, this.plotArea, this.cursor);
    this.scroll = element("div", { class: "timeline-scroll" }, this.stack);
    this.legend = this.makeLegend();
    this.choices = element("div", { class: "choices" });
    this.chosen = element("div", { class: "chosen" });
    /** @type {Map<string, HTMLElement>} */
    this.readings = new Map();
    this.head = element("div", { class: "timeline-head" }, this.choices, this.chosen, this.legend);
    this.element = element(
      "section",
      { class: "timeline", "aria-label": "Timeline" },
      this.head,
      this.scroll,
      this.hint,
    );
    this.makeChoices();
    this.listen();
    clock.onChange(() => this.moveCursor());
    timeWindow.onChange(() => this.redraw());
    new ResizeObserver(() => this.resize()).observe(this.scroll);
  }

  /** Show the Gantt chart alone, or the curves too. @param {boolean} folded */
  setFolded(folded) {
    this.folded = folded;
    this.rebuild();
  }

  /**
   * Show a time axis of a length, and the curves of joints that this robot has.
   * @param {number} longest s
   * @param {string[]} joints
   */
  align(longest, joints) {
    if (this.timeWindow.duration !== longest) {
      this.timeWindow.duration = longest;
      this.timeWindow.showAll();
    }
    const known = joints.filter((name) => this.plan.joints.some((joint) => joint.name === name));
    if (known.length === 0 || known.join() === this.joints.join()) return;
    this.joints = known;
    for (const node of this.choices.querySelectorAll(".joint")) node.setAttribute("aria-pressed", String(known.includes(node.dataset.joint)));
    this.rebuild();
  }

  makeLegend() {
    const used = new Set(this.gantt.rows.flatMap((row) => row.bars.map((b) => `${b.kind} ${b.family}`)));
    const kinds = new Set(this.gantt.rows.flatMap((row) => row.bars.flatMap((b) => [b.kind, ...(b.critical ? ["critical"] : [])])));
    const entries = LEGEND.filter(({ label, bar }) => {
      const general = ["approach", "retract", "transfer", "wait", "return", "critical"].includes(bar.kind);
      return general ? kinds.has(bar.kind) : used.has(`${bar.kind} ${bar.family}`);
    });
    return element(
      "div",
      { class: "legend" },
      ...entries.map(({ label, bar }) => {
        const canvas = element("canvas", { class: "swatch" });
        canvas.entry = bar;
        return element("span", {}, canvas, label);
      }),
    );
  }

  makeChoices() {
    const names = [...QUANTITIES, ...(this.plan.torques ? ["torque"] : []), ...Object.keys(TOOLS), ...(this.plan.clearances.length ? ["clearance"] : [])];
    const quantities = names.map((name) =>
      toggle(name, `Show ${name} over time`, this.quantities.includes(name), (on) => {
        this.quantities = names.filter((n) => (n === name ? on : this.quantities.includes(n)));
        this.rebuild();
      }),
    );
    const joints = this.plan.joints.map((joint) => {
      const reading = element("span", { class: "reading" });
      this.readings.set(joint.name, reading);
      const node = toggle(jointLabel(this.plan.joints, joint.name), `Curves of ${joint.name}`, this.joints.includes(joint.name), (on) => {
        this.joints = on
          ? [...this.joints, joint.name]
          : this.joints.filter((name) => name !== joint.name);
        this.rebuild();
      });
      node.classList.add("joint");
      node.dataset.joint = joint.name;
      node.append(reading);
      return node;
    });
    this.choices.append(
      element("div", { class: "group", role: "group", "aria-label": "Curves" }, ...quantities),
      element(
        "details",
        { class: "joints", ontoggle: () => this.showReadings() },
        element("summary", { title: "Select joints" }, "joints"),
        element("div", { class: "joint-list" }, ...joints),
      ),
      button("all", "Show the whole plan (0)", () => this.timeWindow.showAll()),
    );
  }

  listen() {
    const { stack, timeWindow } = this;
    stack.addEventListener(
      "wheel",
      (/** @type {WheelEvent} */ event) => {
        if (event.altKey) return;
        event.preventDefault();
        const length = timeWindow.to - timeWindow.from;
        if (event.shiftKey || Math.abs(event.deltaX) > Math.abs(event.deltaY)) {
          const by = ((event.deltaX || event.deltaY) / stack.clientWidth) * length;
          timeWindow.show(timeWindow.from + by, timeWindow.to + by);
        } else {
          timeWindow.zoom(this.timeAt(event), Math.exp(event.deltaY * 0.0015));
        }
      },
      { passive: false },
    );
    /** @type {{x: number, from: number, to: number, scrubs: boolean, moved: boolean} | null} */
    let drag = null;
    stack.addEventListener("pointerdown", (/** @type {PointerEvent} */ event) => {
      this.hint.hidden = true;
      if (event.button !== 0) return;
      const y = event.clientY - stack.getBoundingClientRect().top;
      drag = { x: event.clientX, from: timeWindow.from, to: timeWindow.to, scrubs: y < this.gantt.head, moved: false };
      stack.setPointerCapture(event.pointerId);
      if (drag.scrubs) this.clock.setTime(this.timeAt(event));
    });
    stack.addEventListener("pointermove", (/** @type {PointerEvent} */ event) => {
      if (!drag) return this.showHint(event);
      if (Math.abs(event.clientX - drag.x) > 3) drag.moved = true;
      if (drag.scrubs) {
        this.clock.setTime(this.timeAt(event));
      } else if (drag.moved) {
        const width = stack.clientWidth - GUTTER - MARGIN;
        const by = ((drag.x - event.clientX) / width) * (drag.to - drag.from);
        timeWindow.show(drag.from + by, drag.to + by);
      }
    });
    stack.addEventListener("pointerup", (/** @type {PointerEvent} */ event) => {
      if (drag && !drag.moved) {
        this.clock.setTime(this.timeAt(event));
        this.showHint(event);
      }
      drag = null;
    });
    stack.addEventListener("pointercancel", () => (drag = null));
    // What a tap shows stays until the next one.
    stack.addEventListener("pointerleave", (/** @type {PointerEvent} */ event) => (this.hint.hidden ||= event.pointerType !== "touch"));
    document.addEventListener("pointerdown", (event) => (this.hint.hidden ||= !stack.contains(/** @type {Node} */ (event.target))));
    stack.addEventListener("focus", () => this.showHintAtCursor());
    stack.addEventListener("blur", () => (this.hint.hidden = true));
    stack.addEventListener("dblclick", (/** @type {MouseEvent} */ event) => {
      const time = this.timeAt(event);
      const stage = this.plan.stages.find((s) => s.start <= time && time <= s.end);
      if (stage) {
        const margin = 0.25 * (stage.end - stage.start);
        timeWindow.show(stage.start - margin, stage.end + margin);
      }
    });
  }

  /** @param {MouseEvent} event @returns {number} s */
  timeAt(event) {
    const box = this.stack.getBoundingClientRect();
    const fraction = (event.clientX - box.left - GUTTER) / (box.width - GUTTER - MARGIN);
    return this.timeWindow.from + fraction * (this.timeWindow.to - this.timeWindow.from);
  }

  /** @param {PointerEvent} event */
  showHint(event) {
    const box = this.gantt.canvas.getBoundingClientRect();
    const [time, y] = [this.timeAt(event), event.clientY - box.top];
    const stage = this.gantt.stageAt(time, y);
    const bar = this.gantt.barAt(time, y);
    const text = stage >= 0 ? stageWhy(this.plan, stage) : bar ? barText(bar) : "";
    const frame = this.element.getBoundingClientRect();
    this.placeHint(text, event.clientX - frame.left + 12, event.clientY - frame.top + 16);
  }

  /** Explain what happens at the time cursor, for readers with a keyboard. */
  showHintAtCursor() {
    if (!this.stack.matches(":focus-visible")) return;
    const { time } = this.clock;
    const stages = this.plan.stages.flatMap((stage, i) => (stage.start <= time && time < stage.end ? [stageWhy(this.plan, i)] : []));
    const bars = this.gantt.rows.flatMap((row) => row.bars.filter((bar) => bar.start <= time && time < bar.end).map(barText));
    const frame = this.element.getBoundingClientRect();
    const box = this.gantt.canvas.getBoundingClientRect();
    const text = [...stages, ...bars].join("\n");
    const left = this.gantt.x(time) + box.left - frame.left + 12;
    this.placeHint(text, left, 0);
    this.placeHint(text, left, box.top - frame.top - this.hint.offsetHeight - 4); // above the chart, whose keys go on
  }

  /** @param {string} text hidden if empty @param {number} left px @param {number} top px */
  placeHint(text, left, top) {
    this.hint.hidden = !text;
    if (!text) return;
    if (this.hint.textContent !== text) this.hint.textContent = text;
    const frame = this.element.getBoundingClientRect();
    this.hint.style.left = `${Math.max(Math.min(left, frame.width - this.hint.offsetWidth - 8), 4)}px`;
    this.hint.style.top = `${Math.min(top, innerHeight - frame.top - this.hint.offsetHeight - 4)}px`;
  }

  /** Rebuild the plots after a change of curves or colours. */
  rebuild() {
    for (const plot of this.plots) plot.destroy();
    const size = this.plotSize();
    const selected = this.joints.map((name) => this.joint(name));
    this.plots = (this.folded ? [] : this.quantities).flatMap((name) =>
      name === "clearance"
        ? [clearancePlot(this.plan, this.timeWindow, size)]
        : name in TOOLS
          ? [toolPlot(this.plan, name, this.timeWindow, size)]
          : name === "torque"
            ? [torquePlot(this.plan, selected, this.timeWindow, size)]
            : jointPlots(/** @type {Quantity} */ (name), selected, this.plan.joints, this.timeWindow, size),
    );
    this.plotArea.replaceChildren(...this.plots.map((plot) => plot.element));
    this.showSelected();
  }

  /** @param {string} name */
  joint(name) {
    return /** @type {import("./types.js").Joint} */ (this.plan.joints.find((joint) => joint.name === name));
  }

  showSelected() {
    /** @type {{joint?: import("./types.js").Joint, clearance?: import("./types.js").Clearance, reading: HTMLElement, element: HTMLElement}[]} */
    this.selectedReadings = this.joints.map((name) => {
      const joint = this.joint(name);
      const { colour: stroke, dash } = curveStyle(this.plan.joints, joint);
      const reading = element("span", { class: "reading" });
      return { joint, reading, element: element("span", { class: "curve" }, lineSample(stroke, dash), jointLabel(this.plan.joints, name), reading) };
    });
    for (const clearance of this.quantities.includes("clearance") ? this.plan.clearances : []) {
      const reading = element("span", { class: "reading" });
      const line = lineSample(colour(clearanceColour(clearance)), []);
      const node = element("span", { class: "curve", title: DESCRIPTIONS[clearance.name] }, line, clearance.name, reading);
      this.selectedReadings.push({ clearance, reading, element: node });
    }
    for (const [name, parts] of Object.entries(TOOLS).filter(([name]) => this.quantities.includes(name))) {
      for (const arm of armsOf(this.plan)) {
        const lines = parts.flatMap((part, k) => [lineSample(colour(`${arm}-trace`), DASHES[k]), part]);
        this.selectedReadings.push({ reading: element("span"), element: element("span", { class: "curve", title: `${name} of the ${arm} arm` }, ...lines, ` ${arm}`) });
      }
    }
    this.chosen.replaceChildren(...this.selectedReadings.map((entry) => entry.element));
    this.showReadings();
  }

  showReadings() {
    const quantities = QUANTITIES.filter((name) => this.quantities.includes(name));
    const quantity = quantities[0] ?? "position";
    for (const { joint, clearance, reading } of this.selectedReadings ?? []) {
      if (joint && this.plan.torques && !quantities.length && this.quantities.includes("torque")) {
        const { time, values } = this.plan.torques;
        const k = Math.max(countUpTo(time, this.clock.time) - 1, 0);
        const torque = values[this.plan.joints.indexOf(joint)][k];
        reading.textContent = `${fixed(torque, 2)} ${joint.slides ? "N" : "N m"}`;
      } else if (joint) {
        const value = stateAt(joint.knots, this.clock.time)[quantity];
        reading.textContent = jointValue(value, joint.slides, quantity);
      } else if (clearance) {
        reading.textContent = millimetres(clearanceAt(clearance, this.clock.time).distance);
      }
    }
    if (!this.choices.querySelector("details")?.open) return;
    for (const joint of this.plan.joints) {
      const { position } = stateAt(joint.knots, this.clock.time);
      const reading = /** @type {HTMLElement} */ (this.readings.get(joint.name));
      reading.textContent = jointValue(position, joint.slides, "position");
    }
  }

  /** Compute the size of a plot: all plots fill the height below the Gantt chart, within limits. */
  plotSize() {
    const space = this.scroll.clientHeight - this.gantt.height - 4;
    const height = Math.floor(space / Math.max(this.quantities.length, 1));
    return {
      width: this.stack.clientWidth,
      height: Math.min(Math.max(height, MIN_HEIGHT), MAX_HEIGHT),
    };
  }

  /**
   * Draw at the width of paper, or of the screen again.
   * @param {boolean} paper
   */
  print(paper) {
    this.stack.style.width = paper ? `${PAPER}px` : "";
    this.resize();
  }

  resize() {
    const { width, height } = this.plotSize();
    if (width <= GUTTER + MARGIN) return;
    if (width !== this.gantt.width) this.gantt.resize(width);
    for (const plot of this.plots) plot.resize(width, height);
    this.moveCursor();
  }

  /** Draw in the colours of the current theme. */
  recolour() {
    for (const canvas of this.legend.querySelectorAll("canvas")) drawLegendEntry(canvas, canvas.entry);
    this.gantt.draw();
    this.rebuild();
  }

  redraw() {
    this.gantt.draw();
    for (const plot of this.plots) plot.update();
    this.moveCursor();
  }

  moveCursor() {
    const { time } = this.clock;
    const inside = time >= this.timeWindow.from - 1e-9 && time <= this.timeWindow.to + 1e-9;
    this.cursor.hidden = !inside;
    if (inside) this.cursor.style.transform = `translateX(${this.gantt.x(time)}px)`;
    this.showHintAtCursor();
    this.showReadings();
  }
}
