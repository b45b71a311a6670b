import assert from "node:assert/strict";
import { readFileSync } from "node:fs";
import { test } from "node:test";

const sheet = readFileSync(new URL("../src/page.css", import.meta.url), "utf8");

/** Returns the colours of a theme: those of the light one, and the dark one's instead of them. */
function colours(theme) {
  const read = (text) => [...text.matchAll(/--([\w-]+): (#[0-9a-f]{6});/g)].map(([, name, value]) => [name, value]);
  const [light, dark] = [":root {", ':root[data-theme="dark"] {'].map((head) => {
    const start = sheet.indexOf(head);
    return read(sheet.slice(start, sheet.indexOf("}", start)));
  });
  return Object.fromEntries(theme === "dark" ? [...light, ...dark] : light);
}

/** Returns the linear red, green and blue of a colour (sRGB, IEC 61966-2-1). */
function linear(colour) {
  return [1, 3, 5].map((at) => {
    const value = parseInt(colour.slice(at, at + 2), 16) / 255;
    return value <= 0.04045 ? value / 12.92 : ((value + 0.055) / 1.055) ** 2.4;
  });
}

/** Returns the contrast of two colours, as WCAG 2.2 defines it. */
function contrast(one, other) {
  const luminance = (colour) => linear(colour).reduce((sum, value, i) => sum + value * [0.2126, 0.7152, 0.0722][i], 0);
  const [low, high] = [luminance(one), luminance(other)].sort((a, b) => a - b);
  return (high + 0.05) / (low + 0.05);
}

// Severity 1 of Machado, Oliveira and Fernandes (2009), for linear colours.
const VISIONS = {
  "any other vision": [[1, 0, 0], [0, 1, 0], [0, 0, 1]],
  deuteranopia: [[0.367322, 0.860646, -0.227968], [0.280085, 0.672501, 0.047413], [-0.01182, 0.04294, 0.968881]],
  tritanopia: [[1.255528, -0.076749, -0.178779], [-0.078411, 0.930809, 0.147602], [0.004733, 0.691367, 0.3039]],
  protanopia: [[0.152286, 1.052583, -0.204868], [0.114503, 0.786281, 0.099216], [-0.003882, -0.048116, 1.051998]],
};

/** Returns the distance of two colours in CIE L*a*b* (1976) as somebody sees them. */
function distance(one, other, vision) {
  const lab = (colour) => {
    const rgb = linear(colour);
    const seen = vision.map((row) => row.reduce((sum, m, i) => sum + m * rgb[i], 0));
    const white = [0.95047, 1, 1.08883];
    const [x, y, z] = [[0.4124, 0.3576, 0.1805], [0.2126, 0.7152, 0.0722], [0.0193, 0.1192, 0.9505]].map((row, k) => {
      const t = row.reduce((sum, m, i) => sum + m * seen[i], 0) / white[k];
      return t > (6 / 29) ** 3 ? Math.cbrt(t) : t / (3 * (6 / 29) ** 2) + 4 / 29;
    });
    return [116 * y - 16, 500 * (x - y), 200 * (y - z)];
  };
  return Math.hypot(...lab(one).map((value, i) => value - lab(other)[i]));
}

const ON_PANEL = ["text", "muted", "good", "bad", "pick-text", "place-text", "give-text", "take-text", "tool-text", "path-text", "seam-text", "move-text"];
const ON_VIEW = ["text", "clearance", "muted", "left-text", "right-text"];
const BACKGROUNDS = [
  ["panel", ON_PANEL],
  ["view", ON_VIEW],
  ["accent-soft", ["text"]],
  ["band-even", ["muted"]],
  ["band-odd", ["muted"]],
];

for (const theme of ["light", "dark"]) {
  const named = colours(theme);
  test(`${theme}: text has the contrast that WCAG AA requires`, () => {
    for (const [background, texts] of BACKGROUNDS) {
      for (const text of texts) {
        const found = contrast(named[text], named[background]);
        assert.ok(found >= 4.5, `${text} on ${background}: ${found.toFixed(2)}`);
      }
    }
  });

  test(`${theme}: arms and actions are distinguishable with colour vision deficiencies`, () => {
    const actions = ["pick", "place", "give", "take", "tool", "path", "seam", "move"];
    const pairs = (names) => names.flatMap((one, i) => names.slice(i + 1).map((other) => [one, other]));
    const alike = [...pairs(["left-trace", "right-trace", ...actions]), ...pairs(["left-trace", "right-trace", "platform-trace"]), ["left-arm", "right-arm"], ["clearance", "near-links"]];
    for (const [name, vision] of Object.entries(VISIONS)) {
      for (const [one, other] of alike) {
        const found = distance(named[one], named[other], vision);
        assert.ok(found >= 20, `${one} and ${other}, ${name}: ${found.toFixed(1)}`);
      }
    }
  });
}
