// What the hands exert on what they move: the largest force of each load, at its place on the link that moves.
import { BufferGeometry, CylinderGeometry, Group, Matrix4, Mesh, Quaternion, Vector3 } from "three";
import { Arrow, forceScale, overlay, scaleText } from "./arrows";
import { Load, Result, spanAt } from "./data";
import { Label } from "./labels";
import { Layer, Legend } from "./layer";
import { Motion } from "./motion";
import { Colours } from "./theme";

interface Drawn { load: Load; link: number; arrow: Arrow; slide: Group; label: Label }

// A rod from -half to +half.
function rod(half: Vector3): BufferGeometry {
  const turn = new Quaternion().setFromUnitVectors(new Vector3(0, 1, 0), half.clone().normalize());
  return new CylinderGeometry(0.004, 0.004, 2 * half.length(), 8).applyMatrix4(new Matrix4().makeRotationFromQuaternion(turn));
}

export class Loads implements Layer {
  readonly name = "loads";
  readonly label = "Forces on moved objects";
  readonly key = "w";
  readonly group = new Group();
  readonly labels: Label[] = [];
  private readonly material = overlay(0.95);
  private readonly pale = overlay(0.5);
  private readonly drawn: Drawn[] = [];
  private readonly scale: number;
  private colour = "";

  constructor(private readonly result: Result, private readonly motion: Motion) {
    const all = result.phases.flatMap((phase) => phase.loads ?? []);
    this.scale = forceScale(Math.max(0, ...all.map((load) => Math.hypot(...load.force_n))));
    for (const load of all) {
      const link = motion.links.indexOf(load.link);
      if (link < 0 || motion.nFrames === 0) continue;
      const arrow = new Arrow(this.material, 0.009);
      const slide = new Group();
      const half = new Vector3().fromArray(load.slide ?? [0, 0, 0]);
      if (half.length() > 1e-3) {
        const mesh = new Mesh(rod(half), this.pale);
        mesh.renderOrder = 12;
        slide.add(mesh);
      }
      const newtons = Math.hypot(...load.force_n);
      const label: Label = { at: new Vector3(), text: `up to ${newtons.toFixed(newtons < 10 ? 1 : 0)} N on ${load.link}`, kind: "force", isOn: false };
      this.labels.push(label);
      this.group.add(arrow.group, slide);
      this.drawn.push({ load, link, arrow, slide, label });
    }
  }

  get count(): number { return this.drawn.length; }

  update(t: number): void {
    const current = spanAt(this.result.phases, t)?.loads ?? [];
    for (const { load, link, arrow, slide, label } of this.drawn) {
      const isNow = current.includes(load);
      label.isOn = isNow && this.group.visible;
      arrow.group.visible = slide.visible = isNow;
      if (!isNow) continue;
      const pose = this.motion.matrix(link, t);
      const turn = new Quaternion().setFromRotationMatrix(pose);
      const place = new Vector3().fromArray(load.place).applyMatrix4(pose);
      const vector = new Vector3().fromArray(load.force_n).applyQuaternion(turn).divideScalar(this.scale);
      arrow.set(place, vector);
      slide.position.copy(place);
      slide.quaternion.copy(turn);
      label.at.copy(place).add(vector);
      label.isBelow = vector.z < -0.3 * vector.length();
    }
  }

  legend(): Legend | undefined {
    if (!this.drawn.some(({ label }) => label.isOn)) return undefined;
    return { colour: this.colour, text: `largest force of a hand on what it moves; ${scaleText(this.scale)}` };
  }

  recolour(colours: Colours): void {
    this.colour = colours.load;
    for (const material of [this.material, this.pale]) material.color.set(colours.load);
  }
}
