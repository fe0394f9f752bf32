// The checks at the places they speak of: the worst failed ones always, any other while it is selected.
import { Group, Mesh, MeshStandardMaterial, Vector3 } from "three";
import { Check } from "./data";
import { figure, title } from "./dom";
import { Label, Labels } from "./labels";
import { Layer } from "./layer";
import { listWorst, standingOf } from "./standing";
import { Colours } from "./theme";

const MOST_FAILED = 3; // labels of failed checks at once; the list of checks has the others

export class Marks implements Layer {
  readonly name = "checks";
  readonly label = "Check marks";
  readonly key = "v";
  readonly group = new Group();
  readonly places: (Vector3 | undefined)[];
  private readonly own: (Label | undefined)[];
  private readonly glow = new MeshStandardMaterial({ flatShading: true, emissiveIntensity: 0.35, roughness: 0.6 });
  private lit: { mesh: Mesh; material: Mesh["material"] }[] = [];
  private selected = -1;
  private readonly worst: ReadonlySet<Check>;

  constructor(
    private readonly checks: Check[], private readonly start: number, placeOf: (name: string, t: number) => Vector3 | undefined,
    labels: Labels, private readonly solids: () => { name: string; mesh: Mesh }[],
  ) {
    this.worst = new Set(listWorst(checks, MOST_FAILED));
    this.places = checks.map((check) => {
      const where = check.where;
      if (where?.position && where.position.length === 3) return new Vector3().fromArray(where.position);
      const found = (where?.names ?? []).map((name) => placeOf(name, where?.time_s ?? this.start));
      return found.find((place) => place !== undefined);
    });
    this.own = checks.map((check, i) => {
      const at = this.places[i];
      if (!at) return undefined;
      const names = check.where?.names ?? [];
      const what = names.length === 2 ? names.join(" ↔ ") : title(check.name);
      const standing = standingOf(check);
      const text = `${what} ${figure(check.value, check.unit)}${standing === "unproven" ? ", unproven" : ""}`;
      const label: Label = { at, text, kind: !check.ok ? "bad" : standing === "unproven" ? "fair" : "good", isOn: false };
      labels.add(label);
      return label;
    });
    // Failed bodies glow in the colour that means failure.
    Object.assign(this.glow, { stencilWrite: false });
    this.refresh();
  }

  get count(): number { return this.own.filter((label) => label?.isOn).length; }

  get chosen(): number { return this.selected; }

  select(index: number): void {
    this.selected = index;
    for (const { mesh, material } of this.lit) mesh.material = material;
    this.lit = [];
    const check = this.checks[index];
    if (check && !check.ok) {
      const names = new Set(check.where?.names ?? []);
      for (const { name, mesh } of this.solids()) {
        if (!names.has(name) && !names.has(name.split("/")[0])) continue;
        this.lit.push({ mesh, material: mesh.material });
        mesh.material = this.glow;
      }
    }
    this.refresh();
  }

  refresh(): void {
    this.own.forEach((label, i) => {
      if (!label) return;
      label.isOn = this.group.visible && (this.worst.has(this.checks[i]) || i === this.selected);
      label.isDim = this.selected >= 0 && i !== this.selected;
    });
  }

  recolour(colours: Colours): void {
    this.glow.color.set(colours.bad);
    this.glow.emissive.set(colours.bad);
  }
}
