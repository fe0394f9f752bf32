// What the console's bridge sends (service/cli/console), and what the page works out of it without drawing.
import type { Check } from "./data";
import type { Quantized } from "./packed";
import type { Standing } from "./standing";

export interface Review { is_accepted: boolean; reviewer: string; comment: string; time: string }
export interface Row {
  plan_id: string; state: string; verdict: string; created: string; is_approved: boolean; is_rejected: boolean; needs_decision: boolean;
  reason: string; task?: string;
}
export interface ReviewedRow extends Row {
  reviews: Review[]; trajectory_sha256: string; certificate_sha256: string; page_sha256: string;
}
export interface JudgedCheck extends Check { standing: Standing }
export interface Risk {
  title: string; check: number; standing: Standing; value: number | null; unit: string | null; text: string; count: number;
}
export interface Group { phase: string; open: number[]; passed: number[] }
export interface Plan extends ReviewedRow {
  explanation: string[]; checks: JudgedCheck[]; risks: Risk[]; assumed: string[]; not_checked: string[]; groups: Group[];
  duration_s: number | null; planning_time_s: number; has_page: boolean; releases: Record<string, string>; holds: string[]; scan_age_s: number | null;
}
export interface Physics { verdict: string; explanation: string[] }
export interface Job {
  job: number; task: string; state: string; step: string; fraction: number; plan_id: string; verdict: string; error: string;
}
export interface Parameter {
  name: string; type: "number" | "point" | "direction" | "choice" | "text" | "names"; unit: string | null; help: string; default: unknown;
  range: [number, number] | null; choices: string[]; detect: string | null;
}
export interface Tab { name: string; help: string; parameters: Parameter[]; kinds: string[]; errors: string[] }
export interface RobotChoice { name: string; postures: string[] }
export interface ScanRow { name: string; age_s: number }
export interface CameraChoice { name: string; phases: string[] }
export interface CameraPicture { image: string; marks: Record<string, number[]> }
export interface Tabs { tabs: Tab[]; robots: RobotChoice[]; scans: ScanRow[]; cameras: CameraChoice[] }
// The server's robot (service/cli/console/robot.py); without one only the first three.
export interface RobotState {
  is_there: boolean; problem: string; surprises: string[]; has_control: boolean; revision: number; mode: string; phase: string; reason: string;
  findings: string[]; speed: number; last_order: string; plan_id: string; trajectory_sha256: string; duration_s: number; clock_s: number;
  control: string; farthest: { joint: string; off: number } | null; joint_names: string[]; phases: string[]; base: number[]; positions: number[];
  shifts: Record<string, number[]>; shiftable: string[]; held: string[];
}
export interface ScanCloud extends ScanRow { cloud: Quantized }
export interface Unseen { cells: Quantized }
export interface ScanChanges { line: string; added: Quantized; gone: Quantized }
export interface FoundHit {
  hit: number; kind: string; searched: string; confidence: number; pose_world_object: number[][]; sizes: Record<string, number>;
  residuals: Record<string, number>; doubts: string[]; points: Quantized; moved_m: number[];
}
export interface Found { hits: FoundHit[]; notes: string[] }

export const RUNNING = ["uploading", "queued", "planning"];
// Modes in which a plan is under way; in others there is nothing to pause, to resume or to abort.
export const UNDER_WAY = ["ready", "running", "paused", "waiting", "returning", "holding"];

// What the robot is, in one line.
export function sayRobot(state: RobotState): string {
  const parts = [];
  const place = state.phases.indexOf(state.phase);
  if (state.plan_id) parts.push(`${place >= 0 ? `step ${place + 1} of ${state.phases.length}, ` : ""}${state.phase || "no phase"} · ${state.clock_s.toFixed(1)} of ${state.duration_s.toFixed(1)} s`);
  if (state.speed !== 1 && UNDER_WAY.includes(state.mode)) parts.push(`at ${Math.round(100 * state.speed)} %`);
  if (state.farthest) parts.push(`${state.farthest.joint} is ${state.farthest.off.toFixed(3)} off`);
  return [...parts, state.reason, ...state.findings].filter(Boolean).join(" · ");
}

export const OLD_SCAN_S = 600;

