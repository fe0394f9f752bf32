import assert from "node:assert/strict";
import { test } from "node:test";
import { Vector3 } from "three";
import { Drawing, KEYS, inOrder, middleOfHands, placeFrame, placeJoints, readKey, screw } from "../src/console-pose-data";

const HALF = Math.SQRT1_2;
const ARM: Drawing = {
  joints: [
    { parent: 0, rest: [], motion: [], at: 0 },
    { parent: 1, rest: [0, 0, 1, 1, 0, 0, 0], motion: [0, 0, 0, 0, 0, 1], at: 1 },
    { parent: 2, rest: [1, 0, 0, 1, 0, 0, 0], motion: [0, 0, 2, 0, 0, 0], at: 0 },
  ],
  bodies: [], tools: { left: "tip", right: "root" },
  frames: [{ name: "tip", joint: 3, pose: [0.5, 0, 0, 1, 0, 0, 0] }, { name: "root", joint: 1, pose: [0, 0, 0, 1, 0, 0, 0] }],
};

test("joints place frames by the numbers of a pose", () => {
  // The base is at (0, 0, 2) and turned by a quarter about z; the arm turns by another quarter and is pushed out by 0.2.
  const placed = placeJoints(ARM, [0, 0, 2, HALF, 0, 0, HALF], [0.1, Math.PI / 2]);
  const tip = new Vector3().setFromMatrixPosition(placeFrame(ARM, placed, "tip")!);
  assert.ok(tip.distanceTo(new Vector3(-1.5, 0, 3.2)) < 1e-9);
  assert.ok(new Vector3(-0.75, 0, 2.6).distanceTo(new Vector3().fromArray(middleOfHands(ARM, placed)!)) < 1e-9);
});

test("a screw about an axis beside the origin leaves the points of that axis where they are", () => {
  const [centre, axis] = [new Vector3(0.3, -0.2, 0), new Vector3(0, 0, 1)];
  const velocity = centre.clone().cross(axis);
  const moved = centre.clone().applyMatrix4(screw([...velocity.toArray(), ...axis.toArray()], 1.3));
  assert.ok(moved.distanceTo(centre) < 1e-12);
});

test("the keys are those of the map, and capitals turn only", () => {
  assert.equal(KEYS.length, 14);
  assert.equal(readKey("ArrowUp"), "Up");
  assert.deepEqual(["e", "E", "i", "I", "q", "Q", "x", "Enter"].map(readKey), ["e", "E", "i", null, "q", null, null, null]);
});

test("positions are put in the order of other names, or not at all", () => {
  assert.deepEqual(inOrder(["a", "b"], [1, 2], ["b", "a"]), [2, 1]);
  assert.equal(inOrder(["a"], [1], ["a", "b"]), null);
});
