// The world: floor with grid, convex pieces, the point cloud, and what the task moves.
import {
  AlwaysStencilFunc, Box3, BufferAttribute, BufferGeometry, Color, EqualStencilFunc, Group,
  LineBasicMaterial, LineSegments, Mesh, MeshStandardMaterial, NotEqualStencilFunc, PlaneGeometry, Points,
  ShaderMaterial, ShadowMaterial, Vector3,
} from "three";
import { Movable, NamedHull, Result, rowAt } from "./data";
import { words } from "./dom";
import { edgeGeometry, hullGeometry } from "./geometry";
import { Label } from "./labels";
import { Layer } from "./layer";
import { Motion } from "./motion";
import { Hull } from "./packed";
import { Colours } from "./theme";

const FLOOR_FRAGMENT = `
uniform vec3 ground;
uniform vec3 lines;
uniform vec2 centre;
uniform float reach;
varying vec2 vPlace;
float grid(float step, float width) {
  vec2 cell = vPlace / step;
  vec2 density = fwidth(cell);
  vec2 distance = abs(fract(cell - 0.5) - 0.5) / density;
  float line = 1.0 - clamp(min(distance.x, distance.y) - width + 0.5, 0.0, 1.0);
  return line * (1.0 - smoothstep(0.15, 0.6, max(density.x, density.y)));
}
void main() {
  float away = length(vPlace - centre) / reach;
  float fade = 1.0 - smoothstep(0.25, 1.0, away);
  float line = max(0.55 * grid(1.0, 0.8), 0.20 * grid(0.25, 0.5));
  vec3 colour = mix(ground, lines, line);
  gl_FragColor = vec4(colour, fade * (0.80 + 0.2 * line));
  #include <colorspace_fragment>
}`;
const FLOOR_VERTEX = `
varying vec2 vPlace;
void main() {
  vec4 place = modelMatrix * vec4(position, 1.0);
  vPlace = place.xy;
  gl_Position = projectionMatrix * viewMatrix * place;
}`;

const isFloor = (piece: NamedHull): boolean => piece.kind === "floor";

const LOOKS = 12; // times at which the robot's lowest point is looked for

// Lowest point of the robot along its motion; 0 without a motion.
function lowestPoint(result: Result, motion: Motion): number {
  let lowest = 0;
  const corner = new Vector3();
  for (const body of motion.nFrames > 0 ? result.bodies : []) {
    const link = motion.links.indexOf(body.link);
    for (let k = 0; k < LOOKS && link >= 0; k++) {
      const pose = motion.matrix(link, motion.start + (k / (LOOKS - 1)) * (motion.end - motion.start));
      for (let i = 0; i < body.hull.vertices.length; i += 3) {
        lowest = Math.min(lowest, corner.fromArray(body.hull.vertices, i).applyMatrix4(pose).z);
      }
    }
  }
  return lowest;
}

// Height of the floor under the robot: under the soles, else the top of the floor pieces, else zero, or lower where the
// robot reaches below: legs that hang from a fixed pelvis are not under the ground.
export function floorHeight(result: Result, motion: Motion): number {
  const soles = result.phases.flatMap((phase) => phase.contacts ?? []).flatMap((contact) => contact.sole ?? []);
  if (soles.length > 0) return Math.min(...soles.map((corner) => corner[2]));
  const tops = result.pieces.filter(isFloor).map((piece) => {
    let top = -Infinity;
    for (let i = 2; i < piece.hull.vertices.length; i += 3) top = Math.max(top, piece.hull.vertices[i]);
    return top;
  });
  return tops.length > 0 ? Math.min(...tops) : lowestPoint(result, motion);
}

// The hull with only the edges of its top face: a slab's thickness is of no interest.
function topOnly(hull: Hull): Hull {
  let top = -Infinity;
  for (let i = 2; i < hull.vertices.length; i += 3) top = Math.max(top, hull.vertices[i]);
  const isTop = (index: number): boolean => hull.vertices[3 * index + 2] > top - 0.002;
  const ends = (i: number): number[] => [hull.edges[2 * i], hull.edges[2 * i + 1]];
  const kept = Array.from(hull.bends.keys()).filter((i) => ends(i).every(isTop));
  return {
    ...hull, edges: Uint16Array.from(kept.flatMap(ends)), bends: Uint8Array.from(kept.map((i) => hull.bends[i])),
  };
}

export class Floor implements Layer {
  readonly name = "floor";
  readonly label = "Floor";
  readonly key = "f";
  readonly group = new Group();
  readonly count: number;
  private readonly ground: ShaderMaterial;
  private shadow = 0;
  private readonly shade = new ShadowMaterial({ transparent: true, depthWrite: false });
  private readonly edges = new LineBasicMaterial({ transparent: true, opacity: 0.35, vertexColors: true });

