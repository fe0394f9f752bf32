// The panel beside the scan: what was found and how well, the slice's place, what is shown, figures, notes.
import { el, figure, words } from "./dom";
import { Layer } from "./layer";
import { Hit, KnownMesh, Piece, Scan } from "./scene-data";
import { COLOURINGS, CONFIDENT, Colouring, Slice, legendOf } from "./scene-layers";

export interface Acts {
  toggle(layer: Layer): void;
  chooseHit(index: number): void;
  chooseMesh(index: number): void;
  choosePiece(index: number): void;
  moveSlice(axis: number, at: number): void;
  cut(on: boolean): void;
  colourBy(colouring: Colouring): void;
}

// Residuals and sizes are lengths unless their name says otherwise (docs/scene-format.md).
const UNITLESS = /^n_|_score$|_ratio$|^side$/;
const ANGLES = /_rad$|^ajar$/;
const SHARES = /_share$/;

// Which way a door's lever points.
const WAYS: Record<string, string> = { "-1": "towards the hinge", "0": "none", "1": "away from the hinge" };

function inUnits(name: string, value: number): string {
  if (name === "lever_direction") return WAYS[String(value)] ?? String(value);
  return figure(value, ANGLES.test(name) ? "rad" : SHARES.test(name) ? "1" : UNITLESS.test(name) ? null : "m");
}

// What the unit or the number says need not stand in the name.
const called = (name: string): string => words(name.replace(/^n_/, "").replace(/_(rad|share)$/, ""));

const listed = (values: Record<string, number>): string =>
  Object.entries(values).map(([name, value]) => `${called(name)} ${inUnits(name, value)}`).join(" · ");

function hitRow(hit: Hit, index: number, acts: Acts): HTMLElement {
  const isSure = hit.confidence >= CONFIDENT;
  const row = el("button", `check ${isSure ? "ok" : "unsure"}`);
  const place = hit.pose_world_object.slice(0, 3).map((line) => line[3].toFixed(3)).join(", ");
  row.append(
    el("span", "mark", isSure ? "✓" : "?"), el("span", "name", words(hit.kind)), el("span", "value", `${Math.round(100 * hit.confidence)} %`),
    el("span", "detail", `at (${place}) m`), el("span", "sizes", listed(hit.sizes)), el("span", "residuals", `residuals: ${listed(hit.residuals) || "none"}`),
  );
  row.title = "Look at it";
  row.addEventListener("click", () => acts.chooseHit(index));
  return row;
}

// Where a mesh stands, in words.
const PLACINGS: Record<string, string> = {
  given: "stands where it was placed", found: "stands where the scan shows it", gone: "is gone", "not found": "was not found",
};

function meshRow(mesh: KnownMesh, index: number, acts: Acts): HTMLElement {
  const isSure = mesh.confidence >= CONFIDENT;
  const row = el("button", `check mesh ${isSure ? "ok" : "unsure"}`);
  const place = mesh.pose_world_mesh?.slice(0, 3).map((line) => line[3].toFixed(3)).join(", ");
  const pieces = mesh.pieces.length === 1 ? "1 piece" : `${mesh.pieces.length} pieces`;
  row.append(
    el("span", "mark", isSure ? "✓" : "?"), el("span", "name", mesh.name), el("span", "value", `${Math.round(100 * mesh.confidence)} %`),
    el("span", "detail", place ? `${PLACINGS[mesh.placing]}, at (${place}) m` : PLACINGS[mesh.placing]),
    el("span", "sizes", `${mesh.file}, ${pieces}`), el("span", "residuals", `residuals: ${listed(mesh.residuals) || "none"}`),
  );
  row.title = "Look at it";
  row.addEventListener("click", () => acts.chooseMesh(index));
  return row;
}

export class ScenePanel {
  readonly element = el("aside", "panel");
  private readonly boxes = new Map<Layer, HTMLInputElement>();
  private readonly slider = el("input");
  private readonly cut = el("input");
  private readonly colouring = el("select");
  private readonly colours = el("p", "legend colours");
  private readonly readout = el("output", "value");
  private readonly axes: HTMLButtonElement[];
  private readonly hits: HTMLElement[];
  private readonly about = el("dl", "figures");

  constructor(private readonly scan: Scan, layers: Layer[], private readonly slice: Slice, private readonly acts: Acts) {
    const scroll = el("div", "scroll");
    this.element.append(scroll);
    this.hits = scan.detections.map((hit, i) => hitRow(hit, i, acts));
    scroll.append(el("h2", "", "Detections"), ...this.hitList(scan));
    if (scan.meshes.length > 0) {
      scroll.append(el("h2", "", "Known meshes"), el("div", "checks", ...scan.meshes.map((mesh, i) => meshRow(mesh, i, acts))));
    }
    scroll.append(el("h2", "", "Space, as the rays saw it"), this.sliceControl());
    this.axes = [...this.element.querySelectorAll<HTMLButtonElement>(".axis")];
    scroll.append(el("h2", "", "Shown"), this.layerList(layers));
    scroll.append(this.legend(), this.colourChoice(scan.pieces.some((piece) => piece.change !== null)), this.colours);
    scroll.append(el("h2", "", "Piece"), this.about);
    this.showPiece(undefined);
    const figures = el("dl", "figures");
    for (const [name, value] of Object.entries(scan.figures)) {
      figures.append(el("dt", "", words(name)), el("dd", "", String(value)));
    }
    scroll.append(el("h2", "", "Figures"), figures);
    if (scan.notes.length > 0) {
      const notes = el("ul", "notes", ...scan.notes.map((note) => el("li", "", note)));
      // What a user should read stands first.
      scroll.prepend(el("h2", "", "Notes"), notes);
    }
    this.refresh();
  }

