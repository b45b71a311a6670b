// Start of the page: the large play button, one run by itself, and links to an instant.

import { element } from "./dom.js";

/** @typedef {import("./clock.js").Clock} Clock */

/**
 * Read the time that a link names.
 * @param {string} hash such as `#t=12.3`
 * @returns {number | undefined} s
 */
export function linkedTime(hash) {
  const match = /^#t=(\d+(?:\.\d+)?)$/.exec(hash);
  return match ? Number(match[1]) : undefined;
}

/** Compose the link to an instant. @param {number} time s @returns {string} */
export const linkTo = (time) => `#t=${Number(time.toFixed(3))}`;

/**
 * Create the large play button, shown over the 3-D view while nothing plays and nobody has moved the cursor.
 * @param {Clock} clock
 */
export function largePlayButton(clock) {
  const keys = element("small", {}, "Space plays, ← → step, ? shows all keys");
  const node = element("button", { type: "button", class: "large-play", title: "Play (space)", "aria-label": "Play", onclick: () => clock.play() }, element("b", {}, "▶"), keys);
  const show = () => (node.hidden = clock.playing || (clock.time > 0 && clock.time < clock.duration));
  clock.onChange(show);
  show();
  return node;
}

/**
 * Go to the instant that the address names, or else play once; a page within a page waits for its holder.
 * @param {Clock} clock
 */
export function begin(clock) {
  const go = () => {
    const time = linkedTime(location.hash);
    if (time === undefined) return false;
    clock.pause();
    clock.setTime(time);
    return true;
  };
  window.addEventListener("hashchange", go);
  const alone = window.parent === window;
  const still = matchMedia("(prefers-reduced-motion: reduce)").matches;
  if (!go() && alone && !still) clock.playOnce();
}

/**
 * Put the link to the cursor's time into the address line and the clipboard.
 * @param {Clock} clock
 * @param {(text: string) => void} say
 */
export function copyLink(clock, say) {
  clock.pause();
  history.replaceState(null, "", linkTo(clock.time));
  const copied = navigator.clipboard?.writeText(location.href) ?? Promise.reject(new Error("no clipboard"));
  copied.then(() => say("copied"), () => say("link is in the address line"));
}
