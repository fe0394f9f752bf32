// The side panel: what stands in the way, the checks with their figures, the current phase, layers, notes.
import { Allowance, BodyRef, Check, Contact, Phase, Result } from "./data";
import { button, el, figure, instant, seconds, title, words } from "./dom";
import { Layer } from "./layer";
import { Standing, standingOf } from "./standing";

function section(title: string, ...content: (Node | string)[]): HTMLElement {
  return el("section", "", el("h2", "", title), ...content);
}

function table(rows: [string, string][]): HTMLElement {
  return el("dl", "figures", ...rows.flatMap(([name, value]) => [el("dt", "", name), el("dd", "", value)]));
}

function asText(value: unknown): string {
  if (typeof value === "number") return figure(value, null);
  if (Array.isArray(value)) return value.map(asText).join(", ");
  return typeof value === "object" && value !== null ? JSON.stringify(value) : String(value);
}

// turned_deg: 360 reads "turned 360°".
function figureRow([name, value]: [string, unknown]): [string, string] {
  const unit = /_(deg|rad|m|s)$/.exec(name)?.[1];
  if (typeof value === "number" && unit) return [words(name.slice(0, -unit.length - 1)), figure(value, unit)];
  return [words(name), asText(value)];
}

const ORDER: Standing[] = ["refuted", "unproven", "proven", "at samples"];
const MARKS = { ok: "✓", unsure: "?", fail: "✕" };
// Checks that every phase may have, as the panel names them.
const OF_A_PHASE = [["balance", "COM inside", "m"], ["zmp", "ZMP inside", "m"], ["torque", "largest torque", "1"]] as const;
function named(ref: BodyRef): string {
  return ref.body ?? ref.link ?? "";
}

// l_foot (friction 0.6, to 900 N)
function planted({ link, friction, force_cap_n }: Contact): string {
  const said = [
    typeof friction === "number" ? `friction ${figure(friction, null)}` : "",
    typeof force_cap_n === "number" ? `to ${figure(force_cap_n, "N")}` : "",
  ].filter(Boolean);
  return said.length > 0 ? `${link} (${said.join(", ")})` : link;
}

// One line for all bodies of a link that may be touched alike: l_hook ↔ valve/rim/0 … valve/rim/19 (20), to 30 mm.
function touching(allowances: Allowance[]): string[] {
  const groups = new Map<string, Allowance[]>();
  for (const allowance of allowances) {
    const { first, second, depth } = allowance;
    const key = JSON.stringify([first, second.owner, second.link ?? second.body, depth]);
    groups.set(key, [...(groups.get(key) ?? []), allowance]);
  }
  return [...groups.values()].map((group) => {
    const names = group.map((allowance) => named(allowance.second));
    const others = names.length > 1 ? `${names[0]} … ${names.at(-1)} (${names.length})` : names[0];
    return `${named(group[0].first)} ↔ ${others}, to ${figure(group[0].depth, "m")}`;
  });
}

export class Panel {
  readonly element = el("aside", "panel");
  private readonly phase = el("div", "now");
  private readonly rows = new Map<number, HTMLElement>();
  private readonly boxes = new Map<Layer, HTMLInputElement>();
  private shown: Phase | undefined;

  constructor(private readonly result: Result, layers: Layer[], choose: (index: number) => void, toggle: (layer: Layer) => void) {
    // What failed first, then the clearance of the whole curve, then as the certificate has them.
    const rank = (check: Check): number => Math.min(ORDER.indexOf(standingOf(check)), 2) - 0.5 * Number(check.name === "clearance");
    const order = result.checks.map((_, i) => i).sort((a, b) => rank(result.checks[a]) - rank(result.checks[b]));
    const count = (standing: Standing): number => result.checks.filter((check) => standingOf(check) === standing).length;
    const [failed, unproven] = [count("refuted"), count("unproven")];
    const scroll = el("div", "scroll");
    if (result.simulated && result.simulated.reasons.length > 0) {
      const reasons = result.simulated.reasons.map((line) => el("li", "", line));
      scroll.append(section(`In physics: ${result.simulated.verdict}`, el("ul", "why", ...reasons)));
    }
    if (result.explanation.length > 0) {
      scroll.append(section("What stands in the way", el("ul", "why", ...result.explanation.map((line) => el("li", "", line)))));
    }
    if (result.checks.length > 0) {
      const all = result.checks.length;
      const open = unproven > 0 ? `, ${unproven} unproven` : "";
      const held = unproven > 0 ? `${all - unproven} of ${all} hold` : `all ${all} hold`;
      const summary = failed > 0 ? `Checks · ${failed} of ${all} failed${open}` : `Checks · ${held}${open}`;
      const rows = order.map((i) => this.check(result.checks[i], i, choose));
      scroll.append(section(summary, el("div", rows.length > 12 ? "checks dense" : "checks", ...rows)));
    }
    if (result.phases.length > 0) scroll.append(section("Now", this.phase));
    scroll.append(section("Layers", el("div", "layers", ...layers.map((layer) => this.layer(layer, toggle)))));
    const figures = Object.entries(result.figures).map(figureRow);
    if (figures.length > 0) scroll.append(section("Figures", table(figures)));
    if (result.shapeless.length > 0) {
      const n = result.shapeless.length;
      const names = el("ul", "notes", ...result.shapeless.map((name) => el("li", "", name)));
      const said = "Nothing of them is checked; a cross marks where each is.";
      scroll.append(section(`${n} ${n === 1 ? "link" : "links"} without a collision shape`, el("p", "shapeless", said), names));
    }
    if (result.notes.length > 0) scroll.append(section("Notes", el("ul", "notes", ...result.notes.map((line) => el("li", "", line)))));
    const timings = Object.entries(result.timings).map(([name, value]): [string, string] => [words(name), seconds(Number(value))]);
    if (result.rests_on.length > 0) {
      scroll.append(section("What the certificate says", el("ul", "notes", ...result.rests_on.map((line) => el("li", "", line)))));
    }
    if (typeof result.planning_time_s === "number") timings.push(["all of it", seconds(result.planning_time_s)]);
    if (timings.length > 0) scroll.append(section("Planning", table(timings)));
    if (result.request_hash) scroll.append(el("p", "hash", result.request_hash));
    this.element.append(this.grip(), scroll);
  }

