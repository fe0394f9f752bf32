// What a scan shows: points coloured by piece, pieces as glass, detections with their frames, free space in slices.
import {
  AxesHelper, Box3, BufferAttribute, BufferGeometry, Color, DataTexture, DoubleSide, Float32BufferAttribute, Group, LineBasicMaterial,
  LineSegments, Matrix4, Mesh, MeshBasicMaterial, MeshStandardMaterial, NearestFilter, PlaneGeometry, Points, RGBAFormat, ShaderMaterial,
  SphereGeometry, Vector3,
} from "three";
import { words } from "./dom";
import { edgeGeometry, hullGeometry } from "./geometry";
import { Label } from "./labels";
import { Layer } from "./layer";
import { FLOORS, Hit, LEFT_OUT, NOBODYS, Piece, Scan, Space } from "./scene-data";
import { Colours } from "./theme";

export const CONFIDENT = 0.5;
const HANDLE = 0.12;  // [m] that a door's lever is drawn long, whose length nobody tells

// Neighbours in number lie far apart in hue.
export const pieceColour = (index: number): Color =>
  new Color().setHSL((0.58 + index * 0.618034) % 1, 0.62, 0.56);

const POINT_VERTEX = `
attribute vec3 tint;
uniform float pixels;
uniform float size;
varying vec3 vTint;
#include <clipping_planes_pars_vertex>
void main() {
  vec4 place = modelViewMatrix * vec4(position, 1.0);
  vec4 mvPosition = place;
  #include <clipping_planes_vertex>
  vTint = tint;
  gl_PointSize = pixels * clamp(size / -place.z, 1.5, 6.0);
  gl_Position = projectionMatrix * place;
}`;
const POINT_FRAGMENT = `
uniform float opacity;
varying vec3 vTint;
#include <clipping_planes_pars_fragment>
void main() {
  #include <clipping_planes_fragment>
  if (length(gl_PointCoord - 0.5) > 0.5) discard;
  gl_FragColor = vec4(vTint, opacity);
  #include <colorspace_fragment>
}`;

export function pointCloud(points: Float32Array, tints: Float32Array, size: number, opacity: number): Points {
  const geometry = new BufferGeometry();
  geometry.setAttribute("position", new BufferAttribute(points, 3));
  geometry.setAttribute("tint", new BufferAttribute(tints, 3));
  return new Points(geometry, new ShaderMaterial({
    transparent: opacity < 1, clipping: true, vertexShader: POINT_VERTEX, fragmentShader: POINT_FRAGMENT,
    uniforms: { pixels: { value: Math.min(window.devicePixelRatio, 2) }, size: { value: size }, opacity: { value: opacity } },
  }));
}

export class OwnedPoints implements Layer {
  readonly name = "points";
  readonly label = "Points, by piece";
  readonly key = "c";
  readonly group = new Group();
  readonly count: number;
  private readonly tints: Float32Array;
  private readonly cloud: Points;

  constructor(private readonly scan: Scan) {
    this.count = scan.owner.length;
    this.tints = new Float32Array(3 * this.count);
    this.cloud = pointCloud(scan.cloud, this.tints, 9, 1);
    if (this.count > 0) this.group.add(this.cloud);
  }

  recolour(colours: Colours): void {
    const special = new Map([
      [NOBODYS, new Color(colours.bad)], [FLOORS, new Color(colours.joint)], [LEFT_OUT, new Color(colours.zmp)],
    ]);
    const own = this.scan.pieces.map((_, i) => pieceColour(i));
    this.scan.owner.forEach((owner, i) => (special.get(owner) ?? own[owner]).toArray(this.tints, 3 * i));
    this.cloud.geometry.getAttribute("tint").needsUpdate = true;
  }
}

export const COLOURINGS = { piece: "piece", kind: "kind", free: "share seen free", open: "surface next to free space", change: "change since the scan before" };
export type Colouring = keyof typeof COLOURINGS;
const KINDS: Record<string, string> = { plane: "#6ea8ff", wall: "#b48cff", clutter: "#ffb454", object: "#4ade80" };
// Green where the rays agree with a piece, red where they do not.
const [GOOD, BAD] = [new Color("#4ade80"), new Color("#ff5c5c")];
const NEUTRAL = "#9aa7b8";
const CHANGES: Record<string, string> = { stayed: "#7fa3d8", changed: "#facc15", new: "#f4633a" };
const MUCH_FREE = 0.02;  // of a piece's inside, that rays passed

