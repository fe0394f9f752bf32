// What a figure rests on: proven on the whole curve, seen at samples, not proven, or refuted by a pose.
import { Check, Result } from "./data";
import { figure, instant } from "./dom";

export type Standing = "proven" | "at samples" | "unproven" | "refuted";

const ORDER: Standing[] = ["proven", "at samples", "unproven", "refuted"];

export function standingOf(check: Check): Standing {
  if (!check.ok) return "refuted";
  if (check.basis === "unproven") return "unproven";
  return check.basis === "samples" ? "at samples" : "proven";
}

// The weakest of several; nothing stands on nothing.
export function weakest(checks: Check[]): Standing {
  return checks.length === 0 ? "unproven" : ORDER[Math.max(...checks.map((check) => ORDER.indexOf(standingOf(check))))];
}

// The check of a family (balance, zmp, torque, ...) with least to spare; a value that is missing is worse than any.
export function tightest(checks: Check[]): Check | undefined {
  const spare = (check: Check): number => (check.value ?? -Infinity) - (check.limit ?? 0);
  return checks.reduce<Check | undefined>((best, check) => (best && spare(best) <= spare(check) ? best : check), undefined);
}

// The failed checks that miss most of their limit, worst first; figures of different units are compared as shares.
export function listWorst(checks: Check[], most: number): Check[] {
  const miss = ({ value, limit }: Check): number => (typeof value === "number" ? Math.abs(value - (limit ?? 0)) : Infinity);
  const share = (check: Check): number =>
    typeof check.value !== "number" ? Infinity : miss(check) / Math.max(Math.abs(check.value), Math.abs(check.limit ?? 0), 1e-9);
  return checks.filter((check) => !check.ok).sort((a, b) => share(b) - share(a) || miss(b) - miss(a)).slice(0, most);
}

export const family = (result: Result, name: string): Check[] =>
  result.checks.filter((check) => check.name === name || check.name.startsWith(`${name}.`));

export interface Told { value: string; standing: Standing; text: string }

const at = (check: Check): string => (typeof check.where?.time_s === "number" ? ` (at ${instant(check.where.time_s)})` : "");

// The clearance of the whole motion as one figure; undefined without a certificate.
export function clearanceTold(result: Result): Told | undefined {
  const checks = family(result, "clearance");
  if (checks.length === 0) return undefined;
  const standing = weakest(checks);
  const worst = tightest(checks.filter((check) => standingOf(check) === standing))!;
  const isProven = standing === "proven" && typeof result.min_clearance_m === "number";
  const allowed = worst.limit ? `, ${figure(-worst.limit, "m")} allowed` : "";
  // In the certificate's own words.
  const said = `${worst.text ?? ""}${at(worst)}${allowed}`;
  const text = isProven ? `proven: ${worst.text ?? ""}` : standing === "proven" ? said : `${standing}: ${said}`;
  return { value: figure(isProven ? result.min_clearance_m : worst.value, "m"), standing, text };
}

// How far a balance point stays inside its polygon at least; where that is not enough, by how much.
export function insideTold(checks: Check[]): Told | undefined {
  const standing = weakest(checks);
  const least = (best: Check, check: Check): Check => ((check.value ?? -Infinity) < (best.value ?? -Infinity) ? check : best);
  const worst = standing === "refuted" ? tightest(checks.filter((check) => !check.ok)) : checks.length > 0 ? checks.reduce(least) : undefined;
  if (!worst) return undefined;
  const value = figure(worst.value, "m");
  const text = {
    proven: `${value} inside at least, proven`,
    "at samples": `${value} inside at least, at samples`,
    unproven: `${value} inside at samples, unproven`,
    refuted: typeof worst.value !== "number" ? "nowhere: nothing presses on the ground"
      : worst.value < 0 ? `${value}: outside${at(worst)}`
        : `${value} inside${at(worst)}, ${figure(worst.limit, "m")} needed`,
  }[standing];
  return { value, standing, text };
}

// What a verdict rests on, in one line.
export function basisTold(result: Result): string {
  const isAside = family(result, "clearance").some((check) => check.text?.includes("may touch aside"));
  const kinds: [string, string][] = [
    ["clearance", isAside ? "clearance of pairs that may not touch" : "clearance"], ["balance", "balance"], ["limits", "joint limits"], ["zmp", "ZMP"], ["torque", "torques"],
  ];
  // Joints without a limit, links without a mass: a check that could not fail is none.
  const isLeft = (text: string): boolean => result.not_checked.some((line) => line.startsWith(text));
  const named = (standing: Standing): string[] =>
    kinds.filter(([name, text]) => family(result, name).length > 0 && !isLeft(text) && weakest(family(result, name)) === standing).map(([, text]) => text);
  const list = (names: string[]): string => (names.length > 1 ? `${names.slice(0, -1).join(", ")} and ${names.at(-1)}` : names[0]);
  const parts = [
    [named("proven"), "proven on the whole curve"], [named("at samples"), "checked at samples"], [named("unproven"), "unproven"],
  ] as const;
  const told = parts.filter(([names]) => names.length > 0).map(([names, how]) => `${list([...names])} ${how}`);
  if (family(result, "start").length > 0) told.unshift("starts in collision, which its first phase leaves");
  if (result.not_checked.length > 0) told.push(`not checked: ${result.not_checked.join(", ")}`);
  return told.join("; ");
}
