// Where the dots of the graph of poses are: one column per phase, dots by cost, side by side where they would overlap.
import { figure } from "./dom";
import { PoseGraph } from "./pose-data";

export type Measure = "to the end" | "pose";
export interface Dot { pose: number; x: number; y: number; isOpen: boolean }
export interface Tick { y: number; text: string }
export interface Layout { dots: Dot[]; ticks: Tick[]; columns: { left: number; width: number }[]; radius: number }
export interface Frame { left: number; width: number; top: number; height: number }

interface Scale { at(value: number): number; ticks: number[] }  // at: 0 for the lowest, 1 for the highest

// Decades from the lowest to the highest value; of values within one decade the values themselves.
function decades(values: number[]): Scale {
  const positive = values.filter((value) => value > 0);
  const low = Math.min(...positive);
  const high = Math.max(...positive);
  if (positive.length === 0 || high < 8 * low) return linear(Math.max(...values, 0));
  const [from, to] = [Math.floor(Math.log10(low) + 1e-9), Math.ceil(Math.log10(high) - 1e-9)];
  const ticks = Array.from({ length: to - from + 1 }, (_, i) => 10 ** (from + i));
  return { at: (value) => (Math.log10(Math.max(value, 10 ** from)) - from) / (to - from), ticks };
}

function linear(high: number): Scale {
  const top = high > 0 ? high : 1;
  return { at: (value) => value / top, ticks: high > 0 ? [0, top / 2, top] : [0] };
}

// From 0 on, the larger the more narrowly.
function fromZero(values: number[]): Scale {
  const high = Math.max(...values, 0);
  if (high <= 2) return linear(high);
  const top = Math.log1p(high);
  return { at: (value) => Math.log1p(Math.max(value, 0)) / top, ticks: [0, ...[1, 10, 100, 1e3, 1e4, 1e5, 1e6].filter((tick) => tick <= high)] };
}

// What a pose is placed by: its own cost, or what the end costs from it above the cheapest pose of its phase.
// null where no sequence leads to the end.
export function measures(graph: PoseGraph, measure: Measure): (number | null)[] {
  if (measure === "pose") return graph.poses.map((pose) => pose.cost);
  const best = graph.phases.map((_, phase) =>
    Math.min(...graph.poses.flatMap((pose) => (pose.phase === phase && pose.cost_to_end !== null ? [pose.cost_to_end] : []))));
  return graph.poses.map((pose) => (pose.cost_to_end === null ? null : pose.cost_to_end - best[pose.phase]));
}

export function layOut(graph: PoseGraph, measure: Measure, frame: Frame): Layout {
  const values = measures(graph, measure);
  const known = values.filter((value) => value !== null);
  const scale = measure === "pose" ? decades(known) : fromZero(known);
  // Poses without a sequence to the end are above all others.
  const open = values.some((value) => value === null) ? 16 : 0;
  const y = (value: number | null): number =>
    value === null ? frame.top : frame.top + open + (1 - Math.min(scale.at(value), 1)) * (frame.height - open);
  const width = frame.width / Math.max(graph.phases.length, 1);
  const columns = graph.phases.map((_, phase) => ({ left: frame.left + phase * width, width }));
  const most = Math.max(0, ...graph.phases.map((_, phase) => graph.poses.filter((pose) => pose.phase === phase).length));
  const radius = most > 200 ? 1.5 : most > 60 ? 2.2 : 3;
  const chosen = new Set(graph.path);
  const dots = columns.flatMap(({ left }, phase) => spread(
    graph.poses.flatMap((pose, i) => (pose.phase === phase ? [{ pose: i, y: y(values[i]), isOpen: values[i] === null }] : [])),
    left + width / 2, width / 2 - radius - 2, radius, chosen));
  const ticks = scale.ticks.map((tick) => ({ y: y(tick), text: figure(tick, null) }));
  if (open > 0) ticks.push({ y: y(null), text: "none" });
  return { dots, ticks, columns, radius };
}

// Each dot as near to the middle of its column as the dots before it leave room; where there is none, as far from them as
// the column allows. Chosen poses come first, then the lowest.
function spread(dots: Omit<Dot, "x">[], middle: number, half: number, radius: number, chosen: Set<number>): Dot[] {
  const step = 2 * radius + 1;
  const offsets = [0];
  for (let k = 1; k * step <= half; k++) offsets.push(k * step, -k * step);
  const fine = Array.from({ length: 21 }, (_, i) => ((i - 10) / 10) * Math.max(half, 0));
  const placed: Dot[] = [];
  const rank = ({ pose }: { pose: number }): number => Number(!chosen.has(pose));
  for (const dot of [...dots].sort((a, b) => rank(a) - rank(b) || b.y - a.y || a.pose - b.pose)) {
    const near = placed.filter((other) => Math.abs(other.y - dot.y) < step);
    const room = (offset: number): number => Math.min(...near.map((other) => Math.hypot(other.x - middle - offset, other.y - dot.y)));
    const free = offsets.find((offset) => room(offset) >= step - 0.01);
    placed.push({ ...dot, x: middle + (free ?? fine.reduce((best, offset) => (room(offset) > room(best) ? offset : best), 0)) });
  }
  return placed.sort((a, b) => b.y - a.y || a.pose - b.pose);
}
