// What is left over time: the clearance that the certificate proves, and how far COM and ZMP are inside the support.
import { Result, Support, rowAt, spanAt } from "./data";
import { el, figure, svg } from "./dom";
import { insideBy } from "./geometry";

interface Line { points: [number, number][]; kind: "value" | "second" | "limit" }

const least = (line: Line): number => Math.min(...line.points.map(([, value]) => value));

function plot(lines: Line[], start: number, end: number, note: string): HTMLElement {
  const values = lines.flatMap((line) => line.points.map(([, value]) => value));
  const top = Math.max(...values, 1e-3) * 1.15;
  const bottom = Math.min(0, ...values);
  const x = (t: number): string => ((1000 * (t - start)) / Math.max(end - start, 1e-9)).toFixed(1);
  const y = (value: number): string => (29 - (28 * (value - bottom)) / (top - bottom)).toFixed(2);
  const curve = svg("svg", { viewBox: "0 0 1000 30", preserveAspectRatio: "none", "aria-hidden": "true" });
  for (const { points, kind } of lines) {
    const d = points.map(([t, value], i) => `${i ? "L" : "M"}${x(t)} ${y(value)}`).join("");
    if (kind === "value") {
      const close = `L${x(points.at(-1)![0])} ${y(bottom)}L${x(points[0][0])} ${y(bottom)}Z`;
      curve.append(svg("path", { d: d + close, class: "area" }));
    }
    curve.append(svg("path", { d, class: kind }));
  }
  return el("div", "curve", curve, el("span", "note", note));
}

function clearance(result: Result, start: number, end: number): HTMLElement[] {
  const points: [number, number][] = [];
  for (let i = 0; i < result.clearance.length; i += 2) points.push([result.clearance[i], result.clearance[i + 1]]);
  if (points.length < 2) return [];
  const line: Line = { points, kind: "value" };
  const element = plot([line], start, end, `clearance ${figure(least(line), "m")} at least, proven`);
  element.classList.add("clearance");
  return [element];
}

function balance(result: Result, start: number, end: number): HTMLElement[] {
  const { support, times } = result;
  if (support.length === 0 || times.length < 2) return [];
  const com: Line = { points: [], kind: "value" };
  const zmp: Line = { points: [], kind: "second" };
  const wanted: Line = { points: [], kind: "limit" };
  for (let i = 0; i <= 240; i++) {
    const t = start + (i / 240) * (end - start);
    const current: Support | undefined = spanAt(support, t);
    if (!current || current.polygon.length < 3) continue;
    for (const [line, table, width] of [[com, result.com, 3], [zmp, result.zmp, 2]] as const) {
      const [x, y] = rowAt(times, table, width, t);
      if (Number.isFinite(x)) line.points.push([t, insideBy(current.polygon, x, y)]);
    }
    wanted.points.push([t, current.margin_m ?? 0]);
  }
  const lines = [com, zmp].filter((line) => line.points.length > 1);
  if (lines.length === 0) return [];
  const names = lines.map((line) => `${line === com ? "COM" : "ZMP"} ${figure(least(line), "m")}`);
  return [plot([...lines, wanted], start, end, `${names.join(", ")} inside at least, at samples`)];
}

export function curves(result: Result, start: number, end: number): HTMLElement[] {
  return [...clearance(result, start, end), ...balance(result, start, end)];
}
