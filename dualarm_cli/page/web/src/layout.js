// Layout of the page: the divider above the timeline, the folded parts, and what a reader left of them.

import { element } from "./dom.js";

/** Size classes of windows, each with its own choices in the browser's storage. */
export const PHONE = "(max-width: 700px), (max-height: 480px)";
const CLASSES = { phone: PHONE, large: "(min-width: 1500px) and (min-height: 900px)" };
/** Least heights of the timeline and of all above it [px], and steps of the arrow keys. */
const MIN_TIMELINE = 120;
const MIN_UPPER = 240;
const STEP = 16;
const LARGE_STEP = 80;
/** Windows in which curves, and the report, are shown at first. */
const ROOM = { curves: "(min-height: 900px) and (min-width: 701px)", report: "(min-height: 700px) and (min-width: 1500px)" };

/** @typedef {{height?: number, curves?: boolean, report?: boolean}} Choices */

/** Return the storage key of the window's size class. */
const key = () => `dualarm.layout.${Object.entries(CLASSES).find(([, query]) => matchMedia(query).matches)?.[0] ?? "medium"}`;

/** @returns {Choices} what was chosen before; nothing where the browser keeps nothing for files */
function stored() {
  try {
    const choices = JSON.parse(localStorage.getItem(key()) ?? "{}");
    return typeof choices === "object" && choices !== null ? choices : {};
  } catch {
    return {};
  }
}

/** Sizes of the page's parts, remembered in this browser for each size class of windows. */
export class Layout {
  /**
   * @param {HTMLElement} root
   * @param {{setFolded: (folded: boolean) => void}} timeline
   */
  constructor(root, timeline) {
    this.root = root;
    this.timeline = timeline;
    /** @type {Choices} */
    this.choices = {};
    this.splitter = element("div", {
      class: "splitter", role: "separator", tabindex: 0, "aria-orientation": "horizontal", "aria-label": "Height of the timeline",
      title: "Drag, or use the arrow keys, to resize the timeline",
    });
    this.listen();
  }

  /** Apply the remembered choices, or those that fit the window. */
  apply() {
    this.choices = stored();
    for (const part of /** @type {const} */ (["curves", "report"])) {
      this.fold(part, this.choices[part] ?? matchMedia(ROOM[part]).matches);
    }
    this.setHeight(typeof this.choices.height === "number" ? this.choices.height : undefined);
  }

  /**
   * Show or hide the curves or the report.
   * @param {"curves" | "report"} part
   * @param {boolean} shown
   */
  fold(part, shown) {
    this.root.classList.toggle(`no-${part}`, !shown);
    if (part === "curves") this.timeline.setFolded(!shown);
    for (const node of this.root.querySelectorAll(`[data-part="${part}"]`)) node.setAttribute("aria-pressed", String(shown));
  }

  /**
   * Create the button that shows or hides a part.
   * @param {"curves" | "report"} part
   * @param {string} title
   * @returns {HTMLElement}
   */
  button(part, title) {
    const press = () => {
      this.fold(part, this.root.classList.contains(`no-${part}`));
      if (part === "curves") this.setHeight(undefined);
      this.remember({ [part]: !this.root.classList.contains(`no-${part}`) });
    };
    return element("button", { type: "button", title, "data-part": part, "aria-pressed": "false", onclick: press }, part);
  }

  /** @param {Choices} choices */
  remember(choices) {
    this.choices = { ...this.choices, ...choices };
    try {
      localStorage.setItem(key(), JSON.stringify(this.choices));
    } catch {
      // A browser that stores nothing for this page starts as at first.
    }
  }

  /** Set the height of the timeline, or its natural height. @param {number | undefined} height px */
  setHeight(height) {
    if (height === undefined) {
      this.root.style.removeProperty("--timeline-height");
      delete this.choices.height;
    } else {
      const most = Math.max(window.innerHeight - MIN_UPPER, MIN_TIMELINE);
      const kept = Math.round(Math.min(Math.max(height, MIN_TIMELINE), most));
      this.root.style.setProperty("--timeline-height", `${kept}px`);
      this.choices.height = kept;
    }
    this.announce();
  }

  /** Height of the timeline [px]. */
  get height() {
    return this.splitter.nextElementSibling?.getBoundingClientRect().height ?? 0;
  }

  /** Tell the divider's position to screen readers. */
  announce() {
    const most = Math.max(window.innerHeight - MIN_UPPER, MIN_TIMELINE);
    const values = { now: Math.round(this.height), min: MIN_TIMELINE, max: most };
    for (const [name, value] of Object.entries(values)) this.splitter.setAttribute(`aria-value${name}`, String(value));
  }

  listen() {
    const { splitter } = this;
    for (const query of Object.values(CLASSES)) matchMedia(query).addEventListener("change", () => this.apply());
    splitter.addEventListener("pointerdown", (/** @type {PointerEvent} */ event) => {
      splitter.setPointerCapture(event.pointerId);
      const move = (/** @type {PointerEvent} */ e) => this.setHeight(window.innerHeight - e.clientY);
      splitter.addEventListener("pointermove", move);
      const stop = () => {
        splitter.removeEventListener("pointermove", move);
        this.remember({});
      };
      splitter.addEventListener("lostpointercapture", stop, { once: true });
    });
    const jumps = /** @type {Object<string, number>} */ ({ ArrowUp: 1, ArrowDown: -1, PageUp: 5, PageDown: -5, Home: Infinity, End: -Infinity });
    splitter.addEventListener("keydown", (/** @type {KeyboardEvent} */ event) => {
      const jump = jumps[event.key];
      if (jump === undefined || event.ctrlKey || event.metaKey || event.altKey) return;
      event.preventDefault();
      event.stopPropagation();
      this.setHeight(this.height + jump * (event.shiftKey ? LARGE_STEP : STEP));
      this.remember({});
    });
  }
}
