// Links without a collision shape, of which nothing is checked: a cross where their frame is.
import { BufferGeometry, Float32BufferAttribute, Group, LineBasicMaterial, LineSegments, Quaternion, Vector3 } from "three";
import { Layer } from "./layer";
import { Motion } from "./motion";
import { Colours } from "./theme";

const HALF = 0.025;

export class Shapeless implements Layer {
  readonly name = "shapeless";
  readonly label = "Links without a shape";
  readonly key = "o";
  readonly group = new Group();
  private readonly material = new LineBasicMaterial({ depthTest: false, transparent: true });
  private readonly crosses: { cross: LineSegments; link: number }[] = [];

  constructor(private readonly names: string[], private readonly motion: Motion) {
    const geometry = new BufferGeometry();
    const axes = [[HALF, 0, 0], [0, HALF, 0], [0, 0, HALF]].flatMap((axis) => [...axis, ...axis.map((value) => -value)]);
    geometry.setAttribute("position", new Float32BufferAttribute(axes, 3));
    for (const name of motion.nFrames > 0 ? names : []) {
      const cross = new LineSegments(geometry, this.material);
      cross.renderOrder = 11;
      this.crosses.push({ cross, link: motion.links.indexOf(name) });
      this.group.add(cross);
    }
  }

  get count(): number { return this.names.length; }

  update(t: number): void {
    const position = new Vector3();
    const rotation = new Quaternion();
    for (const { cross, link } of this.crosses) {
      this.motion.pose(link, t, position, rotation);
      cross.position.copy(position);
      cross.quaternion.copy(rotation);
    }
  }

  recolour(colours: Colours): void { this.material.color.set(colours.unshaped); }
}
