// The graph of poses as a picture in the panel: a column per sampled phase, a dot per pose, the chosen path as a line.
import { button, el, figure, svg } from "./dom";
import { PoseGraph } from "./pose-data";
import { Dot, Layout, Measure, layOut } from "./pose-layout";

const HEIGHT = 190;
const GUTTER = 52;   // of the scale, and of the names of the counts
const LEAST = 36;    // width of a column
const REACH = 12;    // of the pointer to a dot
const CAPTIONS: Record<Measure, string> = {
  "to the end": "cost to the end above the phase's cheapest pose", pose: "cost of the pose",
};

export interface PoseChoice { show(phase: number, pose: number): void }

export class PoseGraphView {
  readonly element: HTMLElement;
  private readonly host = el("div", "graph");
  private readonly said = el("p", "graph-said");
  private readonly caption = el("p", "graph-caption");
  private readonly heads: HTMLButtonElement[];
  private readonly modes: Map<Measure, HTMLButtonElement>;
  private measure: Measure = "to the end";
  private layout: Layout | undefined;
  private picture: SVGElement = svg("svg", {});
  private phase = -1;
  private selected = -1;
  private strong = -1;
  private width = 0;

  constructor(private readonly graph: PoseGraph, private readonly choice: PoseChoice) {
    const names = ["to the end", "pose"] as const;
    this.modes = new Map(names.map((name) => [name, button("", name, `Place the poses by ${CAPTIONS[name]}`, () => this.setMeasure(name))]));
    this.heads = graph.phases.map((phase, k) =>
      button("head-of", phase.name, `Show the poses of ${phase.name} in the scene`, () => this.toggle(k)));
    const title = el("div", "graph-title", el("h2", "", "Graph of poses"), el("div", "segmented", ...this.modes.values()));
    this.host.tabIndex = 0;
    this.host.setAttribute("role", "group");
    this.host.setAttribute("aria-label", "Graph of poses: arrow keys select a pose");
    this.said.setAttribute("aria-live", "polite");
    const table = el("div", "graph-table", this.host, el("span", ""), ...this.heads, ...this.counts());
    table.style.gridTemplateColumns = `${GUTTER}px repeat(${graph.phases.length}, minmax(${LEAST}px, 1fr))`;
    this.element = el("section", "poses", title, this.caption, el("div", "graph-scroll", table), this.said, ...this.outcome());
    this.listen();
    this.setMeasure("to the end");
    new ResizeObserver(() => this.resize()).observe(this.host);
  }

  private counts(): HTMLElement[] {
    return (["solved", "feasible", "duplicates"] as const).flatMap((key) => [
      el("span", "graph-count", key),
      ...this.graph.phases.map((phase) => el("b", phase[key] === 0 && key === "feasible" ? "bad" : "", String(phase[key]))),
    ]);
  }

  private outcome(): HTMLElement[] {
    const { graph } = this;
    const parts: HTMLElement[] = [];
    if (graph.path.length > 0) {
      const slip = graph.slip_m === null ? "" : `; kept contacts move ${figure(graph.slip_m, "m")} before it is linked`;
      parts.push(el("p", "graph-sum", `The chosen sequence costs ${figure(graph.cost, null)}${slip}.`));
    } else {
      const empty = graph.phases.filter((phase) => phase.feasible === 0).map((phase) => `'${phase.name}'`);
      parts.push(el("p", "graph-sum bad", empty.length > 0 ? `No sequence: no pose of ${empty.join(", ")} holds.` : "No sequence could be linked."));
    }
    if (graph.left_out > 0) parts.push(el("p", "graph-sum", `${graph.left_out} more poses are not in the picture.`));
    const n = graph.not_linked.length;
    if (n > 0) {
      const what = `${n} ${n === 1 ? "sequence" : "sequences"} could not be linked`;
      const list = el("details", "weak", el("summary", "", what), el("ul", "notes not-linked", ...graph.not_linked.map((line) => el("li", "", line))));
      list.open = n <= 3;
      parts.push(list);
    }
    return parts;
  }

