// The panel beside the scan: what was found and how well, the slice's place, what is shown, figures, notes.
import { el, figure, words } from "./dom";
import { Layer } from "./layer";
import { Hit, Piece, Scan } from "./scene-data";
import { CONFIDENT, Slice } from "./scene-layers";

export interface Acts {
  toggle(layer: Layer): void;
  chooseHit(index: number): void;
  choosePiece(index: number): void;
  moveSlice(axis: number, at: number): void;
}

const UNITLESS = /count|^n_|share|side|direction|spokes|inliers|score|ratio|coverage|fraction|support/;
const ANGLES = /angle|tilt|ajar|spin|_rad$/;

// Residuals and sizes are lengths unless their name says otherwise.
function inUnits(name: string, value: number): string {
  if (/_deg$/.test(name)) return figure(value, "deg");
  return figure(value, ANGLES.test(name) ? "rad" : UNITLESS.test(name) ? null : "m");
}

const listed = (values: Record<string, number>): string =>
  Object.entries(values).map(([name, value]) => `${words(name)} ${inUnits(name, value)}`).join(" · ");

function hitRow(hit: Hit, index: number, acts: Acts): HTMLElement {
  const isSure = hit.confidence >= CONFIDENT;
  const row = el("button", `check ${isSure ? "ok" : "unsure"}`);
  const place = hit.pose_world_object.slice(0, 3).map((line) => line[3].toFixed(3)).join(", ");
  row.append(
    el("span", "mark", isSure ? "✓" : "?"), el("span", "name", words(hit.kind)), el("span", "value", `${Math.round(100 * hit.confidence)} %`),
    el("span", "detail", `at (${place}) m`), el("span", "sizes", listed(hit.sizes)), el("span", "residuals", `residuals: ${listed(hit.residuals) || "none"}`),
  );
  row.addEventListener("click", () => acts.chooseHit(index));
  return row;
}

export class ScenePanel {
  readonly element = el("aside", "panel");
  private readonly boxes = new Map<Layer, HTMLInputElement>();
  private readonly slider = el("input");
  private readonly readout = el("output", "value");
  private readonly axes: HTMLButtonElement[];
  private readonly hits: HTMLElement[];
  private readonly about = el("dl", "figures");

  constructor(scan: Scan, layers: Layer[], private readonly slice: Slice, private readonly acts: Acts) {
    const scroll = el("div", "scroll");
    this.element.append(scroll);
    this.hits = scan.detections.map((hit, i) => hitRow(hit, i, acts));
    scroll.append(el("h2", "", "Detections"));
    const checks = el("div", "checks", ...this.hits);
    scroll.append(scan.detections.length > 0 ? checks : el("p", "notes none", "none asked for, or none found"));
    scroll.append(el("h2", "", "Free space, as the rays saw it"), this.sliceControl());
    this.axes = [...this.element.querySelectorAll<HTMLButtonElement>(".axis")];
    scroll.append(el("h2", "", "Shown"), this.layerList(layers));
    scroll.append(this.legend());
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
    const legend = el("p", "legend", el("i", "swatch free"), "seen free  ", el("i", "swatch hidden"), "not seen free");
    return el("div", "slice", el("div", "line", choice, this.readout), slider, legend);
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

  choose(hit: number): void { this.hits.forEach((row, i) => row.classList.toggle("chosen", i === hit)); }

  refresh(): void {
    for (const [layer, box] of this.boxes) box.checked = layer.group.visible;
    const [low, high] = this.slice.range;
    Object.assign(this.slider, { min: low.toFixed(3), max: high.toFixed(3), value: this.slice.at.toFixed(3) });
    this.readout.textContent = `${"xyz"[this.slice.axis]} = ${this.slice.at.toFixed(2)} m`;
    this.axes.forEach((one, axis) => one.classList.toggle("on", axis === this.slice.axis));
  }
}