  // The surest first; what is not sure enough to act on is folded away.
  private hitList(scan: Scan): HTMLElement[] {
    const order = scan.detections.map((_, i) => i).sort((a, b) => scan.detections[b].confidence - scan.detections[a].confidence);
    const [sure, weak] = [true, false].map((wanted) => order.filter((i) => scan.detections[i].confidence >= CONFIDENT === wanted));
    const asked = scan.kinds.length > 0 ? `looked for: ${scan.kinds.map(words).join(", ")}` : "no kind of object was looked for (--detect KIND, or all)";
    const list: HTMLElement[] = [el("p", "notes none", sure.length > 0 || scan.kinds.length === 0 ? asked : `${asked}; nothing found that is sure`)];
    if (sure.length > 0) list.push(el("div", "checks", ...sure.map((i) => this.hits[i])));
    if (weak.length > 0) {
      const summary = el("summary", "", `${weak.length} not sure enough to act on`);
      list.push(el("details", "weak", summary, el("div", "checks", ...weak.map((i) => this.hits[i]))));
    }
    return list;
  }

  private sliceControl(): HTMLElement {
    const { slider, slice } = this;
    slider.type = "range";
    slider.step = "0.01";
    slider.setAttribute("aria-label", "Place of the slice");
    slider.addEventListener("input", () => this.acts.moveSlice(slice.axis, Number(slider.value)));
    const choice = el("div", "segmented");
    ["x", "y", "z"].forEach((name, axis) => {
      const one = el("button", "axis", name);
      one.type = "button";
      one.title = `Slice square to ${name}`;
      one.addEventListener("click", () => {
        slice.axis = axis;
        const [low, high] = slice.range;
        this.acts.moveSlice(axis, (low + high) / 2);
      });
      choice.append(one);
    });
    const legend = el(
      "p", "legend", el("i", "swatch free"), "free  ", el("i", "swatch occupied"), "occupied  ", el("i", "swatch unseen"), "unseen",
    );
    legend.title = "Free: rays went through. Occupied: rays ended there. Unseen: neither.";
    const cut = el("label", "layer", this.cut, el("span", "name", "cut everything off at the slice"), el("kbd", "", "x"));
    this.cut.type = "checkbox";
    this.cut.addEventListener("change", () => this.acts.cut(this.cut.checked));
    return el("div", "slice", el("div", "line", choice, this.readout), slider, legend, cut);
  }

  private layerList(layers: Layer[]): HTMLElement {
    const list = el("div", "layers");
    for (const layer of layers) {
      const box = el("input");
      box.type = "checkbox";
      box.addEventListener("change", () => this.acts.toggle(layer));
      this.boxes.set(layer, box);
      const row = el("label", layer.count > 0 ? "layer" : "layer empty", box, el("span", "name", layer.label));
      row.append(el("span", "many", String(layer.count)), el("kbd", "", layer.key));
      list.append(row);
    }
    return list;
  }

  private colourChoice(hasChanges: boolean): HTMLElement {
    for (const [name, label] of Object.entries(COLOURINGS)) {
      if (name === "change" && !hasChanges) continue;
      const option = el("option", "", label);
      option.value = name;
      this.colouring.append(option);
    }
    this.colouring.setAttribute("aria-label", "Colour of pieces");
    this.colouring.addEventListener("change", () => this.acts.colourBy(this.colouring.value as Colouring));
    return el("label", "layer", el("span", "name", "pieces coloured by"), this.colouring, el("kbd", "", "k"));
  }

  private legend(): HTMLElement {
    return el(
      "p", "legend", el("i", "swatch ground"), "floor  ", el("i", "swatch nobody"), "in no piece  ", el("i", "swatch dropped"),
      "taken for strays",
    );
  }

  showPiece(piece: Piece | undefined): void {
    this.about.replaceChildren();
    if (!piece) {
      this.about.append(el("dt", "", "click one to read about it"), el("dd", "", ""));
      return;
    }
    const rows: [string, string][] = [["name", piece.name], ["kind", piece.kind], ["vertices", String(piece.hull.vertices.length / 3)]];
    if (piece.facts) {
      rows.push(
        ["points it stands for", String(piece.facts.points)], ["seen-free cells inside", String(piece.facts.free_cells)],
        ["share of it seen free", figure(piece.facts.free_share, "1")], ["surface next to free space", figure(piece.facts.open_share, "1")],
      );
    }
    for (const [name, value] of rows) this.about.append(el("dt", "", name), el("dd", "", value));
  }

  choose(hit: number): void {
    this.hits.forEach((row, i) => row.classList.toggle("chosen", i === hit));
    this.hits[hit]?.closest("details")?.setAttribute("open", "");
  }

  tell(isCut: boolean, colouring: Colouring): void {
    this.cut.checked = isCut;
    this.colouring.value = colouring;
    this.colours.replaceChildren(...legendOf(colouring, this.scan.pieces).flatMap(([text, colour]) => {
      const swatch = el("i", "swatch");
      swatch.style.background = colour.getStyle();
      return [swatch, `${text}  `];
    }));
  }

  refresh(): void {
    for (const [layer, box] of this.boxes) box.checked = layer.group.visible;
    const [low, high] = this.slice.range;
    Object.assign(this.slider, { min: low.toFixed(3), max: high.toFixed(3), value: this.slice.at.toFixed(3) });
    this.readout.textContent = `${"xyz"[this.slice.axis]} = ${this.slice.at.toFixed(2)} m`;
    this.axes.forEach((one, axis) => one.classList.toggle("on", axis === this.slice.axis));
  }
}