// What the colours of a colouring mean, of those that these pieces have.
export function legendOf(colouring: Colouring, pieces: Piece[]): [string, Color][] {
  const blank: [string, Color][] = pieces.some((piece) => !piece.facts && !["floor", "unknown"].includes(piece.kind)) ? [["of no scan", new Color(NEUTRAL)]] : [];
  const between = (share: number): Color => GOOD.clone().lerp(BAD, share);
  switch (colouring) {
    case "kind":
      return Object.entries(KINDS).filter(([kind]) => pieces.some((piece) => piece.kind === kind)).map(([kind, colour]) => [kind, new Color(colour)]);
    case "free":
      return [["none of it", between(0)], [`${50 * MUCH_FREE} %`, between(0.5)], [`${100 * MUCH_FREE} % and more`, between(1)], ...blank];
    case "open":
      return [["all of it", between(0)], ["half", between(0.5)], ["none", between(1)], ...blank];
    case "change":
      return Object.entries(CHANGES).map(([change, colour]) => [change, new Color(colour)]);
    default:
      return [];
  }
}

// A colour for a piece; what is asked of one that no scan stands behind has none.
function colourOf(piece: Piece, index: number, colouring: Colouring): Color {
  if (colouring === "piece") return pieceColour(index);
  if (colouring === "kind") return new Color(KINDS[piece.kind] ?? NEUTRAL);
  if (colouring === "change") return new Color(CHANGES[piece.change ?? "stayed"]);
  if (!piece.facts) return new Color(NEUTRAL);
  const share = colouring === "free" ? Math.min(1, piece.facts.free_share / MUCH_FREE) : 1 - piece.facts.open_share;
  return GOOD.clone().lerp(BAD, share);
}

// Pieces as coloured glass with crisp edges; what is unknown and what is floor have switches of their own.
export class PieceGlass implements Layer {
  readonly group = new Group();
  readonly count: number;
  readonly solids: { piece: Piece; index: number; mesh: Mesh }[] = [];
  private readonly edges: { lines: LineBasicMaterial; index: number }[] = [];
  private colours: Colours | undefined;
  private colouring: Colouring = "piece";

  constructor(
    private readonly scan: Scan, readonly name: string, readonly label: string, readonly key: string,
    belongs: (piece: Piece) => boolean, private readonly opacity: number,
  ) {
    scan.pieces.forEach((piece, index) => {
      if (!belongs(piece)) return;
      const glass = new MeshStandardMaterial({
        color: pieceColour(index), transparent: true, opacity, depthWrite: false, flatShading: true, roughness: 1,
      });
      const mesh = new Mesh(hullGeometry(piece.hull), glass);
      mesh.renderOrder = 2;
      const lines = new LineBasicMaterial({ transparent: true, opacity: 0.85, vertexColors: true });
      const outline = new LineSegments(edgeGeometry([piece.hull]), lines);
      outline.renderOrder = 3;
      this.group.add(mesh, outline);
      this.solids.push({ piece, index, mesh });
      this.edges.push({ lines, index });
    });
    this.count = this.solids.length;
  }

  recolour(colours: Colours): void {
    this.colours = colours;
    const quiet = this.name === "floor" || this.name === "unknown" ? new Color(colours.grid) : null;
    const own = (index: number): Color => quiet?.clone() ?? colourOf(this.scan.pieces[index], index, this.colouring);
    for (const { mesh, index } of this.solids) (mesh.material as MeshStandardMaterial).color.copy(own(index));
    for (const { lines, index } of this.edges) lines.color.copy(quiet ? own(index) : own(index).lerp(new Color(colours.com), 0.25));
  }

  colourBy(colouring: Colouring): void {
    this.colouring = colouring;
    if (this.colours) this.recolour(this.colours);
  }

