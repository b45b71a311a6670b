// Entry point of the page: data, views, and the time cursor that they share.

import "uplot/dist/uPlot.min.css";
import "./page.css";
import { Clock, TimeWindow } from "./clock.js";
import { colour, themes } from "./colours.js";
import { clearanceAt, clearanceColour } from "./clearance.js";
import { readPlan, unfit } from "./data.js";
import { button, element, toggle } from "./dom.js";
import { helpOverlay, listenToKeys } from "./keyboard.js";
import { Layout } from "./layout.js";
import { assumed, limiting, verdict } from "./panels.js";
import { begin, largePlayButton } from "./playing.js";
import { compose, forwardKinematics } from "./poses.js";
import { ReportView } from "./report_view.js";
import { Scene } from "./scene.js";
import { still } from "./still.js";
import { Timeline } from "./timeline.js";
import { Transport } from "./transport.js";
import { positionsAt } from "./trajectory.js";
import { fixed, millimetres, seconds } from "./units.js";

/** @typedef {import("./types.js").Plan} Plan */

/** Size of a saved picture [px]. */
const PICTURE = { width: 1920, height: 1080 };
/** Steps of the arrow keys [s]. */
const SMALL_STEP = 0.05;
const LARGE_STEP = 0.5;

/** Build the page. @param {HTMLElement} root */
function start(root) {
  const plan = readPlan(document.getElementById("data")?.textContent ?? "");
  const clock = new Clock(plan.duration, plan.closes);
  const timeWindow = new TimeWindow(plan.duration);
  const timeline = new Timeline(plan, clock, timeWindow);
  const transport = new Transport(plan, clock, timeWindow);
  const report = new ReportView(plan, clock);
  const stage = element("div", { class: "stage" });
  const nearest = element("div", { class: "nearest" }, ...plan.clearances.map((clearance) => element("div", { class: clearanceColour(clearance) })));
  const viewBar = element("div", { class: "view-bar" });
  const drawn = element("small", { class: "drawn" }, "Drawings", element("span", {}, ": robot, grippers, trays, stands"), "; ‘checked’ shows the collision shapes");
  const viewer = element("section", { class: "viewer", "aria-label": "3-D view" }, stage, transport.status, nearest, drawn, viewBar);

  const theme = themes(() => {
    timeline.recolour();
    scene?.recolour(colour);
  });
  const layout = new Layout(root, timeline);
  const commands = makeCommands({ clock, timeWindow, transport, theme, fit: () => scene?.fit(), help: () => help.showModal() });
  const help = helpOverlay(commands);
  timeline.head.prepend(layout.button("curves", "Curves of joints, tools and clearances"));
  root.replaceChildren(
    header(plan, layout.button("report", "Figures, stages, waits, checks and notes"), () => theme.toggle(), () => help.showModal()),
    element("main", {}, element("div", { class: "upper" }, viewer, report.element), transport.element, layout.splitter, timeline.element),
    help,
  );
  layout.apply();

  const stillOf = (/** @type {Scene} */ shown, /** @type {{width: number, height: number, bare?: boolean}} */ size) => still(plan, shown, (arm) => transport.workOf(arm), size);
  const scene = makeScene(plan, stage);
  if (scene) {
    viewer.append(largePlayButton(clock));
    viewBar.append(...viewButtons(scene, () => save(stillOf(scene, PICTURE).toDataURL(), `${plan.title}.png`)));
    clock.onChange(() => scene.setTime(clock.time));
    nameSolids(scene, stage);
  }
  const showNearest = () => {
    plan.clearances.forEach((clearance, i) => {
      const { pair, distance } = clearanceAt(clearance, clock.time);
      const label = clearance.name === "clearance" ? "closest" : clearance.name;
      nearest.children[i].textContent = `${label}: ${pair[0]} – ${pair[1]}, ${millimetres(distance)}`;
    });
  };
  clock.onChange(showNearest);
  showNearest();
  timeline.recolour();
  scene?.recolour(colour);
  listenToKeys(commands);
  printLight(theme, timeline, scene);
  run(clock);
  expose(plan, clock, timeline, scene && ((time, width, height, bare) => {
    clock.pause();
    clock.setTime(time);
    return stillOf(scene, { width, height, bare }).toDataURL("image/jpeg", 0.92);
  }));
  begin(clock);
}

/**
 * Print in the light theme at the width of the paper.
 * @param {ReturnType<typeof themes>} theme
 * @param {Timeline} timeline
 * @param {Scene | null} scene
 */
