// Playback controls, and the current segment of each arm.

import { neighbour, SPEEDS } from "./clock.js";
import { button, element } from "./dom.js";
import { armsOf } from "./data.js";
import { copyLink } from "./playing.js";
import { segmentsAt, workText } from "./gantt_layout.js";
import { eventText, fixed } from "./units.js";

/** @typedef {import("./types.js").Plan} Plan */

/**
 * Return the times that steps lead to.
 * @param {Plan} plan
 * @param {string} kind stage, task or event
 * @returns {number[]}
 */
export function stepTimes(plan, kind) {
  if (kind === "event") return [...new Set(plan.events.map((event) => event.time))];
  if (kind === "stage") return [...new Set([...plan.stages.map((stage) => stage.start), plan.duration])];
  /** @type {Map<string, number>} */
  const first = new Map();
  for (const { task, start } of plan.segments) {
    if (task) first.set(task, Math.min(start, first.get(task) ?? Infinity));
  }
  return [...new Set([...first.values(), plan.duration])];
}

/** Row of playback controls below the 3-D view. */
export class Transport {
  /**
   * @param {Plan} plan
   * @param {import("./clock.js").Clock} clock
   * @param {import("./clock.js").TimeWindow} timeWindow
   */
  constructor(plan, clock, timeWindow) {
    this.plan = plan;
    this.clock = clock;
    this.timeWindow = timeWindow;
    this.kind = "stage";
    this.statusKey = "none";
    this.times = stepTimes(plan, this.kind);
    this.play = button("", "Play or pause (space)", () => clock.toggle(), { class: "play" });
    this.readout = element("output", { class: "time" });
    this.scrub = element("input", {
      type: "range", min: 0, max: plan.duration, step: "any", "aria-label": "Time", class: "scrub",
      oninput: () => clock.setTime(Number(this.scrub.value)),
    });
    this.speeds = element(
      "select",
      { "aria-label": "Speed", title: "Speed (−, +)", onchange: () => clock.setSpeed(Number(this.speeds.value)) },
      ...SPEEDS.map((speed) => element("option", { value: speed, selected: speed === 1 }, `× ${speed}`)),
    );
    this.kinds = element(
      "select",
      { class: "kinds", "aria-label": "Step to", title: "Step to (s, t, e)", onchange: () => this.setKind(this.kinds.value) },
      ...["stage", "task", "event"].map((kind) => element("option", { value: kind }, kind)),
    );
    this.jump = element(
      "select",
      { class: "jump", "aria-label": "Go to a task", title: "Go to a task", onchange: () => this.goToTask() },
      element("option", { value: "" }, "go to task …"),
      ...plan.events.map((event, i) => element("option", { value: i }, eventText(event))),
    );
    this.link = button("link", "Copy the link to this instant (l)", () => this.copyLink(), { class: "link" });
    this.element = element(
      "div",
      { class: "transport", role: "group", "aria-label": "Playback" },
      this.play,
      button("|◀", "Previous (↓)", () => this.step(-1)),
      button("▶|", "Next (↑)", () => this.step(1)),
      this.kinds,
      this.readout,
      this.scrub,
      this.speeds,
      this.jump,
      this.link,
      element("small", { class: "keys" }, element("kbd", {}, "Space"), " play ", element("kbd", {}, "←"), element("kbd", {}, "→"), " step ", element("kbd", {}, "?"), " keys"),
    );
    this.status = element("div", { class: "status" });
    clock.onChange(() => this.update());
    this.update();
  }

  /** @param {string} kind */
  setKind(kind) {
    this.kind = kind;
    this.kinds.value = kind;
    this.times = stepTimes(this.plan, kind);
  }

  /** @param {1 | -1} direction */
  step(direction) {
    this.go(neighbour(this.times, this.clock.time, direction));
  }

  goToTask() {
    if (this.jump.value !== "") this.go(this.plan.events[Number(this.jump.value)].time);
    this.jump.value = "";
  }

  copyLink() {
    copyLink(this.clock, (text) => {
      this.link.textContent = text;
      setTimeout(() => (this.link.textContent = "link"), 2000);
    });
  }

  /** @param {number} time */
  go(time) {
    this.clock.setTime(time);
    this.timeWindow.reveal(time);
  }

  /** @param {1 | -1} direction */
  changeSpeed(direction) {
    const i = SPEEDS.indexOf(this.clock.speed) + direction;
    if (i >= 0 && i < SPEEDS.length) this.clock.setSpeed(SPEEDS[i]);
    this.speeds.value = String(this.clock.speed);
  }

  update() {
    const { clock } = this;
    const text = clock.playing ? "❚❚" : "▶";
    if (this.play.textContent !== text) this.play.textContent = text;
    this.readout.textContent = `${fixed(clock.time, 3)} / ${fixed(this.plan.duration, 3)} s`;
    this.scrub.value = String(clock.time);
    this.showStatus();
  }

  showStatus() {
    const now = segmentsAt(this.plan, this.clock.time);
    const key = armsOf(this.plan).map((arm) => now[arm]?.start).join();
    if (key === this.statusKey) return;
    this.statusKey = key;
    const rows = armsOf(this.plan).map((arm) => {
      return element("div", {}, element("b", { class: `arm-${arm}` }, arm), this.workOf(arm));
    });
    this.status.replaceChildren(...rows);
  }

  /** Describe what an arm does now. @param {string} arm */
  workOf(arm) {
    const segment = segmentsAt(this.plan, this.clock.time)[arm];
    return segment ? workText(this.plan, segment) : "–";
  }
}