  // One piece stands out, the others step back.
  choose(chosen: number): void {
    for (const { mesh, index } of this.solids) {
      (mesh.material as MeshStandardMaterial).opacity = chosen < 0 ? this.opacity : index === chosen ? 0.75 : 0.4 * this.opacity;
    }
  }
}

const AXES = ["#ff5c5c", "#4ade80", "#6ea8ff"];

export class Hits implements Layer {
  readonly name = "detections";
  readonly label = "Detections";
  readonly key = "o";
  readonly group = new Group();
  readonly count: number;
  readonly labels: Label[] = [];
  private readonly marks: { points: Points; hit: Hit }[] = [];
  private readonly frames: Group[] = [];
  private readonly outlines: (LineSegments | undefined)[] = [];

  constructor(scan: Pick<Scan, "detections">) {
    this.count = scan.detections.length;
    for (const hit of scan.detections) {
      const rows = hit.pose_world_object;
      const pose = new Matrix4().set(...(rows.flat() as Parameters<Matrix4["set"]>));
      const group = new Group();
      group.applyMatrix4(pose);
      const length = Math.min(0.35, Math.max(0.12, 1.2 * Math.max(...["outer_radius", "radius", "lever_length"].map((k) => hit.sizes[k] ?? 0))));
      AXES.forEach((colour, axis) => {
        const end = new Vector3().setComponent(axis, length);
        const line = new BufferGeometry().setFromPoints([new Vector3(), end]);
        const lines = new LineSegments(line, new LineBasicMaterial({ color: colour, depthTest: false, transparent: true }));
        const tip = new Mesh(new SphereGeometry(0.012, 12, 8), new MeshBasicMaterial({ color: colour, depthTest: false, transparent: true }));
        tip.position.copy(end);
        for (const part of [lines, tip]) part.renderOrder = 6;
        group.add(lines, tip);
      });
      const outline = wire(hit);
      if (outline) group.add(outline);
      this.outlines.push(outline);
      const points = pointCloud(hit.points, new Float32Array(hit.points.length), 16, 1);
      points.renderOrder = 4;
      this.marks.push({ points, hit });
      this.group.add(group, points);
      this.frames.push(group);
      const isSure = hit.confidence >= CONFIDENT;
      this.labels.push({
        at: new Vector3().setFromMatrixPosition(pose), text: `${words(hit.kind)} ${Math.round(100 * hit.confidence)} %`,
        kind: isSure ? "target" : "spot", isOn: true, isDim: !isSure,
      });
    }
  }

  recolour(colours: Colours): void {
    for (const { points, hit } of this.marks) {
      const colour = new Color(hit.confidence >= CONFIDENT ? colours.target : colours.grid);
      const tint = points.geometry.getAttribute("tint") as BufferAttribute;
      for (let i = 0; i < tint.count; i++) tint.setXYZ(i, colour.r, colour.g, colour.b);
      tint.needsUpdate = true;
    }
  }

  // Both ends of each line of its outline, in the object's own frame.
  outlineOf(index: number): number[] {
    return [...(this.outlines[index]?.geometry.getAttribute("position").array ?? [])];
  }

  // What is to be seen of one: its points, its outline, its frame.
  extent(index: number): Box3 {
    const box = new Box3().setFromObject(this.frames[index]);
    const { points } = this.marks[index].hit;
    const p = new Vector3();
    for (let i = 0; i < points.length; i += 3) box.expandByPoint(p.fromArray(points, i));
    return box;
  }
}

