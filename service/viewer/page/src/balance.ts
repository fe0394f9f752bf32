// Balance: support polygon, the polygon shrunk by its margin, centre of mass and ZMP, all wide enough to be seen.
import {
  BufferGeometry, CylinderGeometry, DoubleSide, Float32BufferAttribute, Group, Mesh, MeshBasicMaterial, MeshStandardMaterial,
  SphereGeometry, Vector2, Vector3,
} from "three";
import { Result, Support, rowAt } from "./data";
import { filledPolygon, ribbon, shrunk, tube } from "./geometry";
import { Layer } from "./layer";
import { Colours } from "./theme";

function rows(table: Float32Array | Float64Array, width: number): number[][] {
  const out: number[][] = [];
  for (let i = 0; i + width <= table.length; i += width) {
    const row = Array.from(table.subarray(i, i + width));
    if (row.every(Number.isFinite)) out.push(row);
  }
  return out;
}

// The ZMP at a time, of rows of time, x and y; it jumps where the acceleration does, so the last one seen counts.
function zmpAt(table: Float64Array, t: number): [number, number] | undefined {
  let row = 0;
  while (3 * (row + 1) < table.length && table[3 * (row + 1)] <= t) row++;
  const [x, y] = [table[3 * row + 1], table[3 * row + 2]];
  return Number.isFinite(x) ? [x, y] : undefined;
}

// The field's centre-of-mass mark: a ball with light and dark octants.
function comBall(radius: number): BufferGeometry {
  const geometry = new SphereGeometry(radius, 24, 16).toNonIndexed();
  const place = geometry.getAttribute("position");
  const tints: number[] = [];
  for (let face = 0; face < place.count; face += 3) {
    let [x, y, z] = [0, 0, 0];
    for (let i = face; i < face + 3; i++) { x += place.getX(i); y += place.getY(i); z += place.getZ(i); }
    const tint = x * y * z > 0 ? [0.98, 0.78, 0.1] : [0.07, 0.08, 0.1];
    tints.push(...tint, ...tint, ...tint);
  }
  geometry.setAttribute("color", new Float32BufferAttribute(tints, 3));
  return geometry;
}

export class Balance implements Layer {
  readonly name = "balance";
  readonly label = "Support, COM, ZMP";
  readonly key = "b";
  readonly group = new Group();
  private readonly polygons: { group: Group; support: Support }[] = [];
  // The centre of mass lies inside the robot: its mark shows through.
  private readonly ball = new Mesh(comBall(0.035), new MeshStandardMaterial({
    vertexColors: true, roughness: 0.5, transparent: true, opacity: 0.85, depthTest: false,
  }));
  private readonly plumb = new Mesh(new CylinderGeometry(0.0035, 0.0035, 1, 6).rotateX(Math.PI / 2), this.overlay(0.7));
  private readonly dot = new Mesh(new SphereGeometry(0.014, 16, 8), this.overlay(1));
  private readonly fill = this.overlay(0.14);
  private readonly border = this.overlay(0.95);
  private readonly inner = this.overlay(0.55);
  private readonly zmp = this.overlay(0.95);
  private readonly traces = this.overlay(0.95, true);

  constructor(private readonly result: Result, private readonly z: number) {
    for (const support of result.support) {
      if (support.polygon.length < 3) continue;
      const group = new Group();
      const outline = support.polygon.map(([x, y]) => new Vector2(x, y));
      this.put(group, filledPolygon(support.polygon, z + 0.0015), this.fill, 5);
      this.put(group, ribbon(outline, z + 0.003, 0.012, true, false), this.border, 6);
      const core = support.margin_m ? shrunk(support.polygon, support.margin_m) : [];
      if (core.length > 2) {
        this.put(group, ribbon(core.map(([x, y]) => new Vector2(x, y)), z + 0.003, 0.005, true, false), this.inner, 6);
      }
      this.polygons.push({ group, support });
      this.group.add(group);
    }
    const com = rows(result.com, 3);
    const path = tube(com.map((row) => new Vector3(...(row as [number, number, number]))), 0.006);
    if (path) this.put(this.group, path, this.traces, 7);
    if (com.length > 1) {
      const ground = com.map(([x, y]) => new Vector2(x, y));
      this.put(this.group, ribbon(ground, z + 0.005, 0.012, false, true), this.traces, 8);
    }
    const zmp = result.support.flatMap((support) => rows(support.zmp, 3)).map(([, x, y]) => new Vector2(x, y));
    if (zmp.length > 1) this.put(this.group, ribbon(zmp, z + 0.004, 0.006, false, false), this.zmp, 7);
    for (const mesh of [this.plumb, this.dot]) mesh.renderOrder = 9;
    this.ball.renderOrder = 10;
    this.ball.visible = this.plumb.visible = com.length > 0;
    this.group.add(this.ball, this.plumb, this.dot);
  }

  get count(): number { return this.polygons.length; }

  private overlay(opacity: number, vertexColors = false): MeshBasicMaterial {
    return new MeshBasicMaterial({ transparent: true, opacity, side: DoubleSide, depthWrite: false, vertexColors });
  }

  private put(group: Group, geometry: BufferGeometry, material: MeshBasicMaterial, order: number): void {
    const mesh = new Mesh(geometry, material);
    mesh.renderOrder = order;
    group.add(mesh);
  }

  update(t: number): void {
    const current = this.result.support.filter((support) => t >= support.start - 1e-6).at(-1) ?? this.result.support[0];
    for (const { group, support } of this.polygons) group.visible = support === current;
    if (this.ball.visible) {
      const [x, y, z] = rowAt(this.result.times, this.result.com, 3, t);
      this.ball.position.set(x, y, z);
      this.plumb.position.set(x, y, (z + this.z) / 2);
      this.plumb.scale.z = Math.max(z - this.z, 1e-3);
    }
    const zmp = current && zmpAt(current.zmp, t);
    this.dot.visible = zmp !== undefined;
    if (zmp) this.dot.position.set(zmp[0], zmp[1], this.z + 0.006);
  }

  recolour(colours: Colours): void {
    for (const material of [this.fill, this.border, this.inner]) material.color.set(colours.support);
    this.zmp.color.set(colours.zmp);
    this.dot.material.color.set(colours.zmp);
    this.plumb.material.color.set(colours.com);
  }

  // Seen through the robot in x-ray and from straight above.
  xray(on: boolean): void {
    const materials = [this.fill, this.border, this.inner, this.zmp, this.traces, this.dot.material];
    for (const material of materials) material.depthTest = !on;
    // From above the ball would cover the traces under it.
    this.ball.scale.setScalar(on ? 0.4 : 1);
  }
}