  constructor(result: Result, z: number, centre: Vector3, reach: number) {
    const slabs = result.pieces.filter(isFloor);
    this.count = slabs.length;
    this.ground = new ShaderMaterial({
      vertexShader: FLOOR_VERTEX, fragmentShader: FLOOR_FRAGMENT, transparent: true, depthWrite: false,
      uniforms: {
        ground: { value: new Color() }, lines: { value: new Color() },
        centre: { value: [centre.x, centre.y] }, reach: { value: reach },
      },
    });
    for (const [material, order] of [[this.ground, -3], [this.shade, -2]] as const) {
      const plane = new Mesh(new PlaneGeometry(2 * reach, 2 * reach), material);
      plane.position.set(centre.x, centre.y, z);
      plane.renderOrder = order;
      plane.receiveShadow = material === this.shade;
      this.group.add(plane);
    }
    const lines = new LineSegments(edgeGeometry(slabs.map((slab) => topOnly(slab.hull))), this.edges);
    lines.renderOrder = -1;
    this.group.add(lines);
  }

  recolour(colours: Colours): void {
    (this.ground.uniforms.ground.value as Color).set(colours.floor);
    (this.ground.uniforms.lines.value as Color).set(colours.grid);
    this.shadow = colours.shadow;
    this.shade.opacity = colours.shadow;
    this.edges.color.set(colours.grid);
  }

  // The shadow of a robot one looks through would only distract.
  xray(on: boolean): void { this.shade.opacity = on ? 0.25 * this.shadow : this.shadow; }
}

// All pieces of the world but the floor: thin glass with crisp edges, thinner still in front of the robot.
export class Pieces implements Layer {
  readonly name = "pieces";
  readonly label = "Convex pieces";
  readonly key = "p";
  readonly group = new Group();
  readonly count: number;
  readonly solids: { name: string; mesh: Mesh }[];
  private readonly glass = [NotEqualStencilFunc, EqualStencilFunc].map((stencilFunc, i) => new MeshStandardMaterial({
    transparent: true, opacity: i === 0 ? 0.20 : 0.05, depthWrite: false, flatShading: true, roughness: 1,
    stencilWrite: true, stencilRef: 1, stencilFunc,
  }));
  private readonly edges = new LineBasicMaterial({ transparent: true, opacity: 0.75, vertexColors: true });
  private readonly beyond = new LineBasicMaterial({
    transparent: true, opacity: 0.18, vertexColors: true, stencilWrite: true, stencilRef: 1, stencilFunc: EqualStencilFunc,
  });

  constructor(result: Result) {
    const pieces = result.pieces.filter((piece) => !isFloor(piece));
    this.count = pieces.length;
    this.solids = pieces.map((piece) => ({ name: piece.name, mesh: new Mesh(hullGeometry(piece.hull), this.glass[0]) }));
    for (const { mesh } of this.solids) {
      for (const material of this.glass) {
        const copy = material === this.glass[0] ? mesh : new Mesh(mesh.geometry, material);
        copy.renderOrder = 2;
        this.group.add(copy);
      }
    }
    const outline = edgeGeometry(pieces.map((piece) => piece.hull));
    Object.assign(this.edges, { stencilWrite: true, stencilRef: 1, stencilFunc: NotEqualStencilFunc });
    for (const material of [this.edges, this.beyond]) {
      const lines = new LineSegments(outline, material);
      lines.renderOrder = 3;
      this.group.add(lines);
    }
  }

  recolour(colours: Colours): void {
    for (const material of this.glass) material.color.set(colours.piece);
    for (const material of [this.edges, this.beyond]) material.color.set(colours.pieceEdge);
  }

  // In x-ray the robot no longer keeps its pixels for itself.
  xray(on: boolean): void {
    this.glass[0].stencilFunc = this.edges.stencilFunc = on ? AlwaysStencilFunc : NotEqualStencilFunc;
    this.glass[1].visible = this.beyond.visible = !on;
  }
}

export class Cloud implements Layer {
  readonly name = "cloud";
  readonly label = "Point cloud";
  readonly key = "c";
  readonly group = new Group();
  readonly count: number;
  private readonly material = new ShaderMaterial({
    transparent: true, depthWrite: false,
    uniforms: { colour: { value: new Color() }, pixels: { value: Math.min(window.devicePixelRatio, 2) } },
    vertexShader: `
      uniform float pixels;
      varying float vNear;
      void main() {
        vec4 place = modelViewMatrix * vec4(position, 1.0);
        vNear = clamp(5.0 / -place.z, 0.35, 1.0);
        gl_PointSize = pixels * clamp(9.0 / -place.z, 1.6, 4.0);
        gl_Position = projectionMatrix * place;
      }`,
    fragmentShader: `
      uniform vec3 colour;
      varying float vNear;
      void main() {
        if (length(gl_PointCoord - 0.5) > 0.5) discard;
        gl_FragColor = vec4(colour, 0.45 * vNear);
        #include <colorspace_fragment>
      }`,
  });