// The object's outline in its own frame, drawn from its sizes: rings of wheels, openings and buttons, leaves, boards, boxes,
// handles as lines.
function wire(hit: Hit): LineSegments | undefined {
  const s = hit.sizes;
  const path: Vector3[][] = [];
  const ring = (radius: number, x = 0, y = 0): void => {
    path.push(Array.from({ length: 65 }, (_, i) => new Vector3(x + radius * Math.cos((i * Math.PI) / 32), y + radius * Math.sin((i * Math.PI) / 32), 0)));
  };
  const box = (low: number[], high: number[]): void => {
    for (let axis = 0; axis < 3; axis++) {
      for (const [a, b] of [[0, 0], [0, 1], [1, 0], [1, 1]]) {
        const from = new Vector3(...low);
        from.setComponent((axis + 1) % 3, (a ? high : low)[(axis + 1) % 3]);
        from.setComponent((axis + 2) % 3, (b ? high : low)[(axis + 2) % 3]);
        path.push([from, from.clone().setComponent(axis, high[axis])]);
      }
    }
  };
  if (s.outer_radius !== undefined) ring(s.outer_radius);
  if (hit.kind === "hose" && s.radius !== undefined) ring(s.radius);
  if (hit.kind === "beam") box([-s.length / 2, -s.width / 2, -s.thickness / 2], [s.length / 2, s.width / 2, s.thickness / 2]);
  if (hit.kind === "door") box([0, -0.01, 0], [s.width, 0.01, s.height]);
  if (s.handle_x !== undefined) {
    const pivot = new Vector3(s.handle_x, s.handle_y, s.handle_z);
    path.push([pivot.clone().setY(0), pivot, pivot.clone().add(new Vector3((s.lever_direction ?? 0) * HANDLE, 0, 0))]);
  }
  for (let i = 0; s[`button_${i}_radius`] !== undefined; i++) ring(s[`button_${i}_radius`], s[`button_${i}_x`], s[`button_${i}_y`]);
  if (hit.kind === "drill") {
    const top = new Vector3(0, 0, s.grip_length / 2);
    path.push([top.clone().negate(), top], [top.clone().setX(-s.body_length / 3), top.clone().setX((2 * s.body_length) / 3)]);
  }
  if (hit.kind === "panel") box([-s.width / 2, -s.height / 2, -0.01], [s.width / 2, s.height / 2, 0.01]);
  if (hit.kind === "opening") box([-0.01, -s.width / 2, 0], [0.01, s.width / 2, s.height]);
  if (hit.kind === "seat") box([-s.depth / 2, -s.width / 2, -0.05], [s.depth / 2, s.width / 2, 0]);
  const reach = s.lever_length ?? (hit.kind === "lever" ? s.length : undefined);
  if (reach !== undefined) path.push([new Vector3(), new Vector3(reach, 0, 0)]);
  const ends = path.flatMap((line) => line.slice(1).flatMap((end, i) => [line[i], end])).flatMap((p) => p.toArray());
  if (ends.length === 0 || !ends.every(Number.isFinite)) return undefined;
  const geometry = new BufferGeometry();
  geometry.setAttribute("position", new Float32BufferAttribute(ends, 3));
  const lines = new LineSegments(geometry, new LineBasicMaterial({ color: hit.confidence >= CONFIDENT ? "#4ade80" : "#9aa7b8", depthTest: false, transparent: true }));
  lines.renderOrder = 5;
  return lines;
}

export type Sight = "free" | "occupied" | "unseen";
// How far each shows: what is occupied stands out, what is free leaves the view.
const OPACITY: Record<Sight, number> = { free: 100, occupied: 235, unseen: 120 };

const bit = (bits: Uint8Array, index: number): boolean => ((bits[index >> 3] >> (index & 7)) & 1) === 1;

// One slice of space, square to an axis: free, where rays went through; occupied, where they ended; or not seen at all.
export class Slice implements Layer {
  readonly name = "free";
  readonly label = "Slice of space";
  readonly key = "v";
  readonly group = new Group();
  readonly count: number;
  axis = 2;
  at: number;
  private readonly mesh = new Mesh(new PlaneGeometry(1, 1), new MeshBasicMaterial({ transparent: true, side: DoubleSide, depthWrite: false }));
  private colours: Record<Sight, Color> = { free: new Color(), occupied: new Color(), unseen: new Color() };

  constructor(private readonly space: Space) {
    this.count = space.free.reduce((sum, byte) => sum + bitsIn(byte), 0);
    this.at = space.lower[2] + 0.5 * space.shape[2] * space.size;
    this.mesh.renderOrder = 1;
    this.group.add(this.mesh);
    this.group.visible = false;
  }

  get range(): [number, number] {
    const { lower, shape, size } = this.space;
    return [lower[this.axis], lower[this.axis] + shape[this.axis] * size];
  }