function printLight(theme, timeline, scene) {
  let before = theme.name();
  const image = element("img", { class: "paper", alt: "3-D view" });
  if (scene) scene.container.append(image);
  window.addEventListener("beforeprint", () => {
    before = theme.name();
    theme.set("light");
    timeline.print(true);
    if (scene) image.src = scene.picture();
  });
  window.addEventListener("afterprint", () => {
    timeline.print(false);
    theme.set(before === "dark" ? "dark" : "light");
  });
}

/**
 * Create the 3-D view, or a message and null if the browser cannot draw it.
 * @param {Plan} plan
 * @param {HTMLElement} stage
 */
function makeScene(plan, stage) {
  try {
    return new Scene(plan, stage);
  } catch (error) {
    if (error instanceof TypeError) throw error; // the data do not fit the program
    const text = "The 3-D view requires WebGL, which this browser does not support. The rest of the page works.";
    stage.append(element("p", { class: "missing" }, text, ` (${error instanceof Error ? error.message : error})`));
    return null;
  }
}

/** Create the buttons of the 3-D view. @param {Scene} scene @param {() => void} savePicture @returns {Node[]} */
function viewButtons(scene, savePicture) {
  const from = /** @type {(x: number, y: number, z: number) => () => void} */ ((x, y, z) => () => scene.fit([x, y, z]));
  return [
    button("fit", "Fit the whole cell into the view (f)", () => scene.fit()),
    button("top", "From above", from(-0.001, 0, 1)),
    button("front", "From the front", from(1, 0, 0.12)),
    button("side", "From the side", from(0, -1, 0.12)),
    toggle("traces", "Paths of the tools", true, (on) => scene.show("traces", on)),
    toggle("frames", "Frames of the tools", false, (on) => scene.show("frames", on)),
    toggle("closest", "Closest pairs", true, (on) => scene.show("pair", on)),
    toggle("skeleton", "Joints and links as a skeleton", false, (on) => scene.show("skeleton", on)),
    toggle("checked", "Collision shapes in place of the drawings", false, (on) => scene.show("checked", on)),
    button("picture", "Save this view as a picture (PNG)", savePicture),
  ];
}

/** Save a data URL as a file. @param {string} url @param {string} name */
function save(url, name) {
  element("a", { href: url, download: name }).click();
}

/**
 * Show the name of the object under the pointer beside it.
 * @param {Scene} scene
 * @param {HTMLElement} stage
 */
function nameSolids(scene, stage) {
  const hint = element("div", { class: "hint", hidden: true });
  stage.append(hint);
  let timer = 0;
  stage.addEventListener("pointermove", (event) => {
    clearTimeout(timer);
    hint.hidden = true;
    const box = stage.getBoundingClientRect();
    const [x, y] = [event.clientX - box.left, event.clientY - box.top];
    timer = window.setTimeout(() => {
      hint.textContent = event.buttons === 0 ? scene.nameAt(x, y) : "";
      hint.hidden = hint.textContent === "";
      hint.style.left = `${Math.min(x + 14, box.width - hint.offsetWidth - 8)}px`;
      hint.style.top = `${y + 14}px`;
    }, 80);
  });
  stage.addEventListener("pointerleave", () => {
    clearTimeout(timer);
    hint.hidden = true;
  });
}

/**
 * Create the header: what was planned, whether it holds, and what it rests on.
 * @param {Plan} plan
 * @param {HTMLElement} reportButton
 * @param {() => void} changeTheme
 * @param {() => void} help
 */
function header(plan, reportButton, changeTheme, help) {
  const { report } = plan;
  const { text, mark } = verdict(report);
  const hourly = report.parts_per_hour !== null && report.parts > 0 ? `${fixed(report.parts_per_hour, 0)} parts per hour` : null;
  return element(
    "header",
    {},
    element(
      "div",
      { class: "about" },
      element("h1", {}, plan.title),
      element("span", { class: "robot" }, plan.robot),
      element("span", { class: "cycle" }, seconds(report.cycle_time), report.closes ? " cycle" : ""),
      hourly && element("span", { class: "hourly" }, hourly),
      limiting(plan) && element("span", { class: "limiting" }, limiting(plan)),
      element("span", { class: `verdict ${mark}` }, text),
      assumed(report) && element("span", { class: "reservation" }, assumed(report)),
    ),
    element("span", { class: "version" }, `dualarm ${plan.version}`),
    element("span", { class: "buttons" }, reportButton, button("◐", "Dark or light (d)", changeTheme), button("?", "Keys and pointer (?)", help)),
  );
}

/**
 * Create the keyboard commands.
 * @param {{clock: Clock, timeWindow: TimeWindow, transport: Transport, theme: {toggle: () => void}, fit: () => void, help: () => void}} parts
 * @returns {import("./keyboard.js").Command[]}
 */
