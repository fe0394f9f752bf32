// Small helpers to build the page; text never goes through innerHTML.

export function el<K extends keyof HTMLElementTagNameMap>(
  tag: K, className = "", ...content: (Node | string)[]
): HTMLElementTagNameMap[K] {
  const element = document.createElement(tag);
  if (className) element.className = className;
  element.append(...content);
  return element;
}

export function button(className: string, text: string, title: string, act: () => void): HTMLButtonElement {
  const element = el("button", className, text);
  element.type = "button";
  element.title = title;
  element.setAttribute("aria-label", title);
  element.addEventListener("click", act);
  return element;
}

export function svg(tag: string, attributes: Record<string, string>): SVGElement {
  const element = document.createElementNS("http://www.w3.org/2000/svg", tag);
  for (const [name, value] of Object.entries(attributes)) element.setAttribute(name, value);
  return element;
}

// A 24-unit icon drawn from one path.
export function icon(path: string): SVGElement {
  const element = svg("svg", { viewBox: "0 0 24 24", width: "18", height: "18", "aria-hidden": "true" });
  element.append(svg("path", { d: path, fill: "currentColor" }));
  return element;
}

const digits = (value: number): string => {
  const size = Math.abs(value);
  if (size === 0) return "0";
  if (size < 1e-3 || size >= 1e5) return value.toExponential(1).replaceAll("-", "−");
  return String(Number(value.toPrecision(size >= 100 ? 4 : 3))).replace("-", "−");
};

// A figure in the unit people say it in: small metres as millimetres, radians as degrees.
export function figure(value: number | null | undefined, unit: string | null | undefined): string {
  if (value === null || value === undefined) return "–";
  if (unit === "m" && value !== 0 && Math.abs(value) < 5e-7) return "< 0.001 mm";
  if (unit === "m" && Math.abs(value) < 0.9995) return `${digits(1000 * value)} mm`;
  const degrees = unit === "rad" ? (180 / Math.PI) * value : unit === "deg" ? value : NaN;
  if (degrees !== 0 && Math.abs(degrees) < 5e-4) return "< 0.001°";
  if (unit === "1") return `${digits(100 * value)} %`;
  if (Number.isFinite(degrees)) return `${digits(degrees)}°`;
  return unit && unit !== "-" ? `${digits(value)} ${unit}` : digits(value);
}

export const seconds = (t: number): string => `${t.toFixed(2)} s`;
// A place along the motion: a time, or of an untimed motion the path parameter.
let isTimed = true;
export function tellTimes(timed: boolean): void { isTimed = timed; }
export const instant = (t: number): string => (isTimed ? seconds(t) : `${t.toFixed(2)} along the path`);
// check.names.with_links read "check · names · with_links".
export const title = (name: string): string => name.replaceAll(".", " · ");
export const words = (name: string): string => name.replaceAll("_", " ");
