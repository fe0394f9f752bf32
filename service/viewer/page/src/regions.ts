// Where the centre of mass may be while contact forces hold the robot, and such forces at the contact points.
import { BufferGeometry, DoubleSide, Group, Mesh, MeshBasicMaterial, Vector2, Vector3 } from "three";
import { Arrow, forceScale, overlay, scaleText } from "./arrows";
import { Region, Result, frameAt, spanAt } from "./data";
import { filledPolygon, ribbon, shrunk } from "./geometry";
import { Layer, Legend } from "./layer";
import { Colours } from "./theme";

const STEP_M = 0.3;  // contacts higher above the lowest one are no ground

// The level to draw a region on: the highest ground that carries the robot, so that no step hides it.
function levelOf(region: Region, z: number): number {
  const heights = region.places.map((place) => place[2]);
  const lowest = Math.min(...heights);
  return Math.max(z, ...heights.filter((height) => height <= lowest + STEP_M));
}

const regionAt = (result: Result, t: number): Region | undefined => spanAt(spanAt(result.phases, t)?.regions ?? [], t);

export class Regions implements Layer {
  readonly name = "regions";
  readonly label = "Static region";
  readonly key = "a";
  readonly group = new Group();
  private readonly drawn: { group: Group; region: Region }[] = [];
  private readonly fill = this.flat(0.16);
  private readonly border = this.flat(0.95);
  private readonly inner = this.flat(0.6);
  private colour = "";
  private isNow = false;

  constructor(private readonly result: Result, z: number) {
    for (const region of result.phases.flatMap((phase) => phase.regions)) {
      if (region.polygon.length < 3) continue;
      const group = new Group();
      const level = levelOf(region, z);
      const outline = (corners: number[][]): Vector2[] => corners.map(([x, y]) => new Vector2(x, y));
      this.put(group, filledPolygon(region.polygon, level + 0.002), this.fill);
      this.put(group, ribbon(outline(region.polygon), level + 0.0045, 0.012, true, false), this.border);
      const core = region.margin_m ? shrunk(region.polygon, region.margin_m) : [];
      if (core.length > 2) this.put(group, ribbon(outline(core), level + 0.0045, 0.005, true, false), this.inner);
      this.drawn.push({ group, region });
      this.group.add(group);
    }
  }

  get count(): number { return this.drawn.length; }

  private flat(opacity: number): MeshBasicMaterial {
    return new MeshBasicMaterial({ transparent: true, opacity, side: DoubleSide, depthWrite: false });
  }

  private put(group: Group, geometry: BufferGeometry, material: MeshBasicMaterial): void {
    const mesh = new Mesh(geometry, material);
    mesh.renderOrder = 7;
    group.add(mesh);
  }

  update(t: number): void {
    const current = regionAt(this.result, t);
    for (const { group, region } of this.drawn) group.visible = region === current;
    this.isNow = current !== undefined && this.group.visible;
  }

  legend(): Legend | undefined {
    if (!this.isNow) return undefined;
    return { colour: this.colour, text: "static region: contact forces hold the robot with its centre of mass above it" };
  }

  recolour(colours: Colours): void {
    this.colour = colours.region;
    for (const material of [this.fill, this.border, this.inner]) material.color.set(colours.region);
  }

  xray(on: boolean): void { for (const material of [this.fill, this.border, this.inner]) material.depthTest = !on; }
}

export class Forces implements Layer {
  readonly name = "forces";
  readonly label = "Contact forces";
  readonly key = "e";
  readonly group = new Group();
  readonly count: number;
  private readonly material = overlay(0.9);
  private readonly arrows: Arrow[] = [];
  private readonly scale: number;
  private colour = "";
  private isNow = false;
  private isLoaded = false;

  constructor(private readonly result: Result) {
    const regions = result.phases.flatMap((phase) => phase.regions).filter((region) => region.forces.length > 0);
    this.count = regions.length;
    let largest = 0;
    for (const { forces } of regions) {
      for (let i = 0; i < forces.length; i += 3) {
        const size = Math.hypot(forces[i], forces[i + 1], forces[i + 2]);
        if (size > largest) largest = size;
      }
    }
    this.scale = forceScale(largest);
    const most = Math.max(0, ...regions.map((region) => region.places.length));
    for (let i = 0; i < most; i++) {
      const arrow = new Arrow(this.material, 0.006);
      this.arrows.push(arrow);
      this.group.add(arrow.group);
    }
  }

  // Forces at the places of a region at a time, linear between frames; none outside the region.
  private at(region: Region, t: number): Vector3[] {
    const n = region.places.length;
    const [frame, u] = frameAt(this.result.times, t);
    const last = region.forces.length / (3 * Math.max(n, 1)) - 1;
    const row = Math.min(Math.max(frame - region.frame, 0), last);
    if (last < 0) return [];
    const read = (k: number, i: number): Vector3 => new Vector3().fromArray(region.forces, 3 * (k * n + i));
    const found = region.places.map((_, i) => read(row, i).lerp(read(Math.min(row + 1, last), i), u));
    return found.every((force) => Number.isFinite(force.x)) ? found : [];
  }

  update(t: number): void {
    const region = regionAt(this.result, t);
    const forces = region ? this.at(region, t) : [];
    this.isNow = forces.length > 0 && this.group.visible;
    this.isLoaded = (spanAt(this.result.phases, t)?.loads ?? []).length > 0;
    this.arrows.forEach((arrow, i) => {
      if (i < forces.length) arrow.set(new Vector3().fromArray(region!.places[i]), forces[i].divideScalar(this.scale));
      else arrow.group.visible = false;
    });
  }

  legend(): Legend | undefined {
    if (!this.isNow) return undefined;
    const under = this.isLoaded ? " under the largest loads" : "";
    const text = `contact forces that hold the robot at rest here${under}; others may too`;
    return { colour: this.colour, text: `${text}; ${scaleText(this.scale)}` };
  }

  recolour(colours: Colours): void {
    this.colour = colours.force;
    this.material.color.set(colours.force);
  }
}