function makeCommands({ clock, timeWindow, transport, theme, fit, help }) {
  const move = (/** @type {number} */ sign) => (/** @type {KeyboardEvent} */ event) =>
    transport.go(clock.time + sign * (event.shiftKey ? LARGE_STEP : SMALL_STEP));
  const kind = (/** @type {string} */ name) => () => transport.setKind(name);
  return [
    { keys: [" "], label: "Space", text: "play or pause", action: () => clock.toggle() },
    { keys: ["ArrowLeft"], label: "←", text: "0.05 s back, 0.5 s with Shift", action: move(-1) },
    { keys: ["ArrowRight"], label: "→", text: "0.05 s forward, 0.5 s with Shift", action: move(1) },
    { keys: ["ArrowUp"], label: "↑", text: "next stage, task or event", action: () => transport.step(1) },
    { keys: ["ArrowDown"], label: "↓", text: "previous stage, task or event", action: () => transport.step(-1) },
    { keys: ["s"], label: "s", text: "↑ and ↓ step by stage", action: kind("stage") },
    { keys: ["t"], label: "t", text: "↑ and ↓ step by task", action: kind("task") },
    { keys: ["e"], label: "e", text: "↑ and ↓ step by event", action: kind("event") },
    { keys: ["Home"], label: "Home", text: "start", action: () => transport.go(0) },
    { keys: ["End"], label: "End", text: "end", action: () => transport.go(clock.duration) },
    { keys: ["+", "="], label: "+", text: "faster", action: () => transport.changeSpeed(1) },
    { keys: ["-"], label: "−", text: "slower", action: () => transport.changeSpeed(-1) },
    { keys: ["z"], label: "z", text: "timeline: zoom in at the cursor", action: () => timeWindow.zoom(clock.time, 0.5) },
    { keys: ["Z"], label: "Shift z", text: "timeline: zoom out", action: () => timeWindow.zoom(clock.time, 2) },
    { keys: ["0"], label: "0", text: "timeline: show the whole plan", action: () => timeWindow.showAll() },
    { keys: ["l"], label: "l", text: "copy the link to this instant", action: () => transport.copyLink() },
    { keys: ["f"], label: "f", text: "3-D view: fit the whole cell", action: fit },
    { keys: ["d"], label: "d", text: "dark or light", action: () => theme.toggle() },
    { keys: ["?"], label: "?", text: "this help", action: help },
  ];
}

/** Advance the clock with the animation frames of the browser. @param {Clock} clock */
function run(clock) {
  let last = performance.now();
  const step = (/** @type {number} */ now) => {
    clock.advance(Math.min((now - last) / 1e3, 0.25));
    last = now;
    requestAnimationFrame(step);
  };
  requestAnimationFrame(step);
}

/**
 * Expose the page to tests and to the console of the browser.
 * @param {Plan} plan
 * @param {Clock} clock
 * @param {Timeline} timeline
 * @param {((time: number, width: number, height: number, bare?: boolean) => string) | null} frame draws a still, or the view alone, as a data URL
 */
function expose(plan, clock, timeline, frame) {
  const page = {
    duration: plan.duration,
    ...(frame && { frame }),
    get joints() {
      return timeline.joints;
    },
    /** Show as much time, and the same joints, as a plan beside this one. */
    align: (/** @type {number} */ longest, /** @type {string[]} */ joints) => timeline.align(longest, joints),
    get time() {
      return clock.time;
    },
    setTime: (/** @type {number} */ time) => clock.setTime(time),
    play: () => clock.play(),
    pause: () => clock.pause(),
    jointPositions: () => {
      const positions = positionsAt(plan.joints, clock.time);
      return Object.fromEntries(plan.joints.map((joint, i) => [joint.name, positions[i]]));
    },
    toolPosition: (/** @type {string} */ arm) => {
      const poses = forwardKinematics(plan.bodies, positionsAt(plan.joints, clock.time));
      const tcp = plan.tcps[arm];
      return compose(poses[tcp.body], tcp).xyz;
    },
    ready: false,
    readyAfter: NaN,
  };
  /** @type {any} */ (window).dualarm = page;
  requestAnimationFrame(() =>
    requestAnimationFrame(() => {
      page.ready = true;
      page.readyAfter = performance.now();
    }),
  );
}

const root = document.getElementById("page");
if (root) {
  try {
    start(root);
  } catch (error) {
    root.replaceChildren(element("p", { class: "missing" }, unfit(document.getElementById("data")?.textContent ?? "", error)));
    throw error;
  }
}