// "12 s", "5 min", "3 h", "2 d": the largest unit.
export function ago(seconds: number): string {
  const units: [number, string][] = [[86400, "d"], [3600, "h"], [60, "min"]];
  const [size, name] = units.find(([least]) => seconds >= least) ?? [1, "s"];
  return `${Math.floor(seconds / size)} ${name}`;
}

// What a row's state is called, and its tone.
export function standingOfRow(row: Row): { text: string; tone: "good" | "fair" | "bad" | "" } {
  if (row.is_approved) return { text: "accepted", tone: "good" };
  if (row.is_rejected) return { text: "rejected", tone: "bad" };
  if (row.needs_decision) return { text: "needs a decision", tone: "fair" };
  return { text: row.state, tone: row.state === "lost" ? "bad" : "" };
}

// What a field of a task's form holds, as a value of its parameter; a text where it is wrong.
export function readValue(parameter: Parameter, text: string): { value?: unknown; problem?: string } {
  const said = text.trim();
  if (said === "") return {};
  const unit = parameter.unit ? ` ${parameter.unit}` : "";
  switch (parameter.type) {
    case "choice":
      return parameter.choices.includes(said) ? { value: said } : { problem: `${parameter.name}: expected ${parameter.choices.join(", ")}` };
    case "text":
      return { value: said };
    case "names":
      return { value: said.split(/[\s,]+/).filter(Boolean) };
    default: {
      const parts = parameter.type === "number" ? [said] : said.replace(/[[\]]/g, "").split(/[\s,;]+/).filter(Boolean);
      const numbers = parts.map(Number);
      const count = parameter.type === "number" ? 1 : 3;
      if (numbers.length !== count || !numbers.every(Number.isFinite)) {
        return { problem: `${parameter.name}: expected ${count === 1 ? "a number" : "3 numbers"}${unit}, got "${said}"` };
      }
      const { range } = parameter;
      if (range && !numbers.every((x) => x >= range[0] && x <= range[1])) {
        return { problem: `${parameter.name}: expected ${range[0]} to ${range[1]}${unit}, got ${said}` };
      }
      return { value: count === 1 ? numbers[0] : numbers };
    }
  }
}

// How a default is written into a field.
export const writeValue = (value: unknown): string =>
  value === null || value === undefined ? "" : Array.isArray(value) ? value.map(String).join(", ") : typeof value === "object" ? JSON.stringify(value) : `${value as string | number | boolean}`;

// Parameters that the form shows first: what an object of the scan gives is not asked for.
export const askedFor = (tab: Tab): Parameter[] => tab.parameters.filter((parameter) => parameter.detect === null);

const NARROW = 0.008;  // [rad] about the ray: a click means the nearest point in it
const WIDE = 0.03;     // or else the point nearest to the ray in this

// Index of the point that a ray from a place along a unit direction means; -1 if it passes all.
export function pick(points: Float32Array, from: number[], along: number[]): number {
  let [nearest, nearestDepth, best, bestAngle] = [-1, Infinity, -1, WIDE];
  for (let i = 0; i < points.length / 3; i++) {
    const [x, y, z] = [points[3 * i] - from[0], points[3 * i + 1] - from[1], points[3 * i + 2] - from[2]];
    const depth = x * along[0] + y * along[1] + z * along[2];
    if (depth < 0.05) continue;
    const angle = Math.sqrt(Math.max(0, x * x + y * y + z * z - depth * depth)) / depth;
    if (angle < NARROW && depth < nearestDepth) [nearest, nearestDepth] = [i, depth];
    if (angle < bestAngle) [best, bestAngle] = [i, angle];
  }
  return nearest >= 0 ? nearest : best;
}

// Colours by height, from blue over green to yellow, so that a cloud without colours has depth.
export function tintByHeight(points: Float32Array): Float32Array {
  let [low, high] = [Infinity, -Infinity];
  for (let i = 2; i < points.length; i += 3) [low, high] = [Math.min(low, points[i]), Math.max(high, points[i])];
  const span = high > low ? high - low : 1;
  const tints = new Float32Array(points.length);
  for (let i = 0; i < points.length; i += 3) {
    const u = (points[i + 2] - low) / span;
    tints.set([0.2 + 0.65 * u * u, 0.3 + 0.5 * u, 0.62 - 0.35 * u], i);
  }
  return tints;
}
