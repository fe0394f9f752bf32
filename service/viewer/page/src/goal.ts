// Where a motion that was never planned should have ended: the links there, what they are in, and both lit.
import {
  Box3, BufferGeometry, Group, Line, LineBasicMaterial, LineDashedMaterial, LineSegments, Matrix4, Mesh, MeshBasicMaterial,
  MeshStandardMaterial, Quaternion, Vector3,
} from "three";
import { Body, NamedHull, Obstruction, Result } from "./data";
import { figure } from "./dom";
import { edgeGeometry, hullGeometry } from "./geometry";
import { Label } from "./labels";
import { Layer } from "./layer";
import { Motion } from "./motion";
import { Colours } from "./theme";

export class Goal implements Layer {
  readonly name = "goal";
  readonly label = "Goal";
  readonly key = "u";
  readonly group = new Group();
  readonly labels: Label[] = [];
  readonly solids: { name: string; mesh: Mesh }[] = [];
  readonly box = new Box3();
  private readonly ghost = this.glass(0.3);
  private readonly hit = new MeshStandardMaterial({ flatShading: true, roughness: 0.6, emissiveIntensity: 0.4, transparent: true, opacity: 0.85 });
  private readonly struck = this.glass(0.22);
  private readonly lines = new LineBasicMaterial({ transparent: true, opacity: 0.8, vertexColors: true });
  private readonly struckLines = new LineBasicMaterial({ transparent: true, opacity: 0.9, vertexColors: true });

  private readonly way = new LineDashedMaterial({ dashSize: 0.03, gapSize: 0.03 });

  constructor(result: Result, motion: Motion) {
    const { obstruction } = result;
    if (!obstruction) return;
    const inside = new Set(obstruction.overlaps.flatMap((pair) => [pair.link, pair.other]));
    for (const at of obstruction.links) {
      const bodies = result.bodies.filter((body) => body.link === at.link);
      const [w, x, y, z] = at.quaternion_wxyz;
      const pose = new Matrix4().compose(new Vector3().fromArray(at.position), new Quaternion(x, y, z, w), new Vector3(1, 1, 1));
      this.draw(bodies, pose, inside.has(at.link) ? this.hit : this.ghost, this.lines, at.link);
    }
    const seen = new Box3().copy(this.box);
    const pieces = result.pieces.filter((piece) => inside.has(piece.name));
    this.draw(pieces, new Matrix4(), this.struck, this.struckLines);
    // A wall of fifty metres lit is enough; the view stays with the robot and its goal.
    this.box.copy(seen);
    for (const target of obstruction.targets) {
      if (target.position) this.lead(motion.place(target.frame ?? "", motion.start), new Vector3().fromArray(target.position));
      if (target.centre) this.box.expandByPoint(new Vector3().fromArray(target.centre));
    }
    this.tell(obstruction);
  }

  get count(): number { return this.solids.length; }

  private glass(opacity: number): MeshBasicMaterial { return new MeshBasicMaterial({ transparent: true, opacity, depthWrite: false }); }

  private draw(
    hulls: (Body | NamedHull)[], pose: Matrix4, material: MeshBasicMaterial | MeshStandardMaterial, lines: LineBasicMaterial, link = "",
  ): void {
    if (hulls.length === 0) return;
    const part = new Group();
    part.applyMatrix4(pose);
    for (const { hull, name } of hulls) {
      const mesh = new Mesh(hullGeometry(hull), material);
      mesh.renderOrder = 5;
      part.add(mesh);
      if (link) this.solids.push({ name: `${name} at the goal`, mesh });
      const p = new Vector3();
      for (let i = 0; i < hull.vertices.length; i += 3) this.box.expandByPoint(p.fromArray(hull.vertices, i).applyMatrix4(pose));
    }
    part.add(new LineSegments(edgeGeometry(hulls.map(({ hull }) => hull)), lines));
    this.group.add(part);
  }

  // From where a frame is to where it was to go.
  private lead(from: Vector3 | undefined, to: Vector3): void {
    this.box.expandByPoint(to);
    if (from) this.group.add(new Line(new BufferGeometry().setFromPoints([from, to]), this.way).computeLineDistances());
  }

  private tell(obstruction: Obstruction): void {
    const at = new Map(obstruction.links.map((link) => [link.link, new Vector3().fromArray(link.position)]));
    for (const { link, other, depth_m } of obstruction.overlaps) {
      const place = this.middle(link) ?? at.get(link);
      const depth = depth_m === null ? "" : ` ${figure(-depth_m, "m")}`;
      if (place) this.labels.push({ at: place, text: `${link} ↔ ${other}${depth}`, kind: "bad", isOn: true });
    }
  }

  private middle(link: string): Vector3 | undefined {
    const solid = this.solids.find(({ name }) => name.split(" at the goal")[0].split("/")[0] === link);
    if (!solid) return undefined;
    solid.mesh.updateWorldMatrix(true, false);
    return new Box3().setFromObject(solid.mesh).getCenter(new Vector3());
  }

  update(): void {
    for (const label of this.labels) label.isOn = this.group.visible;
  }

  recolour(colours: Colours): void {
    this.ghost.color.set(colours.target);
    this.hit.color.set(colours.bad);
    this.hit.emissive.set(colours.bad);
    this.struck.color.set(colours.bad);
    this.lines.color.set(colours.edge);
    this.way.color.set(colours.target);
    this.struckLines.color.set(colours.bad);
  }
}
