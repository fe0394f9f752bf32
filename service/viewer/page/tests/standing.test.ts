// What the page says that a figure rests on: never more than the certificate.
import assert from "node:assert/strict";
import { test } from "node:test";
import type { Check, Result } from "../src/data";
import { insideBy, shrunk } from "../src/geometry";
import { basisTold, clearanceTold, insideTold, listWorst, standingOf, tightest, weakest } from "../src/standing";

const check = (name: string, more: Partial<Check> = {}): Check =>
  ({ name, ok: true, value: 0.05, limit: 0.02, unit: "m", text: "5 cm", ...more });
const result = (checks: Check[], more: Partial<Result> = {}): Result =>
  ({ checks, not_checked: [], min_clearance_m: 0.05, ...more }) as unknown as Result;

test("a check that failed is refuted whatever it rests on", () => {
  assert.equal(standingOf(check("a", { ok: false, basis: "samples" })), "refuted");
  assert.deepEqual(["unproven", "samples", "curve", undefined].map((basis) => standingOf(check("a", { basis }))),
    ["unproven", "at samples", "proven", "proven"]);
});

test("several stand as the weakest does, and nothing stands on nothing", () => {
  assert.equal(weakest([check("a"), check("b", { basis: "unproven" }), check("c", { basis: "samples" })]), "unproven");
  assert.equal(weakest([check("a"), check("b")]), "proven");
  assert.equal(weakest([]), "unproven");
});

test("the tightest check has least to spare above its limit, and a missing value is worse than any", () => {
  const [wide, tight] = [check("a", { value: 0.5, limit: 0.1 }), check("b", { value: 0.6, limit: 0.55 })];
  assert.equal(tightest([wide, tight]), tight);
  const missing = check("c", { value: null });
  assert.equal(tightest([tight, missing]), missing);
  assert.equal(tightest([]), undefined);
});

test("the worst failed checks miss most of their limits, and of those without a limit the deepest is first", () => {
  const failed = (name: string, value: number | null, limit: number): Check => check(name, { ok: false, value, limit });
  const checks = [
    failed("torque", 1.1, 1.0), failed("shallow", -0.001, 0), check("held"), failed("deep", -0.2, 0), failed("nowhere", null, 0),
  ];
  assert.deepEqual(listWorst(checks, 3).map((own) => own.name), ["nowhere", "deep", "shallow"]);
  assert.equal(listWorst([check("held")], 3).length, 0);
});

test("a clearance is proven only if every check of it is", () => {
  assert.deepEqual(clearanceTold(result([check("clearance.a")])), { value: "50 mm", standing: "proven", text: "proven: 5 cm" });
  const told = clearanceTold(result([check("clearance.a"), check("clearance.b", { ok: false, value: -0.001, text: "deep" })]));
  assert.equal(told?.standing, "refuted");
  assert.match(told.value, /^.1 mm$/);
  assert.equal(clearanceTold(result([check("balance")])), undefined);
});

test("a place inside is told with what is missing where it is too near the border", () => {
  assert.equal(insideTold([check("balance", { value: 0.03 }), check("balance.b", { value: 0.04 })])?.text, "30 mm inside at least, proven");
  assert.equal(insideTold([check("balance", { ok: false, value: 0.01 })])?.text, "10 mm inside, 20 mm needed");
  assert.equal(insideTold([check("balance", { ok: false, value: null })])?.text, "nowhere: nothing presses on the ground");
  assert.equal(insideTold([]), undefined);
});

test("a verdict names what is proven, what is not, and what nobody checked", () => {
  const told = basisTold(result(
    [check("clearance"), check("balance", { basis: "samples" }), check("torque.a", { basis: "unproven" })], { not_checked: ["forces of hands"] },
  ));
  assert.equal(told, "clearance proven on the whole curve; balance checked at samples; torques unproven; not checked: forces of hands");
});

const SQUARE = [[0, 0], [2, 0], [2, 2], [0, 2]];

test("the distance inside a polygon is that to its nearest edge, whichever way round its corners are", () => {
  for (const corners of [SQUARE, [...SQUARE].reverse()]) {
    assert.equal(insideBy(corners, 0.5, 1), 0.5);
    assert.equal(insideBy(corners, 2.25, 1), -0.25);
  }
});

test("a polygon is shrunk by its margin, and to nothing by half its width", () => {
  assert.deepEqual(shrunk(SQUARE, 0.5).map(([x, y]) => `${x} ${y}`).sort(), ["0.5 0.5", "0.5 1.5", "1.5 0.5", "1.5 1.5"]);
  assert.deepEqual(shrunk(SQUARE, 1.5), []);
});
