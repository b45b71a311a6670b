import assert from "node:assert/strict";
import { test } from "node:test";
import { commonLevel, commonPrefix, fitting, forms } from "../src/labels.js";
import { actionOn, eventText, fixed, jointUnit, jointValue, millimetres, percent, rulerTimes, seconds, significant, word } from "../src/units.js";

const width = (/** @type {string} */ text) => [...text].length;

test("the common prefix of all ids ends at a separator", () => {
  assert.equal(commonPrefix(["left-01", "left-02", "left-12"]), 5);
  assert.equal(commonPrefix(["left-01", "right-01"]), 0);
  assert.equal(commonPrefix(["left[1,2]", "left[1,3]"]), 5);
  assert.equal(commonPrefix(["screw1", "screw2"]), 0);
  assert.equal(commonPrefix(["a-1", "a-1"]), 0);
  assert.equal(commonPrefix(["a-", "a-1"]), 0);
  assert.equal(commonPrefix([]), 0);
});

test("forms of an id grow shorter and stay unique", () => {
  const found = forms("left-01", "pick left-01", 5);
  assert.deepEqual(found, ["pick left-01", "left-01", "01"]);
  assert.deepEqual(forms("left[1,2]", "pick left[1,2]", 5), ["pick left[1,2]", "left[1,2]", "1,2"]);
  assert.deepEqual(forms("seam", "seam", 0), ["seam"]);
});

test("the longest form that fits is selected", () => {
  assert.equal(fitting(["pick left-01", "left-01", "01"], 8, width), "left-01");
  assert.equal(fitting(["pick left-01", "left-01", "01"], 2, width), "01");
  assert.equal(fitting(["pick left-01", "left-01", "01"], 1, width), "01");
});

test("if no form fits, both ends of the last one remain, with complete letters", () => {
  assert.equal(fitting(["take suction (plate-1)"], 11, width), "take …te-1)");
  assert.equal(fitting(["take suction (plate-1)"], 2, width), "ta…1)");
  for (let space = 5; space < 20; space++) {
    assert.equal(width(fitting(["🤖".repeat(20)], space, width)), space);
  }
});

test("the level of shortening suits most labels", () => {
  const candidates = ["pick left-01", "left-01", "01"];
  const labels = (/** @type {number[]} */ all) => all.map((space) => ({ candidates, space }));
  assert.equal(commonLevel(labels([20, 20, 20, 3]), width), 0);
  assert.equal(commonLevel(labels([20, 8, 8, 8]), width), 1);
  assert.equal(commonLevel(labels([1, 1]), width), 2);
  assert.equal(commonLevel([], width), 0);
});

test("numbers have a typographic minus sign, and zero has none", () => {
  assert.equal(fixed(-1.25, 1), "\u22121.3");
  assert.equal(fixed(-0.0001, 2), "0.00");
  assert.equal(fixed(2, 0), "2");
});

test("lengths, times and fractions have units", () => {
  assert.equal(seconds(1.23456), "1.235\u202fs");
  assert.equal(seconds(null), "–");
  assert.equal(millimetres(0.0117), "11.7\u202fmm");
  assert.equal(percent(0.317), "31.7\u202f%");
  assert.equal(significant(6.8319e-8), "6.83e\u22128");
  assert.equal(significant(0.30874), "0.3087");
});

test("revolute joints are shown in degrees, prismatic ones in millimetres", () => {
  assert.equal(jointUnit(false, "jerk").name, "°/s³");
  assert.equal(jointUnit(true, "velocity").name, "mm/s");
  assert.equal(jointValue(Math.PI / 2, false, "position"), "90.00°");
  assert.equal(jointValue(0.25, true, "position"), "250.0\u202fmm");
});

test("a ruler has round times within its range, up to the maximum count", () => {
  for (const [from, to] of [[0, 37.6], [1.234, 1.239], [10, 500]]) {
    const { times, decimals } = rulerTimes(from, to, 10);
    assert.ok(times.length >= 3 && times.length <= 11, String(times));
    assert.ok(times.every((t) => t >= from - 1e-9 && t <= to + 1e-9));
    const texts = times.map((t) => t.toFixed(decimals));
    assert.equal(new Set(texts).size, times.length);
    times.forEach((t, i) => assert.ok(Math.abs(Number(texts[i]) - t) < 1e-9));
  }
});

test("an action is named once", () => {
  assert.equal(actionOn("pick", "left-01"), "pick left-01");
  assert.equal(actionOn("take_tool", "take suction (plate-1)"), "take suction (plate-1)");
  assert.equal(actionOn("take_tool", "takeaway"), "take tool takeaway");
  assert.equal(actionOn("", "seam"), "seam");
  assert.equal(actionOn("seam_start", "seam"), "seam start");
  assert.equal(actionOn("path", "path"), "path");
});

test("an event names the signal that is set", () => {
  assert.equal(eventText({ action: "pick", task: "left-01", signal: "left_do1" }), "pick left-01 → left_do1");
  assert.equal(eventText({ action: "pick", task: "left-01" }), "pick left-01");
});

test("names in the schedule are displayed as words", () => {
  assert.equal(word("take_tool"), "take tool");
  assert.equal(word("shared_zone"), "shared zone");
});
