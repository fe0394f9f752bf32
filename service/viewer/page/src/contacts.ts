// Where feet, hands and others stay: their soles, the contact points at the corners, and the cones of friction there.
import {
  BufferGeometry, ConeGeometry, DoubleSide, Group, Material, Mesh, MeshBasicMaterial, Quaternion, SphereGeometry, Vector2, Vector3,
} from "three";
import { Contact, Phase, Result } from "./data";
import { convexRing, filledPolygon, ribbon } from "./geometry";
import { Layer, Legend } from "./layer";
import { Colours } from "./theme";

const CONE_HEIGHT = 0.12;

interface Planted { contact: Contact; phases: Phase[] }

// The contacts of all phases; one that several phases share comes once.
function listContacts(result: Result): Planted[] {
  const seen = new Map<string, Planted>();
  for (const phase of result.phases) {
    for (const contact of phase.contacts ?? []) {
      const key = JSON.stringify(contact);
      const same = seen.get(key);
      if (same) same.phases.push(phase);
      else seen.set(key, { contact, phases: [phase] });
    }
  }
  return [...seen.values()];
}

const isDuring = (phases: Phase[], t: number): boolean => phases.some((phase) => t >= phase.start - 1e-6 && t <= phase.end + 1e-6);

// Out of the surface: as stated, else the normal of the plane of the sole, upwards.
function normalOf(contact: Contact): Vector3 {
  if (contact.normal) return new Vector3().fromArray(contact.normal);
  const sole = contact.sole ?? [];
  const ring = convexRing(sole).map((corner) => new Vector3().fromArray(corner));
  const normal = new Vector3();
  ring.forEach((corner, i) => normal.add(corner.clone().cross(ring[(i + 1) % ring.length])));
  if (normal.length() < 1e-9) return new Vector3(0, 0, 1);
  return normal.normalize().multiplyScalar(normal.z < 0 ? -1 : 1);
}

// The corners around the surface's normal; a sole need not be level.
function outlineOf(contact: Contact): Vector3[] {
  const turn = new Quaternion().setFromUnitVectors(normalOf(contact), new Vector3(0, 0, 1));
  const back = turn.clone().invert();
  const flat = (contact.sole ?? []).map((corner) => new Vector3().fromArray(corner).applyQuaternion(turn).toArray());
  return convexRing(flat).map((corner) => new Vector3().fromArray(corner).applyQuaternion(back));
}

export class Contacts implements Layer {
  readonly name = "contacts";
  readonly label = "Contacts";
  readonly key = "k";
  readonly group = new Group();
  private readonly fill = new MeshBasicMaterial({ transparent: true, opacity: 0.3, side: DoubleSide, depthWrite: false });
  private readonly border = new MeshBasicMaterial({ transparent: true, opacity: 0.9, side: DoubleSide, depthWrite: false });
  private readonly point = new MeshBasicMaterial({ transparent: true, opacity: 0.95 });
  private readonly ball = new SphereGeometry(0.009, 14, 8);
  private readonly marks: { group: Group; phases: Phase[] }[] = [];

  constructor(result: Result) {
    for (const { contact, phases } of listContacts(result)) this.marks.push({ group: this.mark(contact), phases });
    for (const { group } of this.marks) this.group.add(group);
  }

  get count(): number { return this.marks.length; }

  private mark(contact: Contact): Group {
    const group = new Group();
    for (const corner of contact.sole ?? []) {
      const mesh = new Mesh(this.ball, this.point);
      mesh.position.fromArray(corner);
      mesh.renderOrder = 7;
      group.add(mesh);
    }
    const ring = outlineOf(contact);
    if (ring.length < 3) return group;
    // A sole need not be level: it is only lifted off its surface.
    const lift = normalOf(contact).multiplyScalar(0.002);
    const sole = ring.map((corner) => corner.clone().add(lift).toArray());
    const geometry = filledPolygon(sole, 0);
    sole.forEach((corner, i) => geometry.getAttribute("position").setZ(i, corner[2]));
    const height = sole.reduce((sum, corner) => sum + corner[2], 0) / sole.length;
    const isLevel = sole.every((corner) => Math.abs(corner[2] - height) < 5e-3);
    const parts: [BufferGeometry, Material][] = [[geometry, this.fill]];
    if (isLevel) parts.push([ribbon(sole.map(([x, y]) => new Vector2(x, y)), height + 0.002, 0.008, true, false), this.border]);
    for (const [part, material] of parts) {
      const mesh = new Mesh(part, material);
      mesh.renderOrder = 6;
      group.add(mesh);
    }
    return group;
  }

  update(t: number): void {
    for (const { group, phases } of this.marks) {
      group.visible = isDuring(phases, t);
    }
  }

  recolour(colours: Colours): void {
    for (const material of [this.fill, this.border, this.point]) material.color.set(colours.contact);
  }

  xray(on: boolean): void { this.fill.depthTest = this.border.depthTest = this.point.depthTest = !on; }
}

// Off until it is switched on: the cones of all corners hide the feet.
export class Cones implements Layer {
  readonly name = "cones";
  readonly label = "Friction cones";
  readonly key = "j";
  readonly group = new Group();
  readonly count: number;
  private readonly glass = new MeshBasicMaterial({ transparent: true, opacity: 0.28, side: DoubleSide, depthWrite: false });
  private readonly drawn: { group: Group; phases: Phase[] }[] = [];
  private colour = "";
  private isNow = false;

  constructor(result: Result) {
    const rough = listContacts(result).filter(({ contact }) => (contact.friction ?? 0) > 0 && (contact.sole ?? []).length > 0);
    this.count = rough.reduce((sum, { contact }) => sum + contact.sole!.length, 0);
    for (const { contact, phases } of rough) {
      const group = new Group();
      const upright = new Quaternion().setFromUnitVectors(new Vector3(0, 1, 0), normalOf(contact));
      // Its apex is at the corner; it holds for every normal within the tilt.
      const slope = Math.tan(Math.max(Math.atan(contact.friction!) - (contact.tilt_rad ?? 0), 0));
      const cone = new ConeGeometry(slope * CONE_HEIGHT, CONE_HEIGHT, 32, 1, true).rotateX(Math.PI).translate(0, CONE_HEIGHT / 2, 0);
      for (const corner of contact.sole!) {
        const mesh = new Mesh(cone, this.glass);
        mesh.position.fromArray(corner);
        mesh.quaternion.copy(upright);
        mesh.renderOrder = 8;
        group.add(mesh);
      }
      this.drawn.push({ group, phases });
      this.group.add(group);
    }
    this.group.visible = false;
  }

  update(t: number): void {
    this.isNow = false;
    for (const { group, phases } of this.drawn) {
      group.visible = isDuring(phases, t);
      this.isNow ||= group.visible && this.group.visible;
    }
  }

  legend(): Legend | undefined {
    return this.isNow ? { colour: this.colour, text: "cones of friction: directions that a contact force may have" } : undefined;
  }

  recolour(colours: Colours): void {
    this.colour = colours.contact;
    this.glass.color.set(colours.contact);
  }
}