  constructor(points: Float32Array) {
    this.count = points.length / 3;
    const geometry = new BufferGeometry();
    geometry.setAttribute("position", new BufferAttribute(points, 3));
    const cloud = new Points(geometry, this.material);
    cloud.renderOrder = 1;
    if (this.count > 0) this.group.add(cloud);
  }

  recolour(colours: Colours): void { (this.material.uniforms.colour.value as Color).set(colours.cloud); }
}

// Where the label of what is moved stands: below a wheel or lever, clear of it however it turns; on a leaf or slide, with it.
function labelPlace(movable: Movable, parent: Movable | undefined): { place: Vector3; hangs: boolean } {
  const axis = new Vector3().fromArray(movable.axis).normalize();
  const box = new Box3();
  const p = new Vector3();
  let radius = 0;
  for (const { hull } of movable.bodies) {
    for (let i = 0; i < hull.vertices.length; i += 3) {
      box.expandByPoint(p.fromArray(hull.vertices, i));
      radius = Math.max(radius, p.cross(axis).length());
    }
  }
  const down = new Vector3(0, 0, -1).projectOnPlane(axis);
  if (movable.type === "revolute" && down.length() > 0.5) return { place: down.normalize().multiplyScalar(radius), hangs: true };
  if (box.isEmpty()) return { place: new Vector3(), hangs: true };
  const middle = box.getCenter(new Vector3());
  if (movable.type === "revolute") return { place: middle.setZ(box.max.z), hangs: false };
  // The hand works far from the hinge: the label keeps to the other end.
  const ends = [[box.min.x, box.min.y], [box.max.x, box.max.y]].map(([x, y]) => new Vector3(x, y, box.min.z));
  const hinge = new Vector3().fromArray(parent?.origin ?? movable.origin).sub(new Vector3().fromArray(movable.origin));
  return { place: ends.sort((a, b) => a.distanceTo(hinge) - b.distanceTo(hinge))[0], hangs: false };
}

export class Movables implements Layer {
  readonly name = "movables";
  readonly label = "Moved objects";
  readonly key = "m";
  readonly group = new Group();
  readonly solids: { name: string; mesh: Mesh }[] = [];
  private readonly material = new MeshStandardMaterial({ flatShading: true, roughness: 0.45, metalness: 0.15 });
  private readonly hub = new MeshStandardMaterial({ flatShading: true, roughness: 0.5, metalness: 0.2 });
  private readonly edges = new LineBasicMaterial({ transparent: true, opacity: 0.7, vertexColors: true });
  readonly labels: Label[] = [];
  private readonly moving: { group: Group; movable: Movable; label: Label; place: Vector3; hangs: boolean }[] = [];

  constructor(private readonly result: Result, private readonly motion: Motion) {
    for (const movable of result.movables) {
      const group = new Group();
      group.position.fromArray(movable.origin);
      for (const body of movable.bodies) {
        const mesh = new Mesh(hullGeometry(body.hull), body.kind === "hub" ? this.hub : this.material);
        mesh.castShadow = true;
        mesh.receiveShadow = true;
        this.solids.push({ name: body.name, mesh });
        group.add(mesh);
      }
      group.add(new LineSegments(edgeGeometry(movable.bodies.map((body) => body.hull)), this.edges));
      const label: Label = { at: new Vector3(), text: movable.name, kind: "spot", isOn: true };
      const parent = result.movables.find(({ name }) => name === movable.parent);
      this.labels.push(label);
      this.moving.push({ group, movable, label, ...labelPlace(movable, parent) });
      this.group.add(group);
    }
    for (const { group, label, place } of this.moving) label.at.copy(place).add(group.position);
  }

  get count(): number { return this.result.movables.length; }

  update(t: number): void {
    for (const { group, movable, label, place, hangs } of this.moving) {
      label.isOn = this.group.visible;
      const link = this.motion.links.indexOf(movable.name);
      if (link < 0 || movable.angles.length === 0) continue;
      this.motion.pose(link, t, group.position, group.quaternion);
      label.at.copy(place);
      if (!hangs) label.at.applyQuaternion(group.quaternion);
      label.at.add(group.position);
      const [value] = rowAt(this.result.times, movable.angles, 1, t);
      const by = value - movable.angles[0];
      label.text = `${words(movable.name)} ${moved(movable, by)}`;
      // A handle at rest says nothing that its door does not.
      label.isOn &&= movable.parent === null || Math.abs(by) > (movable.type === "prismatic" ? 5e-4 : 9e-3);
    }
  }

  recolour(colours: Colours): void {
    this.material.color.set(colours.movable);
    this.hub.color.set(colours.movable).multiplyScalar(0.6);
    this.edges.color.set(colours.edge);
  }
}

const moved = (movable: Movable, by: number): string =>
  (movable.type === "prismatic" ? `${(1000 * by).toFixed(0)} mm` : `${((by * 180) / Math.PI).toFixed(0)}°`).replace(/^-0(?=\D)/, "0");
