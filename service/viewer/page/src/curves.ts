// What is left over time: the clearance that the certificate proves, and how far COM and ZMP are inside the support.
import { Movable, Result, frameAt } from "./data";
import { el, figure, svg, words } from "./dom";
import { insideBy } from "./geometry";
import { Told, clearanceTold, family, insideTold, standingOf } from "./standing";

type Point = [number, number];
export interface Line { name: string; points: Point[]; kind: "value" | "second" | "limit" | "refuted" | "unproven" }
export interface Plot { element: HTMLElement; lines: Line[] }
interface Band { start: number; end: number; title: string; kind: "gap" | "gap bad" }

const finite = (lines: Line[]): number[] => lines.flatMap((line) => line.points.map(([, value]) => value)).filter(Number.isFinite);

function plot(lines: Line[], bands: Band[], start: number, end: number, note: string, standing: string): Plot {
  const values = finite(lines);
  const top = Math.max(...values, 1e-3) * 1.15;
  const bottom = Math.min(0, ...values);
  const at = (t: number): number => (1000 * (t - start)) / Math.max(end - start, 1e-9);
  const x = (t: number): string => at(t).toFixed(1);
  const y = (value: number): string => (29 - (28 * (value - bottom)) / (top - bottom)).toFixed(2);
  const curve = svg("svg", { viewBox: "0 0 1000 30", preserveAspectRatio: "none", "aria-hidden": "true" });
  for (const band of bands) {
    const width = Math.max(at(band.end) - at(band.start), 1).toFixed(1);
    const box = svg("rect", { x: x(band.start), y: "0", width, height: "30", class: band.kind });
    const title = svg("title", {});
    title.textContent = band.title;
    box.append(title);
    curve.append(box);
  }
  for (const { points, kind } of lines) {
    if (kind === "refuted" || kind === "unproven") {
      for (const [t, value] of points) curve.append(svg("path", { d: `M${x(t)} ${y(0)}L${x(t)} ${y(value)}`, class: kind }));
      continue;
    }
    for (const run of runs(points)) {
      const d = run.map(([t, value], i) => `${i ? "L" : "M"}${x(t)} ${y(value)}`).join("");
      if (kind === "value") {
        const close = `L${x(run.at(-1)![0])} ${y(bottom)}L${x(run[0][0])} ${y(bottom)}Z`;
        curve.append(svg("path", { d: d + close, class: "area" }));
      }
      curve.append(svg("path", { d, class: kind }));
    }
  }
  return { element: el("div", "curve", curve, el("span", `note ${standing.replaceAll(" ", "-")}`, note)), lines };
}

// The stretches of a line between points that have no value.
function runs(points: Point[]): Point[][] {
  const found: Point[][] = [[]];
  for (const point of points) {
    if (Number.isFinite(point[1])) found.at(-1)!.push(point);
    else if (found.at(-1)!.length > 0) found.push([]);
  }
  return found.filter((run) => run.length > 0);
}

function clearance(result: Result, start: number, end: number): Plot[] {
  const told = clearanceTold(result);
  const points: Point[] = [];
  for (let i = 0; i < result.clearance.length; i += 2) points.push([result.clearance[i], result.clearance[i + 1]]);
  if (!told || points.length < 2) return [];
  // Where a pair's clearance is not shown there is no bound of all pairs.
  const isOpen = (t: number): boolean => result.gaps.some((gap) => t >= gap.start && t <= gap.end);
  const proven: Line = { name: "clearance", kind: "value", points: points.map(([t, value]) => [t, isOpen(t) ? NaN : value]) };
  const marks = (["refuted", "unproven"] as const).map((kind): Line => ({
    name: kind, kind,
    points: family(result, "clearance").filter((check) => standingOf(check) === kind && typeof check.where?.time_s === "number")
      .map((check) => [check.where!.time_s!, check.value ?? 0]),
  }));
  const isRefuted = (names: string[]): boolean => family(result, "clearance").some((check) =>
    standingOf(check) === "refuted" && [...(check.where?.names ?? [])].sort().join() === [...names].sort().join());
  const bands = result.gaps.map((gap): Band => ({
    ...gap, kind: isRefuted(gap.names) ? "gap bad" : "gap",
    title: `clearance of ${gap.names.join(" and ")} ${isRefuted(gap.names) ? "refuted here or in this phase" : "unproven"}`,
  }));
  const drawn = plot([proven, ...marks.filter((line) => line.points.length > 0)], bands, start, end, told.text, told.standing);
  drawn.element.classList.add("clearance");
  return [drawn];
}

