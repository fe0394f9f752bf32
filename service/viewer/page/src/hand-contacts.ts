// Where hands press what the task moves: contact points and normals at the waypoints, and now the friction cones of the
// force on the object (least friction as glass, largest as an outline) with the way that the joint moves the point.
import { ConeGeometry, CylinderGeometry, Group, Mesh, MeshBasicMaterial, SphereGeometry, TorusGeometry, Vector3 } from "three";
import { Arrow, overlay } from "./arrows";
import { HandContact, Phase, Result } from "./data";
import { figure } from "./dom";
import { Layer, Legend } from "./layer";
import { standingOf } from "./standing";
import { Colours } from "./theme";

const UP = new Vector3(0, 1, 0);
const HEIGHT = 0.1; // of the cones [m]
const WAY = 0.16; // length of the arrow [m]
const NORMAL = 0.05; // length of the needles at the waypoints [m]
const SIDES = 6; // lines of an outline
const ORDER = 13; // of drawing: over the loads, which often have the same direction

type Kind = "ok" | "unsure" | "fail";
interface Now { point: Vector3; normal: Vector3; way: Vector3; touches: boolean }
interface Drawn { contact: HandContact; phase: Phase; kind: Kind; cones: Group; trail: Group; arrow: Arrow; angle: number; isNow: boolean }

// Rows between two waypoints are linear; at the waypoints they are the verifier's.
function readAt(contact: HandContact, t: number): Now {
  const { times } = contact;
  const next = Math.max(1, times.findIndex((time) => time >= t));
  const after = Math.min(next, times.length - 1);
  const before = Math.max(after - 1, 0);
  const span = times[after] - times[before];
  const u = span > 0 ? Math.min(Math.max((t - times[before]) / span, 0), 1) : 0;
  const between = (rows: number[][]): Vector3 =>
    new Vector3().fromArray(rows[before]).lerp(new Vector3().fromArray(rows[after]), u);
  return {
    point: between(contact.points), normal: between(contact.normals).normalize(), way: between(contact.ways).normalize(),
    touches: contact.touches[u < 0.5 ? before : after],
  };
}

export class HandContacts implements Layer {
  readonly name = "hand-contacts";
  readonly label = "Contacts of hands";
  readonly key = "z";
  readonly group = new Group();
  private readonly glass = this.threefold(() => overlay(0.45));
  private readonly lines = this.threefold(() => overlay(0.9));
  private readonly pale = this.threefold(() => overlay(0.55));
  private readonly way = overlay(0.95);
  private readonly drawn: Drawn[] = [];
  private colours?: Colours;

  constructor(result: Result) {
    for (const phase of result.phases) {
      for (const contact of phase.hand_contacts ?? []) {
        const check = contact.check === null ? undefined : result.checks[contact.check];
        const standing = check ? standingOf(check) : "unproven";
        const kind: Kind = standing === "refuted" ? "fail" : standing === "unproven" ? "unsure" : "ok";
        const [cones, trail, arrow] = [this.makeCones(contact, kind), this.makeTrail(contact, kind), new Arrow(this.way, 0.0035)];
        arrow.group.traverse((part) => { part.renderOrder = ORDER + 1; });
        this.group.add(cones, trail, arrow.group);
        this.drawn.push({ contact, phase, kind, cones, trail, arrow, angle: 0, isNow: false });
      }
    }
  }

  get count(): number { return this.drawn.length; }

  private threefold(make: () => MeshBasicMaterial): Record<Kind, MeshBasicMaterial> {
    return { ok: make(), unsure: make(), fail: make() };
  }

  // Apex at the origin, opening upwards.
  private makeCones({ friction: [low, high] }: HandContact, kind: Kind): Group {
    const group = new Group();
    const inner = new ConeGeometry(low * HEIGHT, HEIGHT, 40, 1, true).rotateX(Math.PI).translate(0, HEIGHT / 2, 0);
    group.add(new Mesh(inner, this.glass[kind]));
    const rim = new TorusGeometry(high * HEIGHT, 0.0011, 8, 64).rotateX(Math.PI / 2).translate(0, HEIGHT, 0);
    group.add(new Mesh(rim, this.lines[kind]));
    for (let i = 0; i < SIDES; i++) {
      const turn = (2 * Math.PI * i) / SIDES;
      const end = new Vector3(high * HEIGHT * Math.cos(turn), HEIGHT, high * HEIGHT * Math.sin(turn));
      const side = new Mesh(new CylinderGeometry(0.0009, 0.0009, end.length(), 6).translate(0, end.length() / 2, 0), this.lines[kind]);
      side.quaternion.setFromUnitVectors(UP, end.clone().normalize());
      group.add(side);
    }
    group.traverse((part) => { part.renderOrder = ORDER; });
    return group;
  }

  private makeTrail(contact: HandContact, kind: Kind): Group {
    const group = new Group();
    const ball = new SphereGeometry(0.0045, 12, 8);
    const needle = new CylinderGeometry(0.0014, 0.0014, NORMAL, 6).translate(0, NORMAL / 2, 0);
    contact.points.forEach((point, i) => {
      const [dot, line] = [new Mesh(ball, this.pale[kind]), new Mesh(needle, this.pale[kind])];
      line.quaternion.setFromUnitVectors(UP, new Vector3().fromArray(contact.normals[i]).normalize());
      for (const part of [dot, line]) {
        part.position.fromArray(point);
        part.renderOrder = ORDER;
        group.add(part);
      }
    });
    return group;
  }

  // At a border of phases, that which begins, unless it has no contacts.
  update(t: number): void {
    const during = this.drawn.filter(({ phase }) => t >= phase.start - 1e-6 && t <= phase.end + 1e-6);
    const current = during.at(-1)?.phase;
    for (const each of this.drawn) {
      const { contact, cones, trail, arrow } = each;
      each.isNow = each.phase === current;
      cones.visible = trail.visible = arrow.group.visible = each.isNow;
      if (!each.isNow) continue;
      const { point, normal, way, touches } = readAt(contact, t);
      cones.visible = touches;
      cones.position.copy(point);
      cones.quaternion.setFromUnitVectors(UP, normal);
      arrow.set(point, way.clone().multiplyScalar(WAY));
      each.angle = normal.angleTo(way);
    }
  }

  legend(): Legend[] {
    if (!this.group.visible || !this.colours) return [];
    const colours = this.colours;
    return this.drawn.filter(({ isNow }) => isNow).map(({ contact, kind, angle }) => {
      const { surface, body, joint, friction: [low, high] } = contact;
      const says = kind === "ok" ? "" : kind === "fail" ? "; fails" : "; not proven";
      const off = figure(Number(((180 / Math.PI) * angle).toFixed(0)), "deg");
      return {
        colour: colours[COLOURS[kind]],
        text: `${surface} on ${body}: friction ${low} (cone) to ${high} (outline), normal ${off} off the way of joint ${joint} (arrow)${says}`,
      };
    });
  }

  recolour(colours: Colours): void {
    this.colours = colours;
    for (const kind of ["ok", "unsure", "fail"] as const) {
      for (const material of [this.glass[kind], this.lines[kind], this.pale[kind]]) material.color.set(colours[COLOURS[kind]]);
    }
    this.way.color.set(colours.com);
  }
}

const COLOURS = { ok: "hold", unsure: "zmp", fail: "bad" } as const;