  recolour(colours: Colours): void {
    this.colours = { free: new Color(colours.support), occupied: new Color(colours.movable), unseen: new Color(colours.unseen) };
    this.move(this.axis, this.at);
  }

  sightOf(x: number, y: number, z: number): Sight {
    const [, ny, nz] = this.space.shape;
    const index = (x * ny + y) * nz + z;
    return bit(this.space.occupied, index) ? "occupied" : bit(this.space.free, index) ? "free" : "unseen";
  }

  move(axis: number, at: number): void {
    const { lower, shape, size } = this.space;
    this.axis = axis;
    const [low, high] = this.range;
    this.at = Math.min(Math.max(at, low), high);
    const layer = Math.min(shape[axis] - 1, Math.max(0, Math.floor((this.at - low) / size)));
    const [first, second] = axis === 0 ? [1, 2] : axis === 1 ? [0, 2] : [0, 1];
    const [width, height] = [shape[first], shape[second]];
    const pixels = new Uint8Array(4 * width * height);
    const paint = (sight: Sight): number[] => [
      ...this.colours[sight].clone().convertLinearToSRGB().toArray().map((part) => 255 * part), OPACITY[sight],
    ];
    const paints = { free: paint("free"), occupied: paint("occupied"), unseen: paint("unseen") };
    const cell = [0, 0, 0];
    cell[axis] = layer;
    for (let v = 0; v < height; v++) {
      for (let u = 0; u < width; u++) {
        cell[first] = u;
        cell[second] = v;
        pixels.set(paints[this.sightOf(cell[0], cell[1], cell[2])], 4 * (v * width + u));
      }
    }
    const texture = new DataTexture(pixels, width, height, RGBAFormat);
    texture.magFilter = NearestFilter;
    texture.colorSpace = "srgb";
    texture.needsUpdate = true;
    const material = this.mesh.material;
    material.map?.dispose();
    material.map = texture;
    material.needsUpdate = true;
    // The plane's own x and y become the slice's two axes.
    const basis = [new Vector3(), new Vector3(), new Vector3()];
    basis[0].setComponent(first, width * size);
    basis[1].setComponent(second, height * size);
    basis[2].setComponent(axis, 1);
    const middle = new Vector3().setComponent(axis, this.at);
    middle.setComponent(first, lower[first] + (width * size) / 2);
    middle.setComponent(second, lower[second] + (height * size) / 2);
    this.mesh.matrixAutoUpdate = false;
    this.mesh.matrix.makeBasis(basis[0], basis[1], basis[2]).setPosition(middle);
    this.mesh.matrixWorldNeedsUpdate = true;
  }
}

function bitsIn(byte: number): number {
  let count = 0;
  for (let rest = byte; rest > 0; rest &= rest - 1) count += 1;
  return count;
}

// Where the rays started.
export class Sensors implements Layer {
  readonly name = "sensors";
  readonly label = "Sensor";
  readonly key = "s";
  readonly group = new Group();
  readonly count: number;
  readonly labels: Label[] = [];
  private readonly material = new MeshBasicMaterial();

  constructor(scan: Scan) {
    this.count = scan.sensors.length;
    for (const place of scan.sensors) {
      const ball = new Mesh(new SphereGeometry(0.03, 20, 14), this.material);
      ball.position.fromArray(place);
      this.group.add(ball);
    }
    if (this.count === 1) this.labels.push({ at: new Vector3().fromArray(scan.sensors[0]), text: "sensor", kind: "spot", isOn: true });
  }

  recolour(colours: Colours): void { this.material.color.set(colours.zmp); }
}

// The world's origin, where the robot stands: x ahead in red, y to its left in green, z up in blue, half a metre each.
export class Origin implements Layer {
  readonly name = "origin";
  readonly label = "Origin, x y z";
  readonly key = "a";
  readonly group = new Group();
  readonly count = 1;
  readonly labels: Label[] = [{ at: new Vector3(), text: "origin", kind: "spot", isOn: true }];

  constructor() { this.group.add(new AxesHelper(0.5)); }

  recolour(): void { /* axes have colours of their own */ }
}