function balance(result: Result, start: number, end: number): Plot[] {
  const com: Line = { name: "COM", points: [], kind: "value" };
  const zmp: Line = { name: "ZMP", points: [], kind: "second" };
  const wanted: Line = { name: "margin", points: [], kind: "limit" };
  for (const support of result.support) {
    if (support.polygon.length < 3) continue;
    const span: Point[] = [];
    const [from] = frameAt(result.times, support.start);
    for (let frame = from; frame < result.times.length && result.times[frame] <= support.end + 1e-5; frame++) {
      const [x, y] = result.com.subarray(3 * frame, 3 * frame + 2);
      if (result.times[frame] >= support.start - 1e-5 && Number.isFinite(x)) span.push([result.times[frame], insideBy(support.polygon, x, y)]);
    }
    // Where the certificate found least to spare lies between frames: it belongs to the line.
    for (const { where, value } of family(result, "balance")) {
      const t = where?.time_s;
      if (typeof t !== "number" || typeof value !== "number" || t < support.start - 1e-6 || t > support.end + 1e-6) continue;
      if (span.length > 0) span.push([t, value]);
    }
    com.points.push(...span.sort((a, b) => a[0] - b[0]));
    for (let i = 0; i < support.zmp.length; i += 3) {
      zmp.points.push([support.zmp[i], insideBy(support.polygon, support.zmp[i + 1], support.zmp[i + 2])]);
    }
    for (const t of [support.start, support.end]) wanted.points.push([t, support.margin_m ?? 0]);
  }
  const told: [Line, Told | undefined][] = [[com, insideTold(family(result, "balance"))], [zmp, insideTold(family(result, "zmp"))]];
  const lines = told.filter(([line]) => finite([line]).length > 1);
  if (lines.length === 0) return [];
  const notes = lines.map(([line, said]) => `${line.name} ${said ? said.text : "not checked"}`);
  const standing = lines.some(([, said]) => said?.standing === "refuted") ? "refuted"
    : lines.some(([, said]) => !said || said.standing === "unproven") ? "unproven" : "proven";
  return [plot([...lines.map(([line]) => line), wanted], [], start, end, notes.join("; "), standing)];
}

// How far a joint of what is moved is turned [deg] or shifted [mm].
function joint(result: Result, movable: Movable, start: number, end: number): Plot[] {
  if (movable.angles.length < 2) return [];
  const [factor, unit] = movable.type === "prismatic" ? [1000, "mm"] : [180 / Math.PI, "deg"];
  const values = Array.from(movable.angles, (value) => factor * value);
  const line: Line = { name: movable.joint || movable.name, kind: "value", points: values.map((value, i) => [result.times[i], value]) };
  const range = [Math.min(...values), Math.max(...values)].map((value) => figure(Math.abs(value) < 0.05 ? 0 : Number(value.toFixed(1)), unit));
  const drawn = plot([line], [], start, end, `${words(movable.joint || movable.name)}: ${range.join(" to ")}`, "");
  drawn.element.classList.add("moved");
  return [drawn];
}

// The ground's force that the plan expects, and what it was in physics [N].
function ground(result: Result, start: number, end: number): Plot[] {
  if (!result.simulated || result.simulated.ground.length < 4) return [];
  const { times, ground: forces } = result.simulated;
  const column = (k: number): Point[] => Array.from(times, (t, i): Point => [t, forces[2 * i + k]]).filter(([t]) => t <= end + 1e-6);
  const lines: Line[] = [
    { name: "ground in physics", kind: "value", points: column(1) }, { name: "ground planned", kind: "second", points: column(0) },
  ];
  const range = [Math.min(...finite([lines[0]])), Math.max(...finite([lines[0]]))].map((value) => figure(Math.round(value), "N"));
  const drawn = plot(lines, [], start, end, `ground in physics: ${range.join(" to ")}; thin: planned`, "");
  drawn.element.classList.add("moved");
  return [drawn];
}

export function curves(result: Result, start: number, end: number): Plot[] {
  return [...clearance(result, start, end), ...balance(result, start, end), ...ground(result, start, end), ...result.movables.flatMap((movable) => joint(result, movable, start, end))];
}
