// The payload that service/viewer/payload.py wrote, decoded into typed arrays.
import { Hull, Packed, PackedHull, Quantized, bytesOf, floats, hullOf, indices, points } from "./packed";
import type { PackedPoseGraph } from "./pose-data";

interface PackedNamedHull { name: string; kind: string; hull: PackedHull }
export interface NamedHull { name: string; kind: string; hull: Hull }
export interface Body { name: string; link: string; hull: Hull }
// What a link looks like, in its frame.
interface PackedVisual { link: string; vertices: Quantized; triangles: Packed }
export interface Visual { link: string; vertices: Float32Array; triangles: Uint16Array }
interface MovedJoint { name: string; joint: string; type: "revolute" | "prismatic"; parent: string | null; origin: number[]; axis: number[] }
// Bodies are in the frame of the link, which has a pose among those of the robot's links.
export interface Movable extends MovedJoint { bodies: NamedHull[]; angles: Float32Array }
export interface Contact {
  link: string; position?: number[]; quaternion_wxyz?: number[]; sole?: number[][]; friction?: number | null; force_cap_n?: number | null;
  normal?: number[] | null; tilt_rad?: number;
}
// The largest force of a hand on a link of what is moved, in the link's axes, anywhere on place +- slide.
export interface Load { tool: string; link: string; place: number[]; force_n: number[]; slide: number[] | null }
// A surface of a hand that presses a body of what is moved; rows of the waypoints of its phase, in the world.
export interface HandContact {
  joint: string; surface: string; body: string; friction: [number, number]; force_n: number; check: number | null;
  times: number[]; points: number[][]; normals: number[][]; ways: number[][]; touches: boolean[];
}
// Of the robot or what the task moves: a body, or with null every body of the link; of the scene: a piece.
export interface BodyRef { owner: "robot" | "scene" | "mechanism"; link: string | null; body: string | null }
export interface Allowance { first: BodyRef; second: BodyRef; depth: number }
export interface Target {
  kind: string; frame?: string; position?: number[]; quaternion_wxyz?: number[];
  centre?: number[]; axis?: number[] | null; radius?: number; tolerance_m?: number;
  // Of a region, in its axes; null where it is free.
  reference?: string | null; lower_m?: (number | null)[]; upper_m?: (number | null)[]; radius_m?: number | null;
  distance_m?: number | null; look?: number[] | null; lean_deg?: number | null;
}
export interface Span { start: number; end: number }
// Where the centre of mass may be, and forces at places that hold the robot, one row per frame from a frame on.
export interface Region extends Span {
  polygon: number[][]; margin_m: number | null; places: number[][]; frame: number; forces: Float32Array;
}
export interface Phase extends Span {
  name: string; contacts?: Contact[]; allowances?: Allowance[]; targets?: Target[]; loads?: Load[]; regions: Region[]; hand_contacts?: HandContact[];
}
export interface Support extends Span { polygon: number[][]; margin_m?: number; zmp: Float64Array }
export interface Gap extends Span { names: string[] }
// Where a motion that was never planned should have ended, and what the robot is in there.
export interface Obstruction {
  targets: Target[]; links: { link: string; position: number[]; quaternion_wxyz: number[] }[];
  overlaps: { link: string; other: string; depth_m: number | null }[];
}
export interface Where { time_s?: number | null; position?: number[] | null; names?: string[] | null }
export interface Check {
  name: string; ok: boolean; value: number | null; limit: number | null; unit: string | null;
  text: string | null; where?: Where | null; basis?: string;
}

// The same links as physics carried the plan out, and the ground's force, planned and in physics [N].
export interface Simulated {
  verdict: string; reasons: string[]; times: Float32Array; positions: Float32Array; rotations: Int16Array; ground: Float32Array;
}
interface PackedSimulated { verdict: string; reasons: string[]; times: Packed; positions: Quantized; rotations: Packed; ground: Packed }

