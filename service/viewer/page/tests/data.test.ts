// What is read from a page's data: numbers and points as they were packed, frames and spans at a time.
import assert from "node:assert/strict";
import { test } from "node:test";
import { frameAt, rowAt, spanAt } from "../src/data";
import { floats, hullOf, indices, points } from "../src/packed";
import { chosenIn, poseOfLink, readPoseGraph } from "../src/pose-data";
import { measures } from "../src/pose-layout";

const pack = (values: Float32Array | Uint16Array | Int16Array | Uint8Array) => ({
  dtype: "any", shape: [values.length], data: Buffer.from(values.buffer).toString("base64"),
});

test("numbers are those that were packed", () => {
  assert.deepEqual([...floats(pack(new Float32Array([0, -1.5, 1e6])))], [0, -1.5, 1e6]);
  assert.deepEqual([...indices(pack(new Uint16Array([0, 65535, 256])))], [0, 65535, 256]);
});

test("points lie on a grid between their bounds, each coordinate between its own", () => {
  const packed = { ...pack(new Uint16Array([0, 65535, 13107, 65535, 0, 0])), lower: [0, -1, 10], upper: [1, 1, 20] };
  assert.deepEqual([...points(packed)], [0, 1, 12, 1, -1, 10]);
});

test("a hull has its vertices, triangles, edges and bends", () => {
  const hull = hullOf({
    vertices: pack(new Float32Array([1, 2, 3])), triangles: pack(new Uint16Array([4, 5, 6])),
    edges: pack(new Uint16Array([7, 8])), bends: pack(new Uint8Array([200])),
  });
  assert.deepEqual([[...hull.vertices], [...hull.triangles], [...hull.edges], [...hull.bends]], [[1, 2, 3], [4, 5, 6], [7, 8], [200]]);
});

test("the frame at a time is the last one before it, with the share of the way to the next", () => {
  const times = new Float32Array([1, 2, 4]);
  assert.deepEqual([0, 1, 1.5, 2, 3, 4, 9].map((t) => frameAt(times, t)), [[0, 0], [0, 0], [0, 0.5], [1, 0], [1, 0.5], [2, 0], [2, 0]]);
  assert.deepEqual(frameAt(new Float32Array([]), 1), [0, 0]);
});

test("a row between frames is read linearly, and the last one stays", () => {
  const times = new Float32Array([0, 1]);
  const table = new Float32Array([0, 10, 2, 30]);
  assert.deepEqual(rowAt(times, table, 2, 0.25), [0.5, 15]);
  assert.deepEqual(rowAt(times, table, 2, 7), [2, 30]);
});

test("at a border the later span holds the time", () => {
  const spans = [{ start: 0, end: 1, name: "reach" }, { start: 1, end: 2, name: "turn" }];
  assert.deepEqual([0.5, 1, 2, 2.1].map((t) => spanAt(spans, t)?.name), ["reach", "turn", "turn", undefined]);
});

const GRAPH = readPoseGraph({
  phases: ["sit", "stand"].map((name) => ({ name, solved: 2, feasible: 2, duplicates: 0, failures: [], other_failures: 0 })),
  poses: [
    { phase: 0, place: 0, cost: 3, cost_to_end: 9, drawn: -1 }, { phase: 0, place: 1, cost: 1, cost_to_end: 5, drawn: 1 },
    { phase: 1, place: 0, cost: 2, cost_to_end: null, drawn: 0 },
  ],
  left_out: 0, path: [1], cost: 5, slip_m: null, not_linked: [], links: ["pelvis"],
  positions: { ...pack(new Uint16Array([0, 0, 0, 65535, 0, 65535])), lower: [0, 0, 0], upper: [1, 2, 3] },
  rotations: pack(new Int16Array([1, 0, 0, 0, 16384, 0, 0, 16384])),
});

test("a drawn pose has its own place and turn", () => {
  const matrix = poseOfLink(GRAPH, GRAPH.poses[1], 0).elements;
  assert.deepEqual([...matrix].map((value) => Math.round(1e6 * value) / 1e6 + 0), [0, 1, 0, 0, -1, 0, 0, 0, 0, 0, 1, 0, 1, 0, 3, 1]);
});

test("the chosen pose of a phase is that of the path", () => {
  assert.deepEqual([chosenIn(GRAPH, 0), chosenIn(GRAPH, 1)], [1, -1]);
});

test("a pose costs what the end costs from it above the cheapest of its phase, and nothing is known without a way", () => {
  assert.deepEqual(measures(GRAPH, "pose"), [3, 1, 2]);
  assert.deepEqual(measures(GRAPH, "to the end"), [4, 0, null]);
});
