// Tabs with the panels of the report; on paper the overview and the open panel are shown.

import { element } from "./dom.js";
import { levers } from "./levers.js";
import { checks, limits, notes, overview, stages, waits } from "./panels.js";

/** @typedef {import("./types.js").Plan} Plan */

const TABS = [
  { name: "Overview", panel: overview },
  { name: "Stages", panel: stages },
  { name: "Waits", panel: waits },
  { name: "Joints", panel: limits },
  { name: "Levers", panel: levers },
  { name: "Checks", panel: checks },
  { name: "Notes", panel: notes },
];

/** Report next to the 3-D view. */
export class ReportView {
  /**
   * @param {Plan} plan
   * @param {import("./clock.js").Clock} clock
   */
  constructor(plan, clock) {
    this.plan = plan;
    const go = (/** @type {number} */ time) => clock.setTime(time);
    this.panels = TABS.map(({ name, panel }) =>
      element("div", { class: `panel panel-${name.toLowerCase()}`, role: "tabpanel", "aria-label": name }, element("h2", {}, name), ...panel(plan, go)),
    );
    this.tabs = TABS.map(({ name }, i) =>
      element("button", { type: "button", role: "tab", onclick: () => this.select(i) }, name),
    );
    this.element = element(
      "section",
      { class: "report", "aria-label": "Report" },
      element("div", { class: "tabs", role: "tablist" }, ...this.tabs),
      element("div", { class: "panels" }, ...this.panels),
    );
    /** @type {string | undefined} */
    this.current = undefined;
    this.time = 0;
    this.rows = [...this.panels[1].querySelectorAll("tbody tr")];
    this.select(0);
    clock.onChange(() => this.mark(clock.time));
    this.mark(0);
  }

  /** Select a tab. @param {number} number index of the tab */
  select(number) {
    this.tabs.forEach((tab, i) => tab.setAttribute("aria-selected", String(i === number)));
    this.panels.forEach((panel, i) => panel.classList.toggle("selected", i === number));
    this.current = undefined;
    this.mark(this.time);
  }

  /** Mark the stages at a time. @param {number} time s */
  mark(time) {
    this.time = time;
    const now = this.plan.stages.flatMap((stage, i) => (stage.start <= time && time < stage.end ? [i] : []));
    const key = now.join();
    if (key === this.current) return;
    this.current = key;
    this.rows?.forEach((row, i) => row.classList.toggle("now", now.includes(i)));
    const row = this.rows?.[now[0]];
    if (!row || !this.panels[1].classList.contains("selected")) return;
    const box = row.closest(".panels");
    const top = row.offsetTop;
    if (box && (top < box.scrollTop + 40 || top > box.scrollTop + box.clientHeight - 40)) {
      box.scrollTop = top - box.clientHeight / 2;
    }
  }
}
