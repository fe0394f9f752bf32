import assert from "node:assert";
import { test } from "node:test";
import { LineBasicMaterial, MeshBasicMaterial } from "three";
import { drawRegion, extentOf } from "../src/goal-regions";

test("a box has its bounds, and open sides are drawn to half a metre beyond", () => {
  const box = extentOf({ kind: "region", lower_m: [-0.1, 0.2, null], upper_m: [0.1, null, null] })!;
  assert.deepEqual(box.low, [-0.1, 0.2, -0.5]);
  assert.deepEqual(box.high, [0.1, 0.7, 0.5]);
});

test("a cylinder and a ball reach as far as their radius, and a plane is still seen", () => {
  const cylinder = extentOf({ kind: "region", radius_m: 0.05, lower_m: [null, null, 0], upper_m: [null, null, 0] })!;
  assert.deepEqual([cylinder.low[0], cylinder.high[1]], [-0.05, 0.05]);
  assert.ok(cylinder.high[2] > cylinder.low[2]);
  assert.deepEqual(extentOf({ kind: "region", distance_m: 0.1 })!.low, [-0.1, -0.1, -0.1]);
});

test("a free place has no extent, and its cone and what it looks at are drawn alone", () => {
  const free = { kind: "region", position: [0, 0, 1], axis: [0, 0, 1], lean_deg: 10 };
  assert.equal(extentOf(free), null);
  const draw = (target: object): number => drawRegion({ kind: "region", ...target }, new MeshBasicMaterial(), new LineBasicMaterial()).children.length;
  assert.equal(draw(free), 2);
  assert.equal(draw({ ...free, look: [0.1, 0, 0] }), 1);
  assert.equal(draw({ lower_m: [0, 0, 0], upper_m: [1, 1, 1] }), 2);
});