  private setMeasure(measure: Measure): void {
    this.measure = measure;
    for (const [name, item] of this.modes) {
      item.classList.toggle("on", name === measure);
      item.setAttribute("aria-pressed", String(name === measure));
    }
    this.caption.textContent = CAPTIONS[measure];
    this.draw();
  }

  private resize(): void {
    const width = this.host.clientWidth;
    if (width === 0 || width === this.width) return;
    this.width = width;
    this.draw();
  }

  // The strong pose is the selected one or that of the path; -1 is none.
  mark(phase: number, selected: number, strong: number): void {
    this.phase = phase;
    this.selected = selected;
    this.strong = strong;
    this.heads.forEach((head, k) => {
      head.classList.toggle("on", k === phase);
      head.setAttribute("aria-pressed", String(k === phase));
    });
    this.draw();
    this.say(-1);
  }

  private draw(): void {
    if (this.width === 0) return;
    const frame = { left: GUTTER, width: this.width - GUTTER, top: 12, height: HEIGHT - 24 };
    this.layout = layOut(this.graph, this.measure, frame);
    const { dots, ticks, columns, radius } = this.layout;
    const picture = svg("svg", { width: String(this.width), height: String(HEIGHT), "aria-hidden": "true" });
    columns.forEach(({ left, width }, k) => {
      const kind = k === this.phase ? "column on" : k % 2 === 0 ? "column" : "column odd";
      picture.append(svg("rect", { x: left.toFixed(1), y: "0", width: width.toFixed(1), height: String(HEIGHT), class: kind }));
    });
    for (const { y, text } of ticks) {
      picture.append(svg("path", { d: `M${GUTTER} ${y.toFixed(1)}H${this.width}`, class: "level" }));
      const label = svg("text", { x: String(GUTTER - 6), y: (y + 3.5).toFixed(1), class: "tick-text" });
      label.textContent = text;
      picture.append(label);
    }
    const at = new Map(dots.map((dot) => [dot.pose, dot]));
    const steps = this.graph.path.flatMap((pose) => at.get(pose) ?? []);
    if (steps.length > 1) {
      const d = steps.map(({ x, y }, i) => `${i ? "L" : "M"}${x.toFixed(1)} ${y.toFixed(1)}`).join("");
      picture.append(svg("path", { d, class: "chosen-path" }));
    }
    const chosen = new Set(this.graph.path);
    const rank = ({ pose }: Dot): number => (pose === this.strong ? 2 : chosen.has(pose) ? 1 : 0);  // the later, the higher
    for (const dot of [...dots].sort((a, b) => rank(a) - rank(b))) {
      const isChosen = chosen.has(dot.pose);
      const kind = [
        "dot", isChosen ? "chosen" : "", dot.isOpen ? "open" : "", dot.pose === this.strong ? "strong" : "",
        dot.pose === this.selected ? "selected" : "",
      ];
      const circle = svg("circle", {
        cx: dot.x.toFixed(1), cy: dot.y.toFixed(1), r: String(isChosen ? radius + 1.2 : radius), class: kind.filter(Boolean).join(" "),
      });
      circle.dataset.pose = String(dot.pose);
      picture.append(circle);
    }
    this.host.replaceChildren(picture);
    this.picture = picture;
  }

  // The dot nearest to the pointer within its reach, also where dots cover each other.
  private under(event: MouseEvent): number {
    const rect = this.picture.getBoundingClientRect();
    const away = ({ x, y }: Dot): number => Math.hypot(event.clientX - rect.left - x, event.clientY - rect.top - y);
    const near = (this.layout?.dots ?? []).filter((dot) => away(dot) <= REACH).sort((a, b) => away(a) - away(b));
    if (near.length > 0) return near[0].pose;
    const target = event.target;
    return target instanceof SVGElement ? Number(target.dataset.pose ?? -1) : -1;
  }