  private check(check: Check, index: number, choose: (index: number) => void): HTMLElement {
    const hasValue = check.value !== null && check.value !== undefined;
    const limit = check.limit === null || check.limit === undefined ? "" : `limit ${figure(check.limit, check.unit)}`;
    const standing = standingOf(check);
    const kind = standing === "refuted" ? "fail" : standing === "unproven" ? "unsure" : "ok";
    const row = button(`check ${kind}`, "", `Show where: ${check.name}`, () => choose(index));
    row.append(
      el("span", "mark", MARKS[kind]), el("span", "name", title(check.name)),
      el("span", "value", hasValue ? figure(check.value, check.unit) : ""), el("span", "limit", limit),
    );
    const where = check.where ?? {};
    const place = [...(where.names ?? []).slice(0, 1), ...(where.names ?? []).slice(1, 2)].join(" ↔ ");
    const time = typeof where.time_s === "number" ? `t ${instant(where.time_s)}` : "";
    const detail = [place, time, standing === "at samples" || standing === "unproven" ? standing : ""].filter(Boolean).join(" · ");
    row.append(el("span", "detail", detail));
    if (check.text) row.title = check.text;
    if (check.text) row.append(el("span", "text", check.text));
    this.rows.set(index, row);
    return row;
  }

  private layer(layer: Layer, toggle: (layer: Layer) => void): HTMLElement {
    const box = el("input");
    box.type = "checkbox";
    box.checked = layer.group.visible;
    box.disabled = layer.count === 0 && layer.name !== "floor" && layer.name !== "checks";
    box.addEventListener("change", () => toggle(layer));
    this.boxes.set(layer, box);
    const count = layer.count > 0 && layer.name !== "checks" ? layer.count.toLocaleString("en") : "";
    const row = el("label", box.disabled ? "layer empty" : "layer", box, el("span", "name", layer.label), el("span", "many", count));
    row.append(el("kbd", "", layer.key));
    return row;
  }

  // The panel's width follows its left edge.
  private grip(): HTMLElement {
    const grip = el("div", "grip");
    grip.addEventListener("pointerdown", (event) => grip.setPointerCapture(event.pointerId));
    grip.addEventListener("pointermove", (event) => {
      if (!grip.hasPointerCapture(event.pointerId)) return;
      const width = Math.min(Math.max(window.innerWidth - event.clientX, 240), 0.6 * window.innerWidth);
      document.documentElement.style.setProperty("--panel", `${width}px`);
    });
    return grip;
  }

  // Put a section before the checks, after what stands in the way.
  insert(section: HTMLElement): void {
    const why = this.element.querySelector(".why")?.closest("section");
    if (why) why.after(section);
    else this.element.querySelector(".scroll")!.prepend(section);
  }

  select(index: number): void {
    for (const [i, row] of this.rows) row.classList.toggle("chosen", i === index);
    this.rows.get(index)?.scrollIntoView({ block: "nearest" });
  }

  setLayer(layer: Layer): void { this.boxes.get(layer)!.checked = layer.group.visible; }

  setPhase(phase: Phase | undefined): void {
    if (phase === this.shown) return;
    this.shown = phase;
    if (!phase) return this.phase.replaceChildren();
    const rows: [string, string][] = [["phase", words(phase.name)]];
    const contacts = (phase.contacts ?? []).map(planted);
    if (contacts.length > 0) rows.push(["planted", contacts.join(", ")]);
    for (const { tool, link, force_n } of phase.loads ?? []) {
      rows.push(["load", `${tool} on ${link}, up to ${figure(Math.hypot(...force_n), "N")}`]);
    }
    for (const { surface, body, joint, friction } of phase.hand_contacts ?? []) {
      rows.push(["push", `${surface} on ${body} moves ${joint}, friction ${friction.map((value) => figure(value, null)).join(" to ")}`]);
    }
    const targets = (phase.targets ?? []).map((target) => [target.frame, target.kind].filter(Boolean).join(" on "));
    if (targets.length > 0) rows.push(["target", [...new Set(targets)].join(", ")]);
    for (const [kind, name, unit] of OF_A_PHASE) {
      const check = this.result.checks.find((one) => one.name === `${kind}.${phase.name}`);
      if (check) rows.push([name, `${figure(check.value, check.unit ?? unit)}, ${standingOf(check)}`]);
    }
    rows.push(...touching(phase.allowances ?? []).map((row): [string, string] => ["may touch", row]));
    this.phase.replaceChildren(table(rows));
  }
}