interface Payload {
  verdict: string; robot: string; task: string; explanation: string[]; notes: string[];
  figures: Record<string, unknown>; timings: Record<string, number>; planning_time_s: number | null;
  min_clearance_m: number | null; min_clearance_pair: string[]; min_balance_margin_m: number | null;
  request_hash: string; checks: Check[]; rests_on: string[]; not_checked: string[]; is_timed: boolean; gaps: Gap[];
  obstruction: Obstruction | null; shapeless: string[];
  times: Packed; links: string[]; positions: Quantized; rotations: Packed;
  bodies: { name: string; link: string; hull: PackedHull }[];
  visuals?: PackedVisual[];
  pieces: PackedNamedHull[];
  movables: (MovedJoint & { bodies: PackedNamedHull[]; angles: Packed })[];
  phases: (Omit<Phase, "regions"> & { regions: (Omit<Region, "forces"> & { forces: Packed })[] })[];
  waypoints: number[]; support: (Omit<Support, "zmp"> & { zmp: Packed })[]; com: Packed; clearance: Packed; cloud: Quantized;
  simulated?: PackedSimulated | null;
  pose_graph?: PackedPoseGraph;
}

export interface Result extends Omit<
  Payload, "times" | "positions" | "rotations" | "bodies" | "visuals" | "pieces" | "movables" | "phases" | "support" | "com" | "clearance" | "cloud" | "simulated"
> {
  simulated?: Simulated;
  times: Float32Array; positions: Float32Array; rotations: Int16Array; bodies: Body[]; visuals: Visual[]; pieces: NamedHull[];
  movables: Movable[]; phases: Phase[]; support: Support[]; com: Float32Array; clearance: Float32Array; cloud: Float32Array;
}

const namedHull = (piece: PackedNamedHull): NamedHull => ({ ...piece, hull: hullOf(piece.hull) });

export function readPayload(): Result {
  const payload = JSON.parse(document.getElementById("payload")!.textContent) as Payload;
  return {
    ...payload,
    times: floats(payload.times),
    positions: points(payload.positions),
    rotations: new Int16Array(bytesOf(payload.rotations)),
    bodies: payload.bodies.map((body) => ({ ...body, hull: hullOf(body.hull) })),
    visuals: (payload.visuals ?? []).map(({ link, vertices, triangles }) => ({
      link, vertices: points(vertices), triangles: indices(triangles),
    })),
    pieces: payload.pieces.map(namedHull),
    movables: payload.movables.map((movable) => ({
      ...movable, bodies: movable.bodies.map(namedHull), angles: floats(movable.angles),
    })),
    phases: payload.phases.map((phase) => ({
      ...phase, regions: phase.regions.map((region) => ({ ...region, forces: floats(region.forces) })),
    })),
    com: floats(payload.com),
    support: payload.support.map((support) => ({ ...support, zmp: new Float64Array(bytesOf(support.zmp)) })),
    clearance: floats(payload.clearance),
    cloud: points(payload.cloud),
    simulated: payload.simulated ? {
      verdict: payload.simulated.verdict,
      reasons: payload.simulated.reasons,
      times: floats(payload.simulated.times),
      positions: points(payload.simulated.positions),
      rotations: new Int16Array(bytesOf(payload.simulated.rotations)),
      ground: floats(payload.simulated.ground),
    } : undefined,
  };
}

// Index of the frame at or before a time, and how far it is on to the next one (0 to 1).
export function frameAt(times: Float32Array, t: number): [number, number] {
  let low = 0;
  let high = times.length - 1;
  if (high <= 0 || t <= times[0]) return [0, 0];
  if (t >= times[high]) return [high, 0];
  while (high - low > 1) {
    const middle = (low + high) >> 1;
    if (times[middle] <= t) low = middle; else high = middle;
  }
  return [low, (t - times[low]) / (times[high] - times[low])];
}

// Row of a table with one row per frame, read linearly between frames.
export function rowAt(times: Float32Array, table: Float32Array, width: number, t: number): number[] {
  const [frame, u] = frameAt(times, t);
  const next = Math.min(frame + 1, times.length - 1);
  return Array.from({ length: width }, (_, i) => table[frame * width + i] * (1 - u) + table[next * width + i] * u);
}

// The entry whose span holds a time; at a border the later one.
export function spanAt<T extends Span>(spans: T[], t: number): T | undefined {
  return spans.filter((span) => t >= span.start - 1e-6 && t <= span.end + 1e-6).at(-1);
}
