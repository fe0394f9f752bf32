// What the console works out of its data: values of forms, the point that a click means, ages, states of plans.
import assert from "node:assert/strict";
import { test } from "node:test";
import { Parameter, Row, Tab, ago, askedFor, pick, readValue, standingOfRow, tintByHeight, writeValue } from "../src/console-data";

const parameter = (type: Parameter["type"], more: Partial<Parameter> = {}): Parameter =>
  ({ name: "far", type, unit: "m", help: "", default: null, range: null, choices: [], detect: null, ...more });

test("a field's text is read as its parameter says, and what is wrong is named with what is expected", () => {
  assert.deepEqual(readValue(parameter("number"), " 0.5 "), { value: 0.5 });
  assert.deepEqual(readValue(parameter("number"), "0,5"), { problem: "far: expected a number m, got \"0,5\"" });
  assert.deepEqual(readValue(parameter("number", { range: [0, 1] }), "2"), { problem: "far: expected 0 to 1 m, got 2" });
  assert.deepEqual(readValue(parameter("point"), "[1, 2 3]"), { value: [1, 2, 3] });
  assert.deepEqual(readValue(parameter("direction"), "1, 2"), { problem: "far: expected 3 numbers m, got \"1, 2\"" });
  assert.deepEqual(readValue(parameter("point", { range: [0, 1] }), "0 0 9"), { problem: "far: expected 0 to 1 m, got 0 0 9" });
  assert.deepEqual(readValue(parameter("choice", { choices: ["left", "right"] }), "up"), { problem: "far: expected left, right" });
  assert.deepEqual(readValue(parameter("names"), "a, b c"), { value: ["a", "b", "c"] });
  for (const type of ["number", "point", "text", "choice"] as const) assert.deepEqual(readValue(parameter(type), "  "), {});
  for (const text of ["NaN", "Infinity", "1e999", "one"]) assert.ok(readValue(parameter("number"), text).problem);
});

test("a default that is written into a field is read back as it was", () => {
  for (const [type, value] of [["number", 0.008], ["direction", [-1, 0, 0]], ["text", "a b"], ["names", ["a", "b"]]] as const) {
    assert.deepEqual(readValue(parameter(type), writeValue(value)).value, value);
  }
  assert.equal(writeValue(null), "");
});

test("what an object of the scan gives is not asked for", () => {
  const tab: Tab = { name: "", help: "", kinds: [], errors: [], parameters: [parameter("point", { name: "at", detect: "panel" }), parameter("number")] };
  assert.deepEqual(askedFor(tab).map(({ name }) => name), ["far"]);
});

const EYE = [0, 0, 0];
const AHEAD = [1, 0, 0];

test("a click means the nearest of the points on its ray, not what is behind it", () => {
  assert.equal(pick(Float32Array.of(5, 0, 0, 2, 0.001, 0, 3, 0, 0), EYE, AHEAD), 1);
});

test("a click beside all points means the one that it passes most narrowly, and none that is far off", () => {
  assert.equal(pick(Float32Array.of(1, 0.025, 0, 1, 0, 0.015), EYE, AHEAD), 1);
  assert.equal(pick(Float32Array.of(1, 0.1, 0), EYE, AHEAD), -1);
  assert.equal(pick(Float32Array.of(-1, 0, 0, 0.01, 0, 0), EYE, AHEAD), -1);
  assert.equal(pick(new Float32Array(), EYE, AHEAD), -1);
});

test("heights have colours of their own, and a flat cloud has one", () => {
  const tints = tintByHeight(Float32Array.of(0, 0, 0, 0, 0, 1));
  assert.notDeepEqual([...tints.slice(0, 3)], [...tints.slice(3)]);
  assert.ok([...tintByHeight(Float32Array.of(0, 0, 1, 1, 1, 1))].every(Number.isFinite));
});

test("an age is told in its largest unit", () => {
  assert.deepEqual([0, 59.9, 60, 7300, 200_000].map(ago), ["0 s", "59 s", "1 min", "2 h", "2 d"]);
});

const row = (more: Partial<Row>): Row => ({
  plan_id: "a", state: "finished", verdict: "CERTIFIED", created: "", is_approved: false, is_rejected: false, needs_decision: false, reason: "", ...more,
});

test("a plan is called by what was decided about it, or else by how far it is", () => {
  assert.equal(standingOfRow(row({ is_approved: true })).text, "accepted");
  assert.equal(standingOfRow(row({ is_rejected: true })).text, "rejected");
  assert.equal(standingOfRow(row({ needs_decision: true })).text, "needs a decision");
  assert.deepEqual(standingOfRow(row({ state: "lost" })), { text: "lost", tone: "bad" });
});