  private listen(): void {
    this.host.addEventListener("pointermove", (event) => {
      const pose = this.under(event);
      this.host.classList.toggle("over", pose >= 0);
      this.say(pose);
    });
    this.host.addEventListener("pointerleave", () => this.say(-1));
    this.host.addEventListener("click", (event) => {
      const pose = this.under(event);
      if (pose >= 0) this.select(pose === this.selected ? -1 : pose);
    });
    this.host.addEventListener("keydown", (event) => {
      const next = this.neighbour(event.key);
      if (next === undefined) return;
      event.preventDefault();
      event.stopPropagation();  // arrows are keys of the time bar elsewhere
      if (next >= 0) this.select(next);
    });
    this.heads.forEach((head, k) => {
      head.addEventListener("pointerenter", () => this.sayPhase(k));
      head.addEventListener("pointerleave", () => this.say(-1));
    });
  }

  // The dot an arrow key leads to from the strong one; -1 at the border, undefined for other keys.
  private neighbour(key: string): number | undefined {
    const along = { ArrowLeft: -1, ArrowRight: 1 }[key];
    const up = { ArrowUp: 1, ArrowDown: -1 }[key];
    if ((along === undefined && up === undefined) || !this.layout) return undefined;
    const { dots } = this.layout;
    const from = dots.find((dot) => dot.pose === (this.selected >= 0 ? this.selected : this.strong));
    if (!from) return this.graph.path[0] ?? dots[0]?.pose ?? -1;
    const own = this.graph.poses[from.pose].phase;
    if (up !== undefined) {
      const column = dots.filter((dot) => this.graph.poses[dot.pose].phase === own);
      return column[column.indexOf(from) + up]?.pose ?? -1;
    }
    for (let phase = own + along!; phase >= 0 && phase < this.graph.phases.length; phase += along!) {
      const column = dots.filter((dot) => this.graph.poses[dot.pose].phase === phase);
      const isChosen = this.graph.path.includes(from.pose);
      const best = [...column].sort((a, b) => Math.abs(a.y - from.y) - Math.abs(b.y - from.y));
      const next = column.find((dot) => isChosen && this.graph.path.includes(dot.pose)) ?? best[0];
      if (next) return next.pose;
    }
    return -1;
  }

  private select(pose: number): void {
    this.choice.show(pose < 0 ? this.phase : this.graph.poses[pose].phase, pose);
  }

  private toggle(phase: number): void { this.choice.show(phase === this.phase ? -1 : phase, -1); }

  // What is known of a pose; with -1 of the strong one.
  private say(hovered: number): void {
    const index = hovered >= 0 ? hovered : this.strong >= 0 ? this.strong : this.selected;
    const pose = this.graph.poses[index];
    if (!pose) return this.said.replaceChildren("A dot shows its pose in the scene, a name all poses of the phase.");
    const which = this.graph.path.includes(index) ? ", chosen" : "";
    const onwards = pose.cost_to_end === null ? "no sequence to the end" : `to the end ${figure(pose.cost_to_end, null)}`;
    const lacks = pose.drawn < 0 ? " · too many poses: not drawn in the scene" : "";
    this.said.replaceChildren(
      el("b", "", this.graph.phases[pose.phase].name), ` · place ${pose.place}${which}`, el("br"),
      `cost ${figure(pose.cost, null)} · ${onwards}${lacks}`,
    );
  }

  private sayPhase(k: number): void {
    const { name, solved, feasible, duplicates, failures, other_failures } = this.graph.phases[k];
    const alike = duplicates > 0 ? `, ${duplicates} of them alike` : "";
    const why = failures.map(([text, count]) => (count > 1 ? `${text} (${count} times)` : text));
    if (other_failures > 0) why.push(`${other_failures} others`);
    this.said.replaceChildren(
      el("b", "", name), ` · ${feasible} of ${solved} poses hold${alike}`, ...why.map((line) => el("span", "why-not", line)),
    );
  }
}
